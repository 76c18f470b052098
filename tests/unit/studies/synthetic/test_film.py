"""Frames as a camera records them, against pictures that the renderer draws at single instants."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from vfm_sdm.studies.synthetic.defects import Glare, Stabilization
from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.film import film_view
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite, build_footbridge
from vfm_sdm.studies.synthetic.imager import LUMA_RANGE, Imager
from vfm_sdm.studies.synthetic.motion import Mode
from vfm_sdm.studies.synthetic.plan import Recording
from vfm_sdm.studies.synthetic.render import Renderer

SITE = FootbridgeSite(image_size=(320, 180))
CLEAN = Recording(exposure_s=0.0, noise_std=0.0)
MODES = (Mode("vertical", 2.2, 60.0, damping_ratio=0.01), Mode("lateral", 1.4, 20.0, damping_ratio=0.01))
"""Large, so that even these few pixels move by several."""
ROUNDING = 0.3
"""Root mean square of rounding, sqrt(1 / 12), and a little more."""
MOVING = 26
"""A frame in which it moves fast."""
FAST = replace(CLEAN, start_s=MOVING / 30)
"""Begins there, so that no frame before must be drawn."""


def make_plan(first=CLEAN, second=CLEAN):
    plan = demo_plan(seed=9, duration_s=1.0, site=SITE)
    return replace(plan, motion=replace(plan.motion, modes=MODES), recordings=(first, second))


@pytest.fixture(scope="module")
def scene():
    return build_footbridge(SITE, seed=9)


@pytest.fixture(scope="module")
def draw(scene):
    """The picture that a view shows at a true time, within the range of video but not rounded."""
    plan = make_plan()
    renderers = [Renderer(scene, camera, reach_m=0.1) for camera in SITE.cameras()]

    def at(time_s, view=0):
        luma = renderers[view].render(lambda X: plan.motion.displacement([time_s], X)[0])
        return np.clip(luma.astype(float), *LUMA_RANGE)

    return at


def film(plan, scene, *, view=0, numbers=(0,)):
    """Some frames of a view, as numbers with fractions allowed."""
    frames = islice(film_view(plan, scene, view)[0], max(numbers) + 1)
    return [frame.astype(float) for number, frame in enumerate(frames) if number in numbers]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_before_the_motion_a_frame_is_the_scene_at_rest_through_the_sensor(scene):
    plan = make_plan(replace(CLEAN, noise_std=1.5), replace(CLEAN, noise_std=0.7))
    for view, camera in enumerate(SITE.cameras()):
        frames, chroma = film_view(plan, scene, view)
        still = list(islice(frames, 3))
        renderer = Renderer(scene, camera)
        imager = Imager(SITE.image_size, noise_std=plan.recordings[view].noise_std, seed=(plan.seed, view))
        for number, frame in enumerate(still):
            assert frame.dtype == np.uint8
            np.testing.assert_array_equal(frame, imager.expose(renderer.render(), number))
        np.testing.assert_array_equal(chroma, renderer.chroma_at_rest())
        assert chroma.shape == (2, 90, 160)


def test_there_is_a_frame_for_every_stamp_at_its_true_time(scene, draw):
    plan = make_plan(second=replace(CLEAN, start_s=0.313, clock_rate=1.01))
    for view, start_s, rate in ((0, 0.0, 1.0), (1, 0.313, 1.01)):
        frames = [frame.astype(float) for frame in film_view(plan, scene, view)[0]]
        assert len(frames) == 30
        for number in (12, MOVING, 29):
            time_s = start_s + number / 30 / rate
            assert rms(frames[number] - draw(time_s, view)) < ROUNDING, (view, number)
    # A hundredth of a second matters.
    assert rms(frames[29] - draw(time_s + 0.01, 1)) > 5 * ROUNDING


def test_a_long_exposure_is_the_mean_of_what_moved_by(scene, draw):
    exposure_s, time_s = 1 / 20, MOVING / 30
    blurred = film(make_plan(replace(FAST, exposure_s=exposure_s)), scene)[0]
    instants = time_s + exposure_s * ((np.arange(24) + 0.5) / 24 - 0.5)
    expected = np.mean([draw(t) for t in instants], axis=0)
    sharp = draw(time_s)
    # Steps of a quarter pixel leave next to nothing beside rounding; the blur itself is several times that.
    assert rms(blurred - expected) < 0.35
    assert rms(sharp - expected) > 1.5


def test_a_short_exposure_is_one_picture(scene, draw):
    frame = film(make_plan(replace(FAST, exposure_s=1e-4)), scene)[0]
    assert rms(frame - draw(MOVING / 30)) < ROUNDING


def test_rows_of_a_rolling_shutter_show_the_displacement_at_their_own_time(scene, draw):
    read_out_s, time_s, height = 0.05, MOVING / 30, 180
    frame = film(make_plan(replace(FAST, rolling_shutter_s=read_out_s)), scene)[0]
    # Bands of 32 rows are drawn at the time of their middle: there a row is exact.
    middles = [15, 16, 47, 48, 79, 80, 111, 112, 143, 144]
    own, together = [], []
    for row in middles:
        delay_s = read_out_s * ((row + 0.5) / height - 0.5)
        own.append(frame[row] - draw(time_s + delay_s)[row])
        together.append(frame[row] - draw(time_s)[row])
    assert rms(own) < 0.6
    assert rms(together) > 5 * rms(own)
    # The first rows are the earlier ones.
    early, late = (rms(frame[:32] - draw(time_s + sign * 0.41 * read_out_s)[:32]) for sign in (-1, 1))
    assert early < 0.3 * late


def test_motion_blur_and_rolling_shutter_together(scene, draw):
    read_out_s, exposure_s, time_s = 0.05, 1 / 20, MOVING / 30
    recording = replace(FAST, rolling_shutter_s=read_out_s, exposure_s=exposure_s)
    frame = film(make_plan(recording), scene)[0]
    row = 112
    delay_s = read_out_s * ((row + 0.5) / 180 - 0.5)
    instants = time_s + delay_s + exposure_s * ((np.arange(16) + 0.5) / 16 - 0.5)
    expected = np.mean([draw(t)[row] for t in instants], axis=0)
    assert rms(frame[row] - expected) < 0.4
    assert rms(draw(time_s + delay_s)[row] - expected) > 1.2


def test_peaks_between_the_frames_are_within_reach():
    # 6 Hz at 12 frames a second: the largest displacement falls between frames, where a rolling shutter still sees it.
    site = FootbridgeSite(image_size=(160, 90))
    plan = replace(
        demo_plan(duration_s=0.8, site=site), fps=12, recordings=(replace(CLEAN, rolling_shutter_s=1 / 13),) * 2
    )
    fast = replace(plan.motion, modes=(Mode("vertical", 6.0, 5.0, damping_ratio=0.001),))
    frames, _ = film_view(replace(plan, motion=fast), build_footbridge(site, seed=1), 0)
    assert len(list(frames)) == 10


def test_noise_is_another_one_in_every_frame_view_and_seed(scene):
    noisy = replace(CLEAN, noise_std=2.0)
    plan = make_plan(noisy, noisy)
    rest = [film(make_plan(), scene, view=view)[0] for view in (0, 1)]
    first, second = (noise - rest[0] for noise in film(plan, scene, numbers=(0, 1)))
    other_view = film(plan, scene, view=1)[0] - rest[1]
    other_seed = film(replace(plan, seed=10), scene)[0] - rest[0]
    again = film(plan, scene)[0] - rest[0]
    np.testing.assert_array_equal(again, first)
    assert first.std() == pytest.approx(2.0, rel=0.1)
    for other in (second, other_view, other_seed):
        assert other.std() == pytest.approx(2.0, rel=0.1)
        # Rounding is the same for all where nothing moves, hence not quite zero.
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.05


def test_light_lowers_everything_above_black(scene):
    bright, dark = (film(make_plan(replace(CLEAN, light=light)), scene)[0] for light in (1.0, 0.4))
    assert (dark - 16).mean() == pytest.approx(0.4 * (bright - 16).mean(), rel=0.01)
    assert dark.std() == pytest.approx(0.4 * bright.std(), rel=0.01)


def test_glare_lifts_and_flattens_and_wanders(scene):
    glare = Glare(0.6, center=(0.2, 0.1), wander=0.05, seed=2)
    plain = film(make_plan(), scene)[0]
    first, later = film(make_plan(replace(CLEAN, glare=glare)), scene, numbers=(0, 11))
    assert first.mean() > plain.mean() + 20
    corner, opposite = np.s_[:60, :100], np.s_[120:, 220:]
    assert first[corner].std() < 0.7 * plain[corner].std()
    assert (first - plain)[corner].mean() > (first - plain)[opposite].mean()
    # It is still at rest, so all that changes is the veil.
    assert np.abs(later - first).max() >= 1


def test_defocus_takes_detail_and_leaves_the_mean(scene):
    plain, soft = (film(make_plan(replace(CLEAN, defocus_px=sigma)), scene)[0] for sigma in (0.0, 2.0))
    assert soft.mean() == pytest.approx(plain.mean(), abs=0.3)
    assert np.abs(np.diff(soft, axis=1)).mean() < 0.6 * np.abs(np.diff(plain, axis=1)).mean()


def test_sharpening_adds_contrast_at_edges(scene):
    plain, sharp = (film(make_plan(replace(CLEAN, sharpening=amount)), scene)[0] for amount in (0.0, 0.9))
    assert sharp.mean() == pytest.approx(plain.mean(), abs=0.5)
    assert np.abs(np.diff(sharp, axis=1)).mean() > 1.2 * np.abs(np.diff(plain, axis=1)).mean()


def test_stabilisation_moves_the_whole_picture_though_everything_stands_still(scene):
    drifting = replace(CLEAN, stabilization=Stabilization(follow=0.0, drift_px=2.0, roll_std_deg=0.0, seed=3))
    plain = film(make_plan(), scene, numbers=(0, 11))
    moved = film(make_plan(drifting), scene, numbers=(0, 11))
    np.testing.assert_array_equal(plain[0], plain[1])
    assert rms(moved[1] - moved[0]) > 3
    inner = np.s_[20:-20, 20:-20]
    shifts = [(v, u) for v in range(-8, 9) for u in range(-8, 9)]
    best = [min(shifts, key=lambda s, m=m: rms((np.roll(m, s, (0, 1)) - plain[0])[inner])) for m in moved]
    assert best[0] != best[1]
    # Moved back by whole pixels it is the picture at rest but for what lies between.
    assert rms((np.roll(moved[1], best[1], (0, 1)) - plain[0])[inner]) < 0.5 * rms((moved[1] - plain[0])[inner])


def test_stabilisation_follows_the_structure(scene):
    following = replace(CLEAN, stabilization=Stabilization(follow=1.0, drift_px=0.0, roll_std_deg=0.0, seed=3))
    first, moving = film(make_plan(following), scene, numbers=(0, MOVING))
    plain_first, plain_moving = film(make_plan(), scene, numbers=(0, MOVING))
    np.testing.assert_array_equal(first, plain_first)
    renderer = Renderer(scene, SITE.cameras()[0])
    on_structure = np.array([*(face.moving for face in scene.faces), False])[renderer.face_at_rest]
    # What moves seems to stand, and what stands seems to move.
    far = binary_erosion(~on_structure, iterations=10)
    assert rms((moving - first)[on_structure]) < 0.8 * rms((plain_moving - plain_first)[on_structure])
    assert rms((plain_moving - plain_first)[far]) < 1
    assert rms((moving - first)[far]) > 5


def test_faults_act_before_the_sensor(scene):
    # Half the light with the same noise, not half the noise.
    dark = replace(CLEAN, light=0.4)
    noisy = replace(dark, noise_std=2.0)
    difference = film(make_plan(noisy), scene)[0] - film(make_plan(dark), scene)[0]
    assert difference.std() == pytest.approx(2.0, rel=0.15)
