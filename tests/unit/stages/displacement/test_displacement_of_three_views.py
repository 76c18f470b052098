"""Displacement from three views: what each of them adds, and what happens when one of them loses a point."""

import numpy as np
import pytest
import xarray as xr

from simulation import project_all, simple_rig
from stated_tracks import stated_tracks
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.netcdf import read_displacement, write_displacement
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, structure_from_cam1
from vfm_sdm.stages.displacement.agreement import compute_gain_difference, compute_pair_differences
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.displacement.uncertainty import BudgetInputs, add_uncertainty
from vfm_sdm.stages.synchronize import align_views

FRAMES = 90
CLOCK = np.arange(FRAMES) / 30
FRAME = StructureFrame(structure_from_cam1(0.42, pitch_rad=0.03))
POINTS = np.array([[0.5, -0.2, 21.0], [-1.5, 0.3, 25.0]])
RIG = simple_rig(3)
HIDDEN = slice(40, 60)


def true_motion_mm() -> FloatArray:
    """Along the structure's axes, zero in the first frame; shape (T, 1, 3) [mm]."""
    waves = [5 * np.sin(2 * np.pi * 1.4 * CLOCK), 12 * np.sin(2 * np.pi * 2.2 * CLOCK), 0.5 * np.cos(CLOCK) - 0.5]
    return np.array(waves).T[:, None]


def tracks_of(rig: Rig = RIG, *, noise_px=0.0, seed=0, clicked_px=0.0, hidden=(), motion_mm=None) -> xr.Dataset:
    """Tracks of two points with noise of each view, clicked a little aside in each, hidden in (view, frames, point)."""
    rng = np.random.default_rng(seed)
    std = np.broadcast_to(noise_px, len(rig))
    motion = true_motion_mm() if motion_mm is None else motion_mm
    u = project_all(rig, POINTS + (motion / 1e3) @ FRAME.rotation)
    u += rng.normal(0, clicked_px, (len(rig), 1, 2, 2))
    u += rng.normal(size=u.shape) * std[:, None, None, None]
    for view, frames, point in hidden:
        u[view, frames, point] = np.nan
    stated = np.maximum(std, 1e-9)
    return align_views({n: stated_tracks(u[i], stated[i], CLOCK, names=["p", "q"]) for i, n in enumerate(rig.names)})


def pair_of(rig: Rig, tracks: xr.Dataset, first: int, second: int) -> tuple[xr.Dataset, Rig]:
    """Two of the views, in the first camera's frame as before."""
    chosen = [first, second]
    part = Rig(tuple(rig.names[v] for v in chosen), tuple(rig.cameras[v] for v in chosen), metric=True)
    return tracks.isel(view=chosen), part


def rms_mm(displacement: xr.Dataset, truth=None) -> FloatArray:
    """Of the error about its mean, shape (points, axes) [mm]."""
    error = displacement["displacement"].values - (true_motion_mm() if truth is None else truth)
    return np.std(error, axis=0)


@pytest.mark.parametrize("view", [0, 1, 2])
def test_hiding_a_point_in_one_view_costs_no_sample(view):
    tracks = tracks_of(hidden=[(view, HIDDEN, 0)])
    result = compute_displacement(tracks, RIG, frame=FRAME)
    np.testing.assert_allclose(result["displacement"].values, np.broadcast_to(true_motion_mm(), (90, 2, 3)), atol=1e-5)
    assert (result["status"].values == Status.OK).all()
    np.testing.assert_allclose(result["reprojection_error"].values, 0, atol=1e-6)
    assert np.isfinite(result["displacement_std"].values).all()


def test_every_sample_says_which_views_it_comes_from():
    tracks = tracks_of(hidden=[(2, HIDDEN, 0), (0, slice(50, 60), 0)])
    result = compute_displacement(tracks, RIG, frame=FRAME)
    assert list(result["visibility"].values) == ["view 0+view 1", "view 0+view 1+view 2"]
    seen_by = result["seen_by"].values
    assert (seen_by[40:50, 0] == 0).all()
    assert (seen_by[50:60, 0] == -1).all()
    assert (np.delete(seen_by, slice(40, 60), axis=0) == 1).all()
    assert (result["status"].values[50:60, 0] == Status.LOST).all()
    assert np.isnan(result["displacement"].values[50:60, 0]).all()
    assert "seen_by" not in compute_displacement(*pair_of(RIG, tracks, 0, 1), frame=FRAME)


