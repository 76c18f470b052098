"""The adjustment of a pan clip on simulated sightings: errors, intervals, drift and statuses against truth."""

from dataclasses import replace

import numpy as np
import pytest

from turning import draw_lever, draw_plan, look, misled, true_values
from vfm_sdm.core.statuses import LensStatus
from vfm_sdm.errors import CameraError
from vfm_sdm.stages.lens.adjustment import adjust_clip
from vfm_sdm.stages.lens.clip import judge_lens, merge_radial
from vfm_sdm.stages.lens.normal_equations import NormalEquations, invert_scaled, solve_scaled
from vfm_sdm.stages.lens.scene import PanScene
from vfm_sdm.stages.lens.steadiness import follow_focal

FRAMES, POINTS, DURATION_S = 20, 400, 8.0
TIME_S = (np.arange(FRAMES) + 0.5) * DURATION_S / FRAMES
NOISE_PX = 0.25


def adjusted(seed, view_deg, *, lever_m=0.0, noise_px=NOISE_PX, **plan):
    plan = draw_plan(seed, view_deg, lever_m=draw_lever(seed, lever_m), **plan)
    return plan, adjust_clip(*look(plan, frames=FRAMES, points=POINTS, noise_px=noise_px))


@pytest.mark.parametrize(
    ("view_deg", "most_std", "scene"),
    [
        (14, 0.016, {"distance_m": (300.0, 3000.0)}),
        (40, 0.0020, {"distance_m": (300.0, 3000.0), "readout_s": 0.02}),
        (65, 0.0008, {"distance_m": (300.0, 3000.0), "readout_s": 0.02}),
        (40, 0.0025, {"distance_m": (12.0, 60.0), "lever_m": 0.08}),
    ],
)
def test_the_lens_is_found_and_its_intervals_hold(view_deg, most_std, scene):
    scores = []
    for seed in range(4):
        plan, found = adjusted(seed, view_deg, **scene)
        std = np.sqrt(np.diag(found.covariance)[:5])
        assert std[0] < most_std
        assert found.noise_px == pytest.approx(NOISE_PX, rel=0.1)
        scores.append((found.lens[:5] - true_values(plan)) / std)
    # Twenty scores, partly correlated: their mean square is 1 within a half.
    assert 0.4 < np.mean(np.square(scores)) < 1.7
    assert np.abs(scores).max() < 4


def test_without_noise_the_lens_is_exact():
    plan, found = adjusted(1, 40, noise_px=1e-4, distance_m=(1e5, 1e6))
    np.testing.assert_allclose(found.lens[:3], true_values(plan)[:3], atol=1e-3)
    assert found.lens[0] == pytest.approx(true_values(plan)[0], abs=2e-6)


def test_the_readout_is_found():
    _, found = adjusted(2, 40, distance_m=(300.0, 3000.0), readout_s=0.02)
    assert found.lens[9] == pytest.approx(0.02, abs=4 * np.sqrt(found.covariance[9, 9]))
    assert np.sqrt(found.covariance[9, 9]) < 2e-4


def test_a_lever_in_front_of_the_axis_of_a_near_scene_lies_on_the_right_side():
    _, found = adjusted(3, 40, lever_m=0.2, distance_m=(5.0, 30.0))
    assert found.camera.lever @ draw_lever(3, 0.2) > 0
    assert found.camera.shared[3] > 0


def test_a_lens_does_not_depend_on_where_the_adjustment_starts():
    """The points' volume pulls the focal length by some standard deviations: from both sides it ends at one place."""
    plan = draw_plan(3, 14, lever_m=draw_lever(3, 0.08), distance_m=(12.0, 60.0))
    start, clip = look(plan, frames=FRAMES, points=POINTS)
    ends = [adjust_clip(start.moved(np.eye(10)[0] * step, *still(start)), clip) for step in (-0.15, 0.15)]
    std = np.sqrt(ends[0].covariance[0, 0])
    assert abs(ends[0].lens[0] - ends[1].lens[0]) < 0.3 * std
    assert abs(ends[0].lens[0] - true_values(plan)[0]) < 3 * std


def still(camera):
    """No step of turns and points."""
    return np.zeros((len(camera.attitudes), 3)), np.zeros((len(camera.nearness), 4))


@pytest.mark.parametrize(("stated_m", "status"), [((100, 500), LensStatus.OK), ((600, 3000), LensStatus.NEARER)])
def test_a_scene_that_is_nearer_than_stated_is_named(stated_m, status):
    plan = draw_plan(3, 40, lever_m=draw_lever(3, 0.08), distance_m=(12.0, 60.0))
    start, clip = look(plan, frames=FRAMES, points=POINTS)
    mean, std = PanScene(*stated_m).nearness
    stated = replace(misled(clip, nearness=(mean, std)), nearness_std=std)
    found = adjust_clip(replace(start, shared=start.shared * [1, 1, 1, 0, 1] + [0, 0, 0, mean, 0]), stated)
    estimate = judge_lens(found, TIME_S)
    assert estimate.status == status
    assert "the scene is nearer, or the lever longer, than stated" in estimate.notes[-1]
    # Pictures tell the product of lever and nearness, and that is what moves the focal length.
    assert abs(found.lens[0] - true_values(plan)[0]) < 4 * np.sqrt(found.covariance[0, 0])
    right = judge_lens(adjust_clip(start, clip), TIME_S)
    assert not any("than stated" in note for note in right.notes)


