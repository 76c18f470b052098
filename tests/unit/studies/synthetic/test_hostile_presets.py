"""The hostile field tests: all disturbances are there, at both sizes, and what is noted wrong is known."""

from dataclasses import fields, replace
from functools import cache

import av
import numpy as np
import pytest
import xarray as xr

from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.studies.synthetic.disturbances import Disturbances
from vfm_sdm.studies.synthetic.field_test import make_field_test
from vfm_sdm.studies.synthetic.plan import Blunder
from vfm_sdm.studies.synthetic.presets import HOSTILE, SIZES, preset
from vfm_sdm.studies.synthetic.scene import find_hidden
from vfm_sdm.studies.synthetic.survey import make_sessions

cached = cache(preset)


def tiny(name):
    """A fifth of a second of few pixels before a bare wall."""
    plan = cached(name, "small")
    wall = replace(plan.site.surfaces.wall, foliage=(), windows=())
    site = replace(plan.site, image_size=(320, 180), surfaces=replace(plan.site.surfaces, wall=wall))
    return replace(plan, site=site, duration_s=0.2)


def test_the_four_together_have_every_disturbance_and_both_codecs():
    plans = [cached(name, "small") for name in HOSTILE]
    settings = [recording.disturbances for plan in plans for recording in plan.recordings]
    for field in fields(Disturbances):
        assert any(getattr(each, field.name) != field.default for each in settings), field.name
    assert {passer.kind for each in settings for passer in each.passers} == {"person", "vehicle"}
    timings = [each.timing for each in settings if each.timing is not None]
    assert all(any(getattr(timing, name) > 0 for timing in timings) for name in ("variation", "dropped", "repeated"))
    assert {plan.encoder.get("codec", "libx264") for plan in plans} == {"libx264", "libx265"}
    assert {min(r.disturbances.bits_per_pixel for r in plan.recordings) for plan in plans} == {0.02, 0.05, 0.1, 0.3}
    assert any(recording.sharpening > 0 for plan in plans for recording in plan.recordings)
    assert any(plan.site.bars_alike for plan in plans)
    assert any(plan.blunders for plan in plans)
    assert all(plan.site.light.canopy.sway_m > 0 for plan in plans)


@pytest.mark.parametrize("name", HOSTILE)
def test_both_sizes_show_the_same_test(name):
    full, small = (cached(name, size) for size in SIZES)
    assert (full.site.image_size, small.site.image_size) == ((3840, 2160), (1280, 720))
    assert full.points == small.points
    assert full.recordings == small.recordings
    assert full.name == name
    place = [full.points[0].position]
    times = np.arange(0, 8, 0.05)
    np.testing.assert_allclose(
        full.motion.displacement(times, place), small.motion.displacement(times, place), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("name", ["hostile-3", "hostile-4"])
def test_balusters_stand_at_the_stated_pitch_and_look_alike(name):
    plan = tiny(name)
    scene = plan.site.scene(seed=plan.seed)
    bars = [face for face in scene.faces if face.name.startswith("bar ")]
    places = np.array([face.origin for face in bars])
    np.testing.assert_allclose(np.diff(places[:, 2]), -plan.site.bar_m, atol=1e-12)
    assert all(face.texture.contrast == 0 and not face.texture.marks for face in bars)
    bar = next(np.array(point.position) for point in plan.points if point.name == "bar")
    assert not any(find_hidden(scene, camera, bar[None])[0] for camera in plan.site.cameras())
    middles = np.array([face.origin + 0.5 * face.edge_u for face in bars])
    assert np.abs(middles[:, [0, 2]] - bar[[0, 2]]).sum(axis=1).min() < 1e-9


def test_a_blunder_stands_in_both_sessions_and_the_truth_beside(tmp_path):
    plan = tiny("hostile-2")
    wrong, right = (make_sessions(each, tmp_path) for each in (plan, replace(plan, blunders=())))
    further = "session_further.toml"
    assert wrong[further].site.length[0].value == pytest.approx(right[further].site.length[0].value + 0.5)
    assert wrong[further].site.length[1:] == right[further].site.length[1:]
    several = replace(plan, blunders=(Blunder("baseline", -0.2), Blunder("range 2", 0.1)))
    both = make_sessions(several, tmp_path)
    for name in ("session.toml", further):
        assert both[name].site.baseline.value == pytest.approx(right[name].site.baseline.value - 0.2)
    assert both[further].site.range[1].value == pytest.approx(right[further].site.range[1].value + 0.1)
    with pytest.raises(DatasetError, match="blunder: expected a reading of a session, got 'length 9'"):
        make_sessions(replace(plan, blunders=(Blunder("length 9", 0.1),)), tmp_path)


@pytest.mark.slow
def test_folder_holds_the_truth_of_every_frame(tmp_path):
    plan = tiny("hostile-2")
    path = make_field_test(tmp_path / "made", plan)
    with xr.open_dataset(path.with_name("disturbances_true.nc"), engine="h5netcdf") as truth:
        truth.load()
    for number, view in enumerate(plan.views):
        with av.open(str(path.with_name(f"{view}.mp4"))) as container:
            assert container.streams.video[0].codec_context.name == "hevc"
            stamps = [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]
        known = truth["stamp"].sel(view=view).dropna("frame")
        np.testing.assert_allclose(stamps, known, atol=1e-4)
        np.testing.assert_allclose(known + plan.recordings[number].start_s, truth["time"].sel(view=view)[: len(known)])
    assert float(abs(truth["turn"]).max()) > 20
    assert read_session(path.with_name("session_further.toml")).name == "hostile-2"
    # A second time nothing is drawn again; with one thing off, it is.
    before = path.with_name("left.mp4").stat().st_mtime_ns
    make_field_test(path.parent, plan)
    assert path.with_name("left.mp4").stat().st_mtime_ns == before
    first = replace(plan.recordings[0], disturbances=replace(plan.recordings[0].disturbances, haze=None))
    make_field_test(path.parent, replace(plan, recordings=(first, plan.recordings[1])))
    assert path.with_name("left.mp4").stat().st_mtime_ns != before
