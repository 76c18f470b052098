from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite, build_footbridge
from vfm_sdm.studies.synthetic.plan import MountedAccelerometer, Recording
from vfm_sdm.studies.synthetic.presets import PRESETS, SIZES, preset
from vfm_sdm.studies.synthetic.render import Renderer
from vfm_sdm.studies.synthetic.sensors import Accelerometer

cached = cache(preset)

# The paper's tables: baseline [m], shares of the span, and peak-to-peak amplitudes (lateral, vertical) [mm].
PAPER = {
    "data-1": (3.96, (1 / 2, 3 / 4), ((9.70, 11.94), (7.79, 8.30))),
    "data-2": (4.00, (1 / 4, 1 / 2), ((4.30, 12.15), (7.28, 17.37))),
    "data-3": (4.97, (1 / 4, 1 / 2), ((1.54, 7.54), (2.24, 10.95))),
    "data-4": (3.51, (1 / 4, 1 / 2), None),
}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", PRESETS)
def test_baseline_points_and_amplitudes_are_those_of_the_paper(name, size):
    plan = cached(name, size)
    baseline_m, shares, amplitudes = PAPER[name]
    first, second = plan.site.cameras()
    assert np.linalg.norm(second.center - first.center) == pytest.approx(baseline_m, abs=1e-12)
    assert plan.baseline_m == pytest.approx(baseline_m, abs=1e-12)
    positions = np.array([point.position for point in plan.points[:2]])
    np.testing.assert_allclose((positions[:, 2] - plan.site.support_m) / plan.site.span_m, shares)
    assert [mounted.point for mounted in plan.accelerometers] == [point.name for point in plan.points[:2]]
    if amplitudes is not None:
        time_s = np.arange(-3, plan.duration_s + 3, 1 / 128)
        moved = 1e3 * plan.motion.displacement(time_s, positions)[:, :, :2]
        swing = sosfiltfilt(butter(4, (1, 10), btype="bandpass", fs=128, output="sos"), moved, axis=0)
        swing = swing[(time_s >= 0) & (time_s <= plan.duration_s)]
        np.testing.assert_allclose(np.ptp(swing, axis=0), amplitudes, rtol=0.01)


@pytest.mark.parametrize("name", PRESETS)
def test_longitudinal_motion_is_small_but_not_zero(name):
    plan = cached(name, "full")
    time_s = np.arange(0, 16, 1 / 60)
    moved = plan.motion.displacement(time_s, [plan.points[0].position])[:, 0]
    assert 0.1e-3 < np.ptp(moved[:, 2]) < 0.05 * np.ptp(moved[:, 1])


@pytest.mark.parametrize("name", PRESETS)
def test_both_sizes_show_the_same_site_and_last_as_stated(name):
    full, small = cached(name, "full"), cached(name, "small")
    assert (full.site.image_size, full.fps, full.frames) == ((3840, 2160), 60, 960)
    assert (small.site.image_size, small.fps, small.frames) == ((1920, 1080), 30, 240)
    for large, half in zip(full.site.cameras(), small.site.cameras(), strict=True):
        assert large.focal_px == pytest.approx(2 * half.focal_px)
        np.testing.assert_array_equal(large.cam_from_world, half.cam_from_world)
    for large, half in zip(full.recordings, small.recordings, strict=True):
        assert large.defocus_px == 2 * half.defocus_px
        assert large.noise_std == half.noise_std
    assert full.points == small.points


@pytest.mark.parametrize("name", PRESETS)
def test_the_structure_is_at_rest_while_both_views_record_the_still_interval(name):
    plan = cached(name, "full")
    positions = [point.position for point in plan.points]
    for view in range(2):
        time_s = plan.frame_times(view)
        still = time_s[time_s <= plan.still_s]
        assert len(still) > 30
        assert np.all(plan.motion.displacement(still, positions) == 0)
        # The last frame's exposure, and a sensor that runs on, are within the motion.
        assert np.isfinite(plan.motion.displacement(time_s + 1.0, positions)).all()
    offset = (plan.recordings[1].start_s - plan.recordings[0].start_s) * plan.fps
    assert abs(offset - round(offset)) > 0.1


def test_conditions_are_those_of_the_paper():
    one, two, three, four = (cached(name, "full") for name in PRESETS)
    assert one.recordings[0].glare is not None
    assert one.recordings[1].glare is None
    assert [recording.defocus_px > 1 for recording in two.recordings] == [True, False]
    assert [recording.defocus_px > 1 for recording in three.recordings] == [False, True]
    assert [recording.light < 0.6 for recording in three.recordings] == [False, True]
    assert all(recording.stabilization is not None and recording.sharpening > 0 for recording in four.recordings)
    assert [plan.within_assumptions for plan in (one, two, three, four)] == [True, True, True, False]


def test_the_same_preset_is_the_same_each_time():
    once, again = preset("data-2", "small"), preset("data-2", "small")
    assert once == again
    time_s = np.linspace(0, 8, 50)
    positions = [once.points[0].position]
    np.testing.assert_array_equal(
        once.motion.displacement(time_s, positions), again.motion.displacement(time_s, positions)
    )


@pytest.mark.parametrize("name", PRESETS)
def test_every_point_is_seen_well_inside_both_views_on_what_it_belongs_to(name):
    plan = cached(name, "full")
    for camera in plan.site.cameras():
        pixels = camera.project([point.position for point in plan.points])
        assert np.all((pixels > 150) & (pixels < np.array(plan.site.image_size) - 151))
    assert sum(point.static for point in plan.points) >= 3
    # Occlusion does not depend on the image's size.
    site = replace(plan.site, image_size=(480, 270))
    scene = build_footbridge(site, seed=plan.seed)
    for camera in site.cameras():
        shown = Renderer(scene, camera, reach_m=0.0).face_at_rest
        for point in plan.points:
            u, v = np.rint(camera.project(point.position)).astype(int)
            face = scene.faces[shown[v, u]]
            offset = (np.array(point.position) - face.origin) @ np.cross(face.edge_u, face.edge_v)
            assert abs(offset) < 1e-9, (point.name, face.name)
            assert face.moving != point.static


def test_frame_times_are_those_of_a_clock_of_its_own():
    recording = Recording(start_s=-0.25, clock_rate=1.01)
    np.testing.assert_allclose(recording.frame_times(3, 50.0), -0.25 + np.array([0, 0.02, 0.04]) / 1.01)


def test_impossible_plans_are_refused():
    plan = cached("data-3", "small")
    with pytest.raises(DatasetError, match="preset: expected one of"):
        preset("data-9")
    with pytest.raises(DatasetError, match="preset: expected one of"):
        preset("data-1", "huge")
    with pytest.raises(DatasetError, match="recording: expected times"):
        Recording(light=0.0)
    with pytest.raises(DatasetError, match="accelerometers: expected points of"):
        replace(plan, accelerometers=(MountedAccelerometer(Accelerometer("a"), "nowhere"),))
    with pytest.raises(DatasetError, match="still_s: expected at most"):
        replace(plan, still_s=1.2)
    with pytest.raises(DatasetError, match="bays: expected a positive multiple of 4"):
        FootbridgeSite(bays=10)
