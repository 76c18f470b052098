"""Points that are seen across an edge only, against exact motion of lines in space."""

import numpy as np
import pytest

from edge_scene import PLACES, make_edge_tracks, make_motion
from vfm_sdm.core.datasets import STRUCTURE_AXES, Status
from vfm_sdm.stages.displacement.edges import UNKNOWN_MOTION_M, state_prior
from vfm_sdm.stages.displacement.stereo import compute_displacement

FRAMES = 600
NAMES = list(PLACES)


@pytest.fixture(scope="module")
def motion():
    return make_motion(FRAMES)


@pytest.fixture(scope="module")
def measured(motion):
    tracks, rig, frame = make_edge_tracks(motion)
    return compute_displacement(tracks, rig, frame=frame)


def compare(measured, motion, point, axis):
    """Error and standard deviation of one point along one axis [mm], about the mean."""
    series = measured.sel(point=point, axis=axis)
    truth = motion[:, NAMES.index(point), STRUCTURE_AXES.index(axis)]
    error = series["displacement"].values - truth
    return error - error.mean(), series["displacement_std"].values


def test_a_flange_gives_vertical_motion(measured, motion):
    error, std = compare(measured, motion, "flange", "vertical")
    assert np.sqrt(np.mean(error**2)) < 0.08
    assert np.mean(np.abs(error) < 1.96 * std) >= 0.9
    assert std.max() < 2.5 * np.sqrt(np.mean(error**2))
    truth = motion[:, NAMES.index("flange"), 1] - motion[:, NAMES.index("flange"), 1].mean()
    assert error @ truth / (truth @ truth) == pytest.approx(0, abs=0.02)  # the prior takes nothing of the motion
    # Along the flange nobody sees anything.
    assert np.isnan(measured["displacement"].sel(point="flange", axis="longitudinal")).all()
    assert (measured["status"].sel(point="flange") == Status.OK).all()


def test_a_post_gives_lateral_motion(measured, motion):
    error, std = compare(measured, motion, "post", "lateral")
    assert np.sqrt(np.mean(error**2)) < 0.25 * np.ptp(motion[:, 1, 0])
    assert 0.9 <= np.mean(np.abs(error) < 1.96 * std) <= 0.999
    assert np.isnan(measured["displacement"].sel(point="post", axis="vertical")).all()


def test_what_is_open_is_wide_or_nothing(measured, motion):
    """The lateral motion of a flange that lies along the epipolar lines."""
    error, std = compare(measured, motion, "flange", "lateral")
    whole = measured["displacement_std"].sel(point="bolts", axis="lateral").median().item()
    assert np.isnan(error).all() or np.median(std) > 3 * whole


def test_points_that_are_seen_whole_are_as_without_edges(measured, motion):
    tracks, rig, frame = make_edge_tracks(motion)
    whole = compute_displacement(tracks.sel(point=["bolts", "paint"]).drop_vars("edge_across"), rig, frame=frame)
    for name in ("displacement", "displacement_std", "position", "reprojection_error", "pixel_sensitivity"):
        found = measured[name].sel(point=["bolts", "paint"]).values
        np.testing.assert_allclose(found, whole[name].values, rtol=1e-6, atol=1e-8)


def test_the_prior_is_what_the_others_do(measured, motion):
    prior = state_prior(measured.sel(point=["bolts", "paint"]))
    assert prior[1] == pytest.approx(1.5e-3 * motion[:, 2:, 1].std(axis=0).max(), rel=0.05)
    assert state_prior(None).tolist() == [UNKNOWN_MOTION_M] * 3
    still, rig, frame = make_edge_tracks(0 * motion)
    at_rest = compute_displacement(still.sel(point=["bolts"]), rig, frame=frame)
    assert state_prior(at_rest).tolist() == [UNKNOWN_MOTION_M] * 3


def test_without_others_an_edge_is_wide_but_never_wrong(motion):
    tracks, rig, frame = make_edge_tracks(motion)
    alone = compute_displacement(tracks.sel(point=["flange"]), rig, frame=frame)
    truth = motion[:, 0, 1]
    series = alone.sel(point="flange", axis="vertical")
    error = series["displacement"].values - truth
    error -= error.mean()
    assert np.mean(np.abs(error) < 1.96 * series["displacement_std"].values) > 0.9


def test_one_view_may_see_the_point_whole(motion):
    """The left view has texture on the flange, the right one has not: all directions but the depth."""
    tracks, rig, frame = make_edge_tracks(motion, beside_px=(0.0, 0.0))
    rng = np.random.default_rng(5)
    exact = rig.cameras[0].project((np.array(PLACES["flange"]) + motion[:, 0] / 1e3) @ frame.rotation)
    tracks["position"][0, :, 0] = exact + rng.normal(0, 0.02, exact.shape)
    tracks["position_covariance"][0, :, 0] = 0.02**2 * np.eye(2)
    tracks["edge_across"][0, 0] = np.nan
    measured = compute_displacement(tracks, rig, frame=frame)
    error, std = compare(measured, motion, "flange", "vertical")
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9


def test_cameras_and_clocks_count_for_edges_too(motion):
    tracks, rig, frame = make_edge_tracks(motion)
    covariance = np.zeros((23, 23))
    covariance[0, 0] = covariance[10, 10] = covariance[0, 10] = covariance[10, 0] = 0.01**2
    measured = compute_displacement(tracks, rig, frame=frame, covariance=covariance)
    flange, bolts = (measured["scale_std"].sel(point=p, axis="vertical").item() for p in ("flange", "bolts"))
    assert flange == pytest.approx(bolts, abs=2e-3)
    # Pixels that move up and down move the flange up and down; along it they tell nothing.
    slope = measured["pixel_sensitivity"].sel(point="flange", axis="vertical").values
    along = np.array([tracks["edge_across"].values[:, 0, 1], -tracks["edge_across"].values[:, 0, 0]]).T
    assert np.abs(np.einsum("vk,vk->v", slope, along)).max() < 1e-3 * np.abs(slope).max()


def test_a_sample_that_one_view_lost_is_lost(motion):
    tracks, rig, frame = make_edge_tracks(motion)
    tracks["position"][1, 100:120, 0] = np.nan
    tracks["status"][1, 100:120, 0] = Status.LOST
    measured = compute_displacement(tracks, rig, frame=frame)
    lost = measured["status"].sel(point="flange").values
    assert (lost[100:120] == Status.LOST).all()
    assert np.isnan(measured["displacement"].sel(point="flange").values[100:120]).all()
    assert (np.delete(lost, slice(100, 120)) == Status.OK).all()
