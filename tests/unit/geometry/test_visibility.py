import numpy as np
import pytest

from simulation import project_all, scene_points, simple_rig
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.geometry.visibility import see_points, typical_std

FRAMES = 60


def sightings(rig, *, std_px=0.02, seed=0, points=2, hidden=(), bias_px=0.0):
    """What see_points makes of noisy pixels of still points, of which some are hidden and all are off a little."""
    rng = np.random.default_rng(seed)
    std = np.broadcast_to(std_px, len(rig))
    u = np.repeat(project_all(rig, scene_points(rng, points))[:, None], FRAMES, axis=1)
    u += rng.normal(0, bias_px, (len(rig), 1, points, 2))
    u += rng.normal(size=u.shape) * std[:, None, None, None]
    covariance = np.broadcast_to((std**2)[:, None, None, None, None] * np.eye(2), (*u.shape, 2)).copy()
    status = np.zeros(u.shape[:3], dtype=np.int8)
    for view, frames, point in hidden:
        u[view, frames, point], status[view, frames, point] = np.nan, Status.LOST
    return see_points(u, covariance, status == Status.OK, rig), u, status, covariance


def test_two_views_are_taken_as_they_are():
    sight, u, *_ = sightings(simple_rig(2), hidden=[(1, slice(0, 5), 0)])
    assert sight.pixels is u
    assert sight.weights is None
    assert sight.visibility.views.tolist() == [[True, True]]
    assert (sight.visibility.of_sample[:5, 0] == -1).all()
    assert (sight.visibility.of_sample[5:] == 0).all()


def test_sets_of_views_are_named_by_sample():
    sight, *_ = sightings(simple_rig(3), hidden=[(2, slice(0, 10), 0), (0, slice(5, 20), 0), (1, slice(0, 60), 1)])
    members = [np.flatnonzero(one).tolist() for one in sight.visibility.views]
    of_sample = [[members[k] if k >= 0 else [] for k in column] for column in sight.visibility.of_sample.T]
    assert of_sample[0] == [[0, 1]] * 5 + [[]] * 5 + [[1, 2]] * 10 + [[0, 1, 2]] * 40
    assert of_sample[1] == [[0, 2]] * 60
    assert [members[k] for k in sight.visibility.most_frequent()] == [[0, 1, 2], [0, 2]]


def test_what_one_view_does_not_trust_is_left_to_two_that_trust_theirs():
    rig = simple_rig(3)
    _, u, status, covariance = sightings(rig)
    status[1, 7, 0] = Status.UNRELIABLE
    status[:2, 8, 0] = Status.UNRELIABLE
    used = see_points(u, covariance, status == Status.OK, rig).used
    assert used[:, 7, 0].tolist() == [True, False, True]
    assert used[:, 8, 0].all()


def test_weights_are_those_of_noise_and_depth():
    rig = simple_rig(3)
    sight, *_ = sightings(rig, std_px=[0.02, 0.04, 0.2], points=1)
    depth = [
        rig.cameras[v].rotation[2] @ sight.triangulate(rig)[0, 0] + rig.cameras[v].translation[2] for v in range(3)
    ]
    expected = 1 / (np.array([0.02, 0.04, 0.2]) * depth)
    np.testing.assert_allclose(sight.weights[:, 0], expected / expected[0], rtol=1e-3)


def test_noise_that_a_view_does_not_state_weighs_nothing():
    rig = simple_rig(3)
    _, u, status, covariance = sightings(rig, std_px=[0.02, 0.04, 0.2])
    covariance[1] = 0.0
    assert np.ptp(see_points(u, covariance, status == Status.OK, rig).weights) < 0.1


@pytest.mark.parametrize("hidden", [0, 1, 2])
def test_views_that_come_and_go_make_no_step(hidden):
    """Pixels that do not quite belong to one point: off by half a pixel, which is half a millimetre and more."""
    rig = simple_rig(3)
    sight, u, *_ = sightings(rig, std_px=1e-5, bias_px=0.5, hidden=[(hidden, slice(20, 40), 0)])
    places = sight.triangulate(rig)[:, 0]
    all_three = places[np.r_[0:20, 40:60]].mean(axis=0)
    assert np.linalg.norm(places[20:40].mean(axis=0) - all_three) < 1e-6
    assert np.linalg.norm(triangulate(u[:, 20:40], rig)[:, 0].mean(axis=0) - all_three) > 3e-4
    # The other point, which all see throughout, is as it was.
    np.testing.assert_array_equal(sight.pixels[:, :, 1], u[:, :, 1])


def test_the_disagreement_of_a_view_is_known_as_well_as_it_states():
    """Over many draws: what is taken off a view that joins late scatters by its stated standard deviation."""
    rig = simple_rig(3)
    found, stated = [], []
    for seed in range(80):
        sight, u, *_ = sightings(rig, seed=1000 + seed, points=1, hidden=[(2, slice(0, 45), 0)])
        found.append((u - sight.pixels)[2, 50, 0])
        stated.append(np.diag(sight.disagreement.covariance[2, 0]))
    assert np.std(found, axis=0) == pytest.approx(np.sqrt(np.mean(stated, axis=0)), rel=0.25)


def test_a_view_that_meets_no_two_others_is_not_linked():
    rig = simple_rig(3)
    sight, *_ = sightings(rig, hidden=[(2, slice(0, 40), 0), (0, slice(40, 60), 0)])
    assert sight.disagreement.linked[:, 0].tolist() == [True, True, False]
    assert sight.disagreement.linked[:, 1].all()


def test_the_anchor_has_a_pixel_of_every_view():
    rig = simple_rig(3)
    sight, u, *_ = sightings(rig, std_px=0.0, hidden=[(2, slice(0, 10), 0), (1, slice(0, 60), 1)])
    valid = np.isfinite(sight.triangulate(rig)).all(axis=-1)
    anchor = sight.anchor(valid)
    np.testing.assert_allclose(anchor[:, 0], u[:, 20, 0], atol=1e-6)
    assert np.isnan(anchor[1, 1]).all()
    assert np.isfinite(anchor[[0, 2], 1]).all()


def test_typical_std_is_of_the_frames_that_state_one():
    variance = np.array([[0.0, 1.0, 4.0, 9.0], [0.0, np.nan, 0.0, np.nan]])[:, :, None]
    np.testing.assert_array_equal(typical_std(variance), [[2.0], [np.nan]])
