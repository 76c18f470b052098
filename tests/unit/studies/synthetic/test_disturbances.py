"""Each disturbance against the physics that its settings state."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.defects import sharpen
from vfm_sdm.studies.synthetic.disturbance_truth import true_disturbances
from vfm_sdm.studies.synthetic.disturbances import Disturbances
from vfm_sdm.studies.synthetic.exposure import ExposureStep, Flicker
from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.film import film_view
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.obstacles import Branch, Passer, cover
from vfm_sdm.studies.synthetic.optics import LateralColour, Shake, compute_turn_fields, spread_colours
from vfm_sdm.studies.synthetic.plan import Recording
from vfm_sdm.studies.synthetic.timing import Timing
from vfm_sdm.studies.synthetic.weather import Haze, Rain, add_rain, count_streaks

SITE = FootbridgeSite(image_size=(320, 180))
CLEAN = Recording(exposure_s=0.0, noise_std=0.0)
DARK = 40.0


def made(disturbances, **changes):
    """A plan of one second with these disturbances of the left view."""
    plan = demo_plan(seed=9, duration_s=1.0, site=SITE)
    return replace(plan, recordings=(replace(CLEAN, disturbances=disturbances, **changes), CLEAN))


@pytest.fixture(scope="module")
def scene():
    return SITE.scene(seed=9)


@pytest.fixture(scope="module")
def film(scene):
    """Some frames of the left view, as numbers with fractions allowed."""

    def frames(disturbances, numbers=(0,), **changes):
        plan = made(disturbances, **changes)
        shown = islice(film_view(plan, scene, 0)[0], max(numbers) + 1)
        return [frame.astype(float) for number, frame in enumerate(shown) if number in numbers]

    return frames


@pytest.fixture(scope="module")
def clean(film):
    return film(Disturbances())[0]


def edge_place(row, low, high):
    """Place at which a row rises from one value to the other [px], from the area under it."""
    return len(row) - 0.5 - (row - low).sum() / (high - low)


@pytest.mark.parametrize("column", [80.5, 420.5])
def test_red_and_blue_edges_move_radially_by_the_stated_shares(column):
    edge = np.where(np.arange(500) < column, DARK, 140.0) * np.ones((5, 1))
    middle = 250.0
    for colour, share in ((LateralColour(red=4e-3, blue=0.0), 0.2126), (LateralColour(red=0.0, blue=-6e-3), 0.0722)):
        drawn = spread_colours(edge.astype(np.float32), colour, (middle, 2.0))[2]
        moved = edge_place(drawn, DARK, 140.0) - edge_place(edge[2], DARK, 140.0)
        # Places are rounded to 1/32 px, and the edge is of one share of the luma.
        assert moved / share == pytest.approx((colour.red + colour.blue) * (column - middle), abs=0.05)


def test_sharpening_overshoots_on_both_sides_of_an_edge_by_half_its_amount():
    edge = np.where(np.arange(60) < 30, 60.0, 160.0) * np.ones((9, 1))
    row = sharpen(edge.astype(np.float32), 0.5, sigma_px=2.0)[4]
    # Of a step s the blurred frame takes Phi(1/4) s = 0.6 s at half a pixel beside it.
    assert row.max() - 160 == pytest.approx(0.5 * 100 * (1 - 0.5987), abs=0.5)
    assert 60 - row.min() == pytest.approx(row.max() - 160, abs=0.1)


def test_an_exposure_step_changes_light_by_its_factor_and_no_earlier(film, clean):
    step = Disturbances(exposure_steps=(ExposureStep(0.1, 0.8),))
    before, after = film(step, (2, 3))
    np.testing.assert_array_equal(before, clean)
    within = clean < 234
    assert (after - 16)[within].mean() == pytest.approx(0.8 * (clean - 16)[within].mean(), rel=3e-3)


def test_flicker_is_seen_in_the_frames_means_at_its_alias(film, clean):
    # At 30 frames a second, 100 Hz shows as 10 Hz: three frames to a period.
    frames = film(Disturbances(flicker=Flicker(0.1, frequency_hz=100.0)), range(6))
    gains = [(frame - 16).mean() / (clean - 16).mean() for frame in frames]
    np.testing.assert_allclose(gains, 1 + 0.1 * np.sin(2 * np.pi * 100 * np.arange(6) / 30), atol=5e-3)


def test_flicker_draws_bands_with_a_rolling_shutter_and_none_in_whole_periods(film, clean):
    lamp = Disturbances(flicker=Flicker(0.1, frequency_hz=100.0))
    rows = (film(lamp, rolling_shutter_s=0.02)[0] - 16).mean(axis=1) / (clean - 16).mean(axis=1)
    time_s = 0.02 * ((np.arange(180) + 0.5) / 180 - 0.5)
    np.testing.assert_allclose(rows, 1 + 0.1 * np.sin(2 * np.pi * 100 * time_s), atol=0.012)
    np.testing.assert_allclose(film(lamp, exposure_s=0.01)[0], clean, atol=1)


def test_haze_takes_contrast_by_koschmieder(film, clean):
    haze = Haze(visibility_m=40.0, airlight=150.0)
    drawn, plan = film(Disturbances(haze=haze))[0], made(Disturbances())
    places = np.array([point.position for point in plan.points])
    for (u, v), distance_m in zip(plan.site.cameras()[0].project(places), np.linalg.norm(places, axis=1), strict=True):
        left = 0.02 ** (distance_m / 40)
        around = np.s_[int(v) - 1 : int(v) + 3, int(u) - 1 : int(u) + 3]
        assert drawn[around].mean() == pytest.approx(left * clean[around].mean() + (1 - left) * 150, abs=1)


def test_rain_draws_as_many_streaks_as_said_and_other_ones_each_frame():
    flat, rain = np.full((200, 400), DARK, np.float32), Rain(30.0, length=0.1, slant_deg=0.0, strength=0.3)
    counts, areas, frames = [], [], []
    for number in range(60):
        frame = add_rain(flat, rain, seed=(5, number))
        counts.append(count_streaks(rain, (5, number)))
        frames.append(frame)
        areas.append((frame - DARK).sum() / (0.3 * (235 - DARK)))
    # Each is one pixel wide and 20 px long; a little is outside the picture.
    assert np.polyfit(counts, areas, 1)[0] == pytest.approx(20, rel=0.25)
    assert np.mean(counts) == pytest.approx(30, rel=0.1)
    assert not np.array_equal(frames[0], frames[1])


def test_a_camera_that_shakes_shows_the_scene_where_its_turn_says(film, clean):
    shake = Shake((0.0, 300.0, 0.0))
    plan = made(Disturbances(shake=shake))
    truth = true_disturbances(plan).sel(view="left")
    numbers = (0, 3)
    camera = plan.site.cameras()[0]
    for number, frame in zip(numbers, film(Disturbances(shake=shake), numbers), strict=True):
        yaw = 1e-6 * float(truth["turn"].sel(axis="yaw")[number])
        # A camera that turns to the right sees the scene go left.
        expected = -yaw * camera.focal_px
        middle = np.s_[60:120, 60:260]
        slope = np.gradient(clean, axis=1)[middle]
        found = -((frame - clean)[middle] * slope).sum() / (slope**2).sum()
        assert found == pytest.approx(expected, rel=0.15, abs=0.03)


def test_turn_fields_are_those_of_the_turned_camera():
    camera = SITE.cameras()[0]
    rays = camera.normalize(np.moveaxis(np.indices((180, 320))[::-1], 0, -1).reshape(-1, 2)).reshape(180, 320, 2)
    fields = compute_turn_fields(camera, rays)
    turn = np.array([3e-4, -2e-4, 5e-4])
    points = np.array([[7.0, 0.1, 4.3], [7.0, -0.2, 4.6]])
    first = np.array([[1, -turn[2], turn[1]], [turn[2], 1, -turn[0]], [-turn[1], turn[0], 1]])
    turned = replace(camera, cam_from_world=first.T @ camera.cam_from_world)
    before = camera.project(points)
    u, v = np.rint(before).astype(int).T
    moved = np.tensordot(turn, fields[:, :, v, u], axes=1).T
    np.testing.assert_allclose(moved, turned.project(points) - before, atol=2e-3)


def test_a_passer_hides_what_is_behind_and_moves_at_its_speed():
    walker, flat = Passer("person", distance_m=8.0, speed_m_s=2.0, middle_s=1.0), np.full((180, 320), 200.0, np.float32)
    middles = []
    for time_s in (0.9, 1.1):
        covered, hidden = cover(flat, walker.blobs(time_s, 400.0, (320, 180)), 0.5)
        assert np.all(covered[hidden > 0.999] < 100)
        np.testing.assert_array_equal(covered[hidden == 0], 200.0)
        middles.append((hidden.sum(axis=0) * np.arange(320)).sum() / hidden.sum())
    assert middles[1] - middles[0] == pytest.approx(0.2 * 2.0 * 400 / 8, rel=0.02)


def test_truth_says_when_a_vehicle_hides_a_point(film, clean):
    car = Passer("vehicle", distance_m=4.0, speed_m_s=9.0, middle_s=0.5, ground_m=0.6)
    settings = Disturbances(passers=(car,))
    plan = made(settings)
    hidden = true_disturbances(plan).sel(view="left")["hidden"]
    pixels = np.rint(plan.site.cameras()[0].project([point.position for point in plan.points])).astype(int)
    assert hidden.sel(point="1/2 span").max() == 1
    for number, frame in ((0, film(settings, (0,))[0]), (15, film(settings, (15,))[0])):
        change = np.array([abs(frame - clean)[v - 2 : v + 3, u - 2 : u + 3].max() for u, v in pixels])
        assert (change[hidden[number] == 1] > 10).all()


def test_leaves_sway_together_within_their_part_of_the_picture():
    branch = Branch((0.2, 0.3), (0.03, 0.03), leaves=25, sway=0.01)
    centers = np.array(
        [[leaf.center_px for leaf in branch.blobs(t, (1000, 500), seed=(4,))] for t in np.arange(40) / 5]
    )
    steps = np.diff(centers, axis=0)
    np.testing.assert_allclose(steps, steps[:, :1] * np.ones((1, 25, 1)), atol=1e-9)
    assert 3 < centers[:, 0].std(axis=0).min() < centers[:, 0].std(axis=0).max() < 20
    np.testing.assert_allclose(centers.mean(axis=(0, 1)), [200, 150], atol=25)


def test_stamps_of_a_variable_rate_are_true_and_repeated_frames_show_the_one_before(film):
    plan = made(Disturbances(timing=Timing(variation=0.1, dropped=0.1, repeated=0.2)), start_s=0.2)
    times, stamps, repeated = plan.frame_times(0), plan.stamps(0), plan.repeated(0)
    assert len(times) == len(stamps) == len(repeated) < plan.frames
    np.testing.assert_allclose(times, 0.2 + stamps / 30)
    steps = np.diff(stamps)
    kept = steps[steps < 1.5]
    assert np.std(kept) == pytest.approx(0.1, rel=0.4)
    assert steps.max() > 1.6
    assert 0 < repeated.sum() < 0.5 * len(times)
    frames = film(Disturbances(timing=Timing(variation=0.1, dropped=0.1, repeated=0.2)), range(15), start_s=0.2)
    for number in range(1, 15):
        assert np.array_equal(frames[number], frames[number - 1]) == repeated[number] or times[number] < plan.still_s


def test_switching_one_disturbance_off_leaves_the_others_as_they_were():
    both = Disturbances(shake=Shake((50.0, 50.0, 50.0)), rain=Rain(50.0), timing=Timing(variation=0.05))
    truth = true_disturbances(made(both))
    for off in ("rain", "shake"):
        left = true_disturbances(made(replace(both, **{off: None})))
        for name in {"streaks", "turn", "stamp"} - {{"rain": "streaks", "shake": "turn"}[off]}:
            np.testing.assert_array_equal(left[name], truth[name])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LateralColour(red=0.5, blue=0.0), "lateral colour: expected at most"),
        (lambda: Shake((-1.0, 0.0, 0.0)), "shake: expected rotations"),
        (lambda: ExposureStep(1.0, 0.0), "exposure step: expected a gain"),
        (lambda: Flicker(2.0), "flicker: expected a depth"),
        (lambda: Haze(0.0), "haze: expected a visibility"),
        (lambda: Rain(-1.0), "rain: expected streaks"),
        (lambda: Passer("person", 5.0, 0.0, 1.0), "passer: expected"),
        (lambda: Branch((0.5, 0.5), (0.0, 0.1), 5), "branch: expected sizes"),
        (lambda: Timing(variation=0.5), "timing: expected a variation"),
        (lambda: Disturbances(bits_per_pixel=-1.0), "bits_per_pixel: expected"),
    ],
)
def test_impossible_settings_are_refused(make, message):
    with pytest.raises(DatasetError, match=message):
        make()
