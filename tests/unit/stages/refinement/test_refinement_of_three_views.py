"""Refinement of three views: one of them is corrected, all of them triangulate."""

import numpy as np
import pytest
import xarray as xr

from simulation import intrinsics, looking_at
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.displacement.uncertainty import BudgetInputs, add_uncertainty
from vfm_sdm.stages.refinement import SgrSettings, refine

FPS = 30.0
TARGET = np.array([9.8, 0.0, 22.4])
VIEWS = ("left", "right", "third")
PLACES = {
    "in a row": ((0, 0, 0), (2.2, -0.05, -3.3), (4.4, -0.1, -6.6)),
    "about the first": ((0, 0, 0), (2.2, -0.05, -3.3), (-2.0, -0.5, 3.0)),
}


def site(places="in a row") -> tuple[Rig, StructureFrame, list[Camera]]:
    """Cameras in the structure's axes, the footbridge of `test_refinement` and one more camera."""
    cameras = [
        Camera(intrinsics(15500.0), (3840, 2160), np.zeros(5), looking_at(np.array(center, float), TARGET))
        for center in PLACES[places]
    ]
    return Rig.from_world(VIEWS, cameras, metric=True), StructureFrame(cameras[0].rotation.T), cameras


def true_motion_mm(frames: int, amplitude_mm=(4.0, 6.0, 0.1)) -> FloatArray:
    phase = 2 * np.pi * np.outer(np.arange(frames) / FPS, [2.1, 2.6, 2.9]) + [0.0, 0.7, 1.9]
    wave = np.asarray(amplitude_mm) * np.sin(phase)
    return wave - wave[0]


def simulate(std_px, *, places="in a row", frames=200, points=6, seed=0, hidden=()):
    """Noisy tracks of points on the girder, hidden in (view, frames, point)."""
    rng = np.random.default_rng(seed)
    rig, frame, cameras = site(places)
    X = TARGET + rng.uniform(-1, 1, (points, 3)) * [0.05, 0.5, 2.5] + true_motion_mm(frames)[:, None] / 1e3
    views = []
    for view, (camera, std) in enumerate(zip(cameras, std_px, strict=True)):
        noise = rng.normal(0, std, (frames, points, 2))
        noise[0] = 0.0
        position, status = camera.project(X) + noise, np.zeros((frames, points), int)
        for hidden_view, part, point in hidden:
            if hidden_view == view:
                position[part, point], status[part, point] = np.nan, Status.LOST
        covariance = np.broadcast_to(std**2 * np.eye(2), (frames, points, 2, 2)).copy()
        covariance[0] = 0.0
        names = [f"p{k}" for k in range(points)]
        views.append(make_tracks(np.arange(frames) / FPS, names, position, covariance, status, attrs={"tracker": "x"}))
    return xr.concat(views, dim="view").assign_coords(view=list(VIEWS)).transpose("view", ...), rig, frame


def pair_of(tracks, rig, first, second):
    names = [rig.names[first], rig.names[second]]
    return tracks.sel(view=names), Rig(tuple(names), (rig.cameras[first], rig.cameras[second]), metric=True)


def in_plane_rms_mm(tracks, rig, frame) -> float:
    measured = compute_displacement(tracks, rig, frame=frame)["displacement"].values
    error = measured - true_motion_mm(len(measured))[:, None]
    return float(np.sqrt(np.mean(error[..., :2] ** 2)))


@pytest.mark.parametrize("places", PLACES)
@pytest.mark.parametrize("std_px", [(0.02,) * 3, (0.02, 0.1, 0.02), (0.02, 0.02, 0.1), (0.1, 0.1, 0.02)], ids=str)
def test_three_refined_views_are_as_good_as_the_best_refined_pair(places, std_px):
    tracks, rig, frame = simulate(std_px, places=places)
    three = in_plane_rms_mm(refine(tracks, rig, frame).tracks, rig, frame)
    pairs = []
    for first, second in ((0, 1), (0, 2), (1, 2)):
        part, part_rig = pair_of(tracks, rig, first, second)
        pairs.append(in_plane_rms_mm(refine(part, part_rig, frame).tracks, part_rig, frame))
    assert three < 1.05 * min(pairs)
    assert three < in_plane_rms_mm(tracks, rig, frame)