def test_status_is_that_of_the_views_that_were_used():
    tracks = tracks_of()
    status, position = tracks["status"].values, tracks["position"].values
    status[2, 10, 0], position[2, 10, 0] = Status.OUTSIDE, np.nan
    status[1, 10, 0] = Status.UNRELIABLE
    status[1, 11, 0] = Status.UNRELIABLE
    position[1, 11, 0] += 30.0
    status[1:, 12, 0], position[1:, 12, 0] = [Status.UNRELIABLE, Status.OUTSIDE], [[1.0, 1.0], [np.nan, np.nan]]
    status[0, 13, 0], position[0, 13, 0] = Status.LOST, np.nan
    status[2, 13, 0], position[2, 13, 0] = Status.OUTSIDE, np.nan
    result = compute_displacement(tracks, RIG, frame=FRAME)
    assert result["status"].values[10:14, 0].tolist()[:3] == [Status.UNRELIABLE, Status.OK, Status.UNRELIABLE]
    assert result["status"].values[13, 0] in (Status.LOST, Status.OUTSIDE)
    # Two views that trust their samples are not led astray by a third that does not.
    np.testing.assert_allclose(result["displacement"].values[11, 0], true_motion_mm()[11, 0], atol=1e-4)


@pytest.mark.parametrize("hidden", [(0, HIDDEN, 0), (2, slice(0, 30), 0), (1, slice(30, 90), 0)])
def test_a_view_that_joins_or_leaves_makes_no_step(hidden):
    """Each view tracks a spot of its own, half a pixel aside, so that other views put the point elsewhere."""
    tracks = tracks_of(clicked_px=0.5, hidden=[hidden], seed=3)
    result = compute_displacement(tracks, RIG, frame=FRAME)
    np.testing.assert_allclose(result["displacement"].values, np.broadcast_to(true_motion_mm(), (90, 2, 3)), atol=0.01)
    # What the views say of themselves, without being held against each other.
    view, frames, _ = hidden
    others = [v for v in range(3) if v != view]
    aside = compute_displacement(*pair_of(RIG, tracks, *others), frame=FRAME)["position"].values[frames, 0]
    assert np.abs(1e3 * (aside - result["position"].values[frames, 0])).max() > 0.05


def test_samples_that_share_no_two_views_with_the_rest_are_not_trusted():
    tracks = tracks_of(clicked_px=0.5, hidden=[(2, slice(0, 50), 0), (0, slice(50, 90), 0)])
    result = compute_displacement(tracks, RIG, frame=FRAME)
    assert (result["status"].values[:50, 0] == Status.OK).all()
    assert (result["status"].values[50:, 0] == Status.UNRELIABLE).all()
    assert np.isfinite(result["displacement"].values).all()


def test_stated_random_std_is_the_scatter_whoever_sees():
    """Views of unlike noise; one of them sees the point in the last ten frames only, so the step is badly known."""
    hidden = [(2, slice(0, 40), 0), (0, slice(60, 90), 0)]
    still = np.zeros((FRAMES, 1, 3))
    errors = [
        compute_displacement(
            tracks_of(noise_px=[0.02, 0.03, 0.06], seed=s, hidden=hidden, motion_mm=still), RIG, frame=FRAME
        )
        for s in range(60)
    ]
    positions = np.stack([1e3 * e["position"].values for e in errors])
    deviation = positions - positions[:, :40].mean(axis=1, keepdims=True)
    stated = np.stack([e["displacement_std"].values for e in errors]).mean(axis=0)
    for frames in (slice(0, 40), slice(40, 60), slice(60, 90)):
        scatter = np.sqrt(np.mean(deviation[:, frames, 0] ** 2, axis=(0, 1)))
        np.testing.assert_allclose(scatter, stated[frames, 0].mean(axis=0), rtol=0.2)


