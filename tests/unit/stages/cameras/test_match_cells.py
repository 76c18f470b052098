import numpy as np
import pytest

from simulation import SIZE, project_all, scene_points, simple_rig
from vfm_sdm.stages.cameras.match_cells import estimate_match_noise, group_matches, group_points
from vfm_sdm.stages.cameras.shared_points import SharedPoints
from vfm_sdm.stages.matching.matches import Matches

SHARED_PX, OWN_PX = 0.5, 0.8


def noisy_pixels(rng, rig, count):
    """Pixels in all views, shape (V, N, 2) [px], with errors that a cell shares and errors of their own."""
    u = project_all(rig, scene_points(rng, 40 * count))
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))][:, :count]
    cell = (u[0, :, 0] * 6 // SIZE[0] * 6 + u[0, :, 1] * 6 // SIZE[1]).astype(int)
    # The vertical is across the epipolar lines of these cameras, and an error of one view is that of the pair.
    u[-1, :, 1] += rng.normal(0, SHARED_PX, 36)[cell] + rng.normal(0, OWN_PX, count)
    return u


def test_errors_are_told_into_shared_and_own():
    rng = np.random.default_rng(0)
    rig = simple_rig()
    found = []
    for _ in range(12):
        u = noisy_pixels(rng, rig, 400)
        found.append(estimate_match_noise([group_matches(Matches(0, 1, u[0], u[1]), SIZE)], [], rig))
    # The Sampson error is that of both views' pixels together, seen half in each.
    assert np.mean([one.own_px for one in found]) == pytest.approx(OWN_PX / np.sqrt(2), rel=0.1)
    assert np.mean([one.shared_px for one in found]) == pytest.approx(SHARED_PX / np.sqrt(2), rel=0.25)


def test_matches_without_own_errors_have_none():
    rng = np.random.default_rng(1)
    rig = simple_rig()
    u = project_all(rig, scene_points(rng, 400))
    noise = estimate_match_noise([group_matches(Matches(0, 1, u[0], u[1]), SIZE)], [], rig)
    assert noise.own_px < 1e-6


def test_lonely_wrong_matches_do_not_pass_for_errors_that_cells_share():
    rng = np.random.default_rng(2)
    rig = simple_rig()
    u = project_all(rig, scene_points(rng, 20000))
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))]
    crowd, lonely = u[0, :, 0] < SIZE[0] / 2, u[0, :, 0] >= SIZE[0] / 2
    chosen = np.concatenate([np.flatnonzero(crowd)[:300], np.flatnonzero(lonely)[:18]])
    u = u[:, chosen]
    u[1, :, 1] += rng.normal(0, OWN_PX, len(chosen))
    noise = estimate_match_noise([group_matches(Matches(0, 1, u[0], u[1]), SIZE)], [], rig)
    # As if a cell of one match were as good as one of twelve, they would share 0.4 px.
    assert noise.shared_px < 0.3


def test_own_errors_of_points_in_three_views():
    rng = np.random.default_rng(3)
    rig = simple_rig(3)
    u = project_all(rig, scene_points(rng, 20000))
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))][:, :400]
    u = u + rng.normal(0, OWN_PX, u.shape)
    noise = estimate_match_noise([], [group_points(SharedPoints((0, 1, 2), u), SIZE)], rig)
    assert noise.own_px == pytest.approx(OWN_PX, rel=0.1)