def test_it_says_which_view_it_corrected_against_which():
    """A view that is noisy and weighs little adds less noise along the bridge than a good one far from the others."""
    tracks, rig, frame = simulate((0.02, 0.1, 0.02))
    refinement = refine(tracks, rig, frame)
    assert set(refinement.uncertain_view) <= {"left", "third"}
    for view, others in zip(refinement.uncertain_view, refinement.reference_views, strict=True):
        assert set(others) == set(VIEWS) - {view}
    assert refinement.tracks["refined_view"].values.tolist() == list(refinement.uncertain_view)
    before, after = tracks["position"].values, refinement.tracks["position"].values
    for point, view in enumerate(refinement.uncertain_view):
        for other in set(VIEWS) - {view}:
            index = VIEWS.index(other)
            np.testing.assert_array_equal(after[index, :, point], before[index, :, point])
    named = refine(tracks, rig, frame, settings=SgrSettings(uncertain_view="right"))
    assert set(named.uncertain_view) == {"right"}
    assert refine(tracks, rig, frame, settings=SgrSettings(uncertain_view=2)).uncertain_view == ("third",) * 6


def test_a_point_that_one_view_never_sees_is_a_matter_of_the_other_two():
    tracks, rig, frame = simulate((0.02, 0.1, 0.02), hidden=[(2, slice(None), 0)])
    refinement = refine(tracks, rig, frame)
    assert refinement.uncertain_view[0] == "right"
    assert refinement.reference_views[0] == ("left",)
    alone = refine(*pair_of(tracks.isel(point=[0]), rig, 0, 1), frame)
    np.testing.assert_allclose(refinement.correction_px[:, 0], alone.correction_px[:, 0], atol=1e-3)


def test_hiding_a_point_in_one_view_costs_no_sample():
    hidden = [(2, slice(50, 80), 0), (0, slice(50, 80), 1)]
    tracks, rig, frame = simulate((0.02, 0.02, 0.02), hidden=hidden)
    refinement = refine(tracks, rig, frame)
    assert set(refinement.status) == {"ok"}
    result = compute_displacement(refinement.tracks, rig, frame=frame, refinement_gain=refinement.gain)
    assert (result["status"].values == Status.OK).all()
    error = result["displacement"].values - true_motion_mm(200)[:, None]
    shown, gap = error[:50, :2, :2], error[50:80, :2, :2]
    assert np.sqrt(np.mean(gap**2)) < 4 * np.sqrt(np.mean(shown**2))
    assert np.abs(gap.mean(axis=0)).max() < 0.1
    # Where the corrected view is hidden there is nothing to correct, and the sample's uncertainty says so.
    for point in range(2):
        missing = VIEWS[(2, 0)[point]] == refinement.uncertain_view[point]
        assert np.isnan(refinement.correction_px[50:80, point]).all() == missing
        if missing:
            std = result["displacement_std"].values[:, point, 2]
            assert std[50:80].min() > 3 * np.nanmax(std[:50])


def test_what_is_not_refined_does_not_rest_on_the_assumption():
    tracks, rig, frame = simulate((0.02, 0.02, 0.1), hidden=[(0, slice(50, 80), 0)])
    refinement = refine(tracks, rig, frame, settings=SgrSettings(uncertain_view="left"))
    unrefined = compute_displacement(tracks, rig, frame=frame)
    refined = compute_displacement(refinement.tracks, rig, frame=frame, refinement_gain=refinement.gain)
    inputs = BudgetInputs(tracks, baseline=(unrefined, "longitudinal"), refinement_gain=refinement.gain)
    assumption = add_uncertainty(refined, inputs)["uncertainty"].sel(component="assumption", point="p0").values
    assert (assumption[50:80] == 0).all()
    assert (assumption[:50, 2] > 0).all()


def test_true_motion_passes_as_gain_says():
    tracks, rig, frame = simulate((0.02, 0.02, 0.05), frames=3000, points=1, seed=5)
    refinement = refine(tracks, rig, frame)
    before = compute_displacement(tracks, rig, frame=frame)["displacement"].values[:, 0]
    after = compute_displacement(refinement.tracks, rig, frame=frame)["displacement"].values[:, 0]
    change = (after - before).T @ before[:, 2] / (before[:, 2] @ before[:, 2])
    np.testing.assert_allclose(np.eye(3)[2] + change, refinement.gain[0][:, 2], atol=0.03)


def test_too_poor_or_unknown_views_are_named():
    tracks, rig, frame = simulate((0.6, 0.7, 0.8))
    assert set(refine(tracks, rig, frame).status) == {"both views poor"}
    tracks, rig, frame = simulate((0.6, 0.02, 0.8))
    assert set(refine(tracks, rig, frame).status) == {"ok"}
    tracks["position_covariance"].values[1:] = 0.0
    assert set(refine(tracks, rig, frame).status) == {"uncertainty unknown"}
    with pytest.raises(DatasetError, match="uncertain view: expected 'auto', 0, 1, 2 or one of"):
        refine(tracks, rig, frame, settings=SgrSettings(uncertain_view="fourth"))