def test_outliers_hardly_move_the_lens():
    plan = draw_plan(4, 40, distance_m=(300.0, 3000.0))
    start, clip = look(plan, frames=FRAMES, points=POINTS)
    wrong = np.random.default_rng(0).random(len(clip.seen)) < 0.03
    clip.seen.pixel[wrong] += 30.0
    found = adjust_clip(start, clip)
    assert abs(found.lens[0] - true_values(plan)[0]) < 5 * np.sqrt(found.covariance[0, 0])
    assert found.weights[wrong].max() < 0.5
    assert found.noise_px < 1.3 * NOISE_PX


def test_a_focus_that_grows_is_followed():
    plan = draw_plan(5, 40, distance_m=(300.0, 3000.0), focus_growth=0.004)
    found = adjust_clip(*look(plan, frames=FRAMES, points=POINTS))
    course = follow_focal(found, TIME_S)
    # From the middle of the first interval to that of the last.
    growth = 0.004 * (FRAMES - 1) / FRAMES
    assert course.drift == pytest.approx(growth, abs=max(4 * course.drift_std, 2e-4))
    assert course.drift_std < 4e-4
    still = follow_focal(adjusted(5, 40, distance_m=(300.0, 3000.0))[1], TIME_S)
    assert abs(still.drift) < 4 * still.drift_std
    assert judge_lens(found, TIME_S).status == LensStatus.CHANGING


def test_drift_widens_the_interval_of_a_lens_that_is_taken():
    plan = draw_plan(5, 65, distance_m=(300.0, 3000.0), focus_growth=0.0009)
    found = adjust_clip(*look(plan, frames=FRAMES, points=POINTS))
    estimate = judge_lens(found, TIME_S)
    assert estimate.status == LensStatus.OK
    assert estimate.focal_std > np.sqrt(found.covariance[0, 0] + 0.0006**2 / 12)


def test_a_picture_that_other_things_move_is_named():
    plan = draw_plan(6, 40, distance_m=(300.0, 3000.0))
    start, clip = look(plan, frames=FRAMES, points=POINTS, noise_px=4.0)
    assert judge_lens(adjust_clip(start, clip), TIME_S).status == LensStatus.MOVED


def test_turns_that_tell_no_focal_length_are_named():
    plan = draw_plan(7, 14, distance_m=(300.0, 3000.0), turn_deg=(0.3, 0.3, 0.0))
    start, clip = look(plan, frames=FRAMES, points=POINTS)
    estimate = judge_lens(adjust_clip(start, clip), TIME_S)
    assert estimate.status == LensStatus.NOT_DETERMINED
    assert not estimate.usable
    assert estimate.advice == ()


def test_a_near_scene_is_advised_against_where_the_lever_counts():
    near = judge_lens(adjusted(8, 14, lever_m=0.08, distance_m=(3.0, 12.0))[1], TIME_S)
    far = judge_lens(adjusted(8, 40, distance_m=(300.0, 3000.0))[1], TIME_S)
    assert near.focal_std > 0.005
    assert any("would bring" in line or "tell the lens better" in line for line in near.advice)
    assert far.advice == ()


def test_the_covariance_of_one_coefficient_is_that_of_the_picture_it_moves():
    plan, found = adjusted(9, 65, distance_m=(300.0, 3000.0))
    camera = plan.camera
    merged = merge_radial(found.covariance, camera)
    np.testing.assert_allclose(merged[:3, :3], found.covariance[:3, :3])
    # The spread of the radial shift over the picture, by k1 and k2 and by the one that stands for both.
    u, v = np.meshgrid(np.linspace(0, 1919, 30), np.linspace(0, 1079, 20))
    r = np.hypot((u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1]).ravel()
    both = np.column_stack([r**3, r**5])
    spread = np.sqrt(np.einsum("ni,ij,nj->n", both, found.covariance[3:5, 3:5], both).mean())
    assert np.sqrt(merged[3, 3] * (r**6).mean()) == pytest.approx(spread, rel=0.25)


def test_what_no_value_explains_is_at_right_angles_to_all():
    plan = draw_plan(10, 40, distance_m=(300.0, 3000.0))
    found = adjust_clip(*look(plan, frames=FRAMES, points=POINTS))
    clip = found.clip
    normal = NormalEquations(found.camera, clip, np.full(len(clip.seen), 16.0))
    values = np.random.default_rng(0).normal(size=(len(clip.seen), 2))
    left = normal.unexplained(values)
    again = normal.unexplained(left)
    # Once more leaves it but for what priors hold back.
    assert np.linalg.norm(again - left) < 0.05 * np.linalg.norm(left)
    assert np.linalg.norm(normal.unexplained(normal.by_lens[:, :, 1])) < 0.01 * np.linalg.norm(normal.by_lens[:, :, 1])


def test_a_held_value_stays():
    plan = draw_plan(11, 40, distance_m=(300.0, 3000.0))
    start, clip = look(plan, frames=FRAMES, points=POINTS)
    found = adjust_clip(start, misled(clip, k2=(0.0, 0.0)))
    assert found.lens[4] == 0
    assert found.covariance[4].tolist() == [0.0] * 10


def test_a_matrix_that_is_not_positive_is_refused():
    with pytest.raises(CameraError, match="expected sightings that determine all turns"):
        solve_scaled(np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2))
    np.testing.assert_allclose(invert_scaled(np.diag([4.0, 1e-12])), np.diag([0.25, 1e12]))