@pytest.mark.parametrize("noise_px", [(0.02, 0.02, 0.02), (0.02, 0.02, 0.2), (0.1, 0.02, 0.03)])
def test_three_views_are_as_good_as_the_best_pair(noise_px):
    tracks = tracks_of(noise_px=noise_px)
    three = np.sqrt(np.mean(rms_mm(compute_displacement(tracks, RIG, frame=FRAME)) ** 2))
    pairs = {
        pair: np.sqrt(np.mean(rms_mm(compute_displacement(*pair_of(RIG, tracks, *pair), frame=FRAME)) ** 2))
        for pair in ((0, 1), (0, 2), (1, 2))
    }
    assert three <= 1.02 * min(pairs.values())


def test_pixel_sensitivity_is_that_of_the_views_that_see():
    tracks = tracks_of(hidden=[(2, HIDDEN, 0)])
    result = compute_displacement(tracks, RIG, frame=FRAME)
    for frame_number in (20, 50):
        of_set = result["pixel_sensitivity_seen_by"].isel(visibility=int(result["seen_by"][frame_number, 0]))
        for view in range(3):
            moved = tracks.copy(deep=True)
            moved["position"].values[view, frame_number, 0, 0] += 0.1
            change = compute_displacement(moved, RIG, frame=FRAME)["displacement"] - result["displacement"]
            stated = of_set.isel(point=0, view=view, pixel=0).values
            np.testing.assert_allclose(change.values[frame_number, 0] / 0.1, stated, atol=0.03)
    hidden = result["pixel_sensitivity_seen_by"].sel(visibility="view 0+view 1").isel(point=0, view=2)
    assert (hidden.values == 0).all()


def test_the_budget_is_that_of_the_views_that_see():
    """While a view is hidden, its clock moves nothing and what is not known of its camera does not count."""
    covariance = np.zeros((33, 33))
    covariance[20, 20] = 0.02**2  # the focal length of the third camera
    tracks = tracks_of(noise_px=0.01, hidden=[(2, HIDDEN, 0)])
    displacement = compute_displacement(tracks, RIG, frame=FRAME, covariance=covariance)
    budget = add_uncertainty(displacement, BudgetInputs(tracks, clock_std_s={"view 2": 0.005}))["uncertainty"]
    for component in ("cameras", "synchronization"):
        of_point = budget.sel(component=component, point="p").values
        assert (of_point[HIDDEN] == 0).all()
        assert np.abs(of_point[20:40]).max() > 0.01
    assert (budget.sel(component="random", point="p").values > 0).all()


def test_the_pair_that_disagrees_is_named():
    """The third view shows 8 % less of the motion of one point."""
    tracks = tracks_of(noise_px=0.005, hidden=[(0, slice(0, 20), 0)])
    rest = tracks["position"].values[2, :, 0].mean(axis=0)
    tracks["position"].values[2, :, 0] = rest + 0.92 * (tracks["position"].values[2, :, 0] - rest)
    displacement = compute_displacement(tracks, RIG, frame=FRAME)
    pairs = compute_pair_differences(tracks, displacement, RIG, FRAME)
    assert list(pairs) == [("view 0", "view 1"), ("view 0", "view 2"), ("view 1", "view 2")]
    assert abs(pairs["view 0", "view 1"][0]) < 0.01
    assert pairs["view 1", "view 2"][0] == pytest.approx(0.08, abs=0.015)
    worst = compute_gain_difference(tracks, displacement, RIG, FRAME)
    assert worst[0] == pytest.approx(0.08, abs=0.015)
    assert abs(worst[1]) < 0.01


def test_results_are_written_and_read_back(tmp_path):
    result = compute_displacement(tracks_of(hidden=[(2, HIDDEN, 0)]), RIG, frame=FRAME)
    write_displacement(tmp_path, result)
    again = read_displacement(tmp_path)
    np.testing.assert_array_equal(again["seen_by"], result["seen_by"])
    np.testing.assert_array_equal(again["visibility_views"], result["visibility_views"])
