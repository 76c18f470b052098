"""Refinement against SciPy on the same residuals, against exact truth, and at its edges."""

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import least_squares

from simulation import intrinsics, looking_at
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import triangulate, triangulate_with_slope, view_equations
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.refinement import REFINEMENT_STATUSES, SgrSettings, SgrWeights, refine, solver

FPS = 30.0
VIEWS = ("left", "right")
AMPLITUDE_MM = (4.0, 6.0, 0.1)  # peak to peak 8, 12 and 0.2 mm: the paper's footbridge


def footbridge_site(*, k1: float = 0.0) -> tuple[Rig, StructureFrame, tuple[Camera, ...]]:
    """The paper's site: cameras in the structure's axes, 9.8 m from the face and 22.4 m along it."""
    target = np.array([9.8, 0.0, 22.4])
    cameras = tuple(
        Camera(intrinsics(15500.0), (3840, 2160), np.array([k1, 0, 0, 0, 0]), looking_at(center, target))
        for center in (np.zeros(3), np.array([2.2, -0.05, -3.3]))
    )
    return Rig.from_world(VIEWS, cameras, metric=True), StructureFrame(cameras[0].rotation.T), cameras


def true_motion_mm(frames: int, amplitude_mm: tuple[float, float, float] = AMPLITUDE_MM) -> FloatArray:
    """Along lateral, vertical, longitudinal, relative to the first frame; (frames, 3)."""
    phase = 2 * np.pi * np.outer(np.arange(frames) / FPS, [2.1, 2.6, 2.9]) + [0.0, 0.7, 1.9]
    wave = np.asarray(amplitude_mm) * np.sin(phase)
    return wave - wave[0]


def simulate(
    *,
    seed: int = 0,
    frames: int = 45,
    points: int = 1,
    std_px: tuple[float, float] = (0.02, 0.1),
    k1: float = 0.0,
    gaps: float = 0.0,
    amplitude_mm: tuple[float, float, float] = AMPLITUDE_MM,
) -> tuple[xr.Dataset, Rig, StructureFrame]:
    """Noisy tracks of points on the girder; as a tracker's, they are exact in the first frame."""
    rng = np.random.default_rng(seed)
    rig, frame, cameras = footbridge_site(k1=k1)
    spread = rng.uniform(-1, 1, (points, 3)) * [0.05, 0.5, 2.5]
    X = np.array([9.8, 0.0, 22.4]) + spread + true_motion_mm(frames, amplitude_mm)[:, None] / 1e3
    views = []
    for camera, std in zip(cameras, std_px, strict=True):
        noise = rng.normal(0, std, (frames, points, 2))
        noise[0] = 0.0
        position = camera.project(X) + noise
        position[rng.random((frames, points)) < gaps] = np.nan
        covariance = np.broadcast_to(std**2 * np.eye(2), (frames, points, 2, 2)).copy()
        covariance[0] = 0.0
        clock = np.arange(frames) / FPS
        names = [f"p{k}" for k in range(points)]
        views.append(
            make_tracks(clock, names, position, covariance, np.zeros((frames, points)), attrs={"tracker": "x"})
        )
    return xr.concat(views, dim="view").assign_coords(view=list(VIEWS)).transpose("view", ...), rig, frame


def paper_residuals(
    tracks: xr.Dataset, rig: Rig, frame: StructureFrame, view: int, *, suppressed: int = 2
) -> tuple[object, FloatArray]:
    """Residuals of one point as a function of the corrections of its valid frames, and those frames.

    Written from the paper's equation, with the paper's weights; scales are root mean squares of the baseline.
    """
    pixels = tracks["position"].values[:, :, 0]
    frames = np.flatnonzero(np.isfinite(triangulate(pixels, rig)).all(axis=-1))
    pairs = np.flatnonzero(np.diff(frames) == 1)
    others = [axis for axis in range(3) if axis != suppressed]

    def displacement(correction: FloatArray) -> FloatArray:
        moved = pixels[:, frames].copy()
        moved[view, :, 0] += correction
        return triangulate(moved, rig) @ frame.rotation.T - origin

    def difference(values: FloatArray) -> FloatArray:
        return values[pairs + 1] - values[pairs]

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(np.sum(values.reshape(len(values), -1) ** 2, axis=1))))

    origin = np.zeros(3)
    origin = displacement(np.zeros(len(frames)))[0]
    baseline = displacement(np.zeros(len(frames)))
    scale_z, scale_dz = rms(baseline[:, suppressed]), rms(difference(baseline[:, suppressed]))
    scale_xy, scale_dxy = rms(baseline[:, others]), rms(difference(baseline[:, others]))
    scale_u = rms(pixels[view, frames, 0] - pixels[view, frames[0], 0])

    def residuals(correction: FloatArray) -> FloatArray:
        current = displacement(correction)
        departure = (current - baseline)[:, others]
        return np.concatenate(
            [
                np.sqrt(4.0) * current[:, suppressed] / scale_z,
                np.sqrt(8.0) * difference(current[:, suppressed]) / scale_dz,
                np.sqrt(6.0) * departure.ravel() / scale_xy,
                np.sqrt(12.0) * difference(departure).ravel() / scale_dxy,
                np.sqrt(0.05) * correction / scale_u,
            ]
        )

    return residuals, frames


def rmse_mm(tracks: xr.Dataset, rig: Rig, frame: StructureFrame) -> FloatArray:
    measured = compute_displacement(tracks, rig, frame=frame)["displacement"].values
    return np.sqrt(((measured - true_motion_mm(len(measured))[:, None]) ** 2).mean(axis=(0, 1)))


@pytest.mark.parametrize("gaps", [0.0, 0.08])
@pytest.mark.parametrize("view", [0, 1])
@pytest.mark.parametrize("seed", range(5))
def test_minimum_is_that_of_scipy(seed, view, gaps):
    std = (0.02, 0.1) if view else (0.1, 0.02)
    k1 = float(np.random.default_rng(seed).uniform(-0.3, 0.3))
    tracks, rig, frame = simulate(seed=seed, std_px=std, k1=k1, gaps=gaps)
    refinement = refine(tracks, rig, frame)
    assert refinement.status == ("ok",)
    assert refinement.uncertain_view == (VIEWS[view],)
    residuals, frames = paper_residuals(tracks, rig, frame, view)
    dense = least_squares(residuals, np.zeros(len(frames)), ftol=1e-11)
    assert np.abs(refinement.correction_px[frames, 0] - dense.x).max() < 1e-4
    assert refinement.cost[0] == pytest.approx(2 * dense.cost, rel=1e-7)
    assert np.abs(dense.x).max() > 0.1
    assert len(frames) < 45 if gaps else len(frames) == 45


def test_minimum_with_large_corrections():
    tracks, rig, frame = simulate(std_px=(0.02, 8.0), k1=0.3, frames=30)
    refinement = refine(tracks, rig, frame)
    residuals, frames = paper_residuals(tracks, rig, frame, 1)
    dense = least_squares(residuals, np.zeros(len(frames)), ftol=1e-11)
    assert refinement.cost[0] == pytest.approx(2 * dense.cost, rel=1e-7)
    assert np.abs(refinement.correction_px[:, 0] - dense.x).max() < 1e-4
    assert np.abs(dense.x).max() > 4


def test_steps_that_are_too_long_are_shortened(monkeypatch):
    tracks, rig, frame = simulate()
    expected = refine(tracks, rig, frame)
    solve = solver.solveh_banded
    monkeypatch.setattr(solver, "solveh_banded", lambda *args, **options: 3 * solve(*args, **options))
    refinement = refine(tracks, rig, frame)
    assert refinement.status == ("ok",)
    assert refinement.iterations[0] > expected.iterations[0]
    np.testing.assert_allclose(refinement.correction_px, expected.correction_px, atol=2e-3)


def test_another_axis_can_be_suppressed():
    tracks, rig, frame = simulate(seed=3, amplitude_mm=(0.1, 6.0, 4.0))
    refinement = refine(tracks, rig, frame, settings=SgrSettings(suppressed_axis="lateral"))
    residuals, frames = paper_residuals(tracks, rig, frame, 1, suppressed=0)
    assert np.abs(least_squares(residuals, np.zeros(len(frames))).x - refinement.correction_px[:, 0]).max() < 1e-4
    assert refinement.gain[0, 0, 0] < 0.8
    assert refinement.gain[0, 2, 2] == 1.0


@pytest.mark.parametrize("k1", [0.0, 0.3])
@pytest.mark.parametrize("view", [0, 1])
def test_derivative_of_triangulation(view, k1):
    tracks, rig, _ = simulate(seed=1, points=8, k1=k1)
    pixels = tracks["position"].values.reshape(2, -1, 2)
    normalized = [c.normalize(u) for c, u in zip(rig.cameras, pixels, strict=True)]
    equations = tuple(view_equations(c, x) for c, x in zip(rig.cameras, normalized, strict=True))
    points3d, slope = triangulate_with_slope(equations, rig.cameras[view], normalized[view], view=view)
    np.testing.assert_allclose(points3d.T, triangulate(pixels, rig), rtol=1e-12)
    step = np.zeros_like(pixels)
    step[view, :, 0] = 0.05
    expected = (triangulate(pixels + step, rig) - triangulate(pixels - step, rig)).T / 0.1
    np.testing.assert_allclose(slope, expected, atol=1e-7 * np.abs(expected).max())


def test_noise_like_the_papers():
    tracks, rig, frame = simulate(frames=480, points=20)
    refinement = refine(tracks, rig, frame)
    before, after = rmse_mm(tracks, rig, frame), rmse_mm(refinement.tracks, rig, frame)
    assert after[0] <= 0.5 * before[0]
    assert after[1] <= 1.02 * before[1]
    assert after[2] <= 0.5 * before[2]


def test_only_u_of_the_uncertain_view_changes():
    tracks, rig, frame = simulate(points=3, gaps=0.05)
    given = tracks.copy(deep=True)
    refinement = refine(tracks, rig, frame)
    xr.testing.assert_identical(tracks, given)
    before, after = tracks["position"].values, refinement.tracks["position"].values
    np.testing.assert_array_equal(after[0], before[0])
    np.testing.assert_array_equal(after[1, ..., 1], before[1, ..., 1])
    added = refinement.correction_px
    np.testing.assert_array_equal(after[1, ..., 0], before[1, ..., 0] + np.where(np.isnan(added), 0.0, added))
    assert np.nanmax(np.abs(added)) > 0.05
    assert refinement.tracks.attrs["refined_view"] == "right"
    assert refinement.tracks["position_covariance"].identical(tracks["position_covariance"])


def test_points_do_not_influence_each_other():
    tracks, rig, frame = simulate(frames=40, points=3, gaps=0.05)
    together = refine(tracks, rig, frame)
    for index in range(3):
        alone = refine(tracks.isel(point=[index]), rig, frame)
        np.testing.assert_allclose(together.correction_px[:, index], alone.correction_px[:, 0], atol=1e-7)


def test_parts_of_a_long_series_over_a_gap():
    # A gap cuts every coupling but the scales; with scales of both halves equal, halves are refined as the whole is.
    tracks, rig, frame = simulate(frames=41)
    position = tracks["position"].values
    position[:, 21:] = position[:, :20]
    position[:, 20] = np.nan
    whole = refine(tracks, rig, frame).correction_px[:, 0]
    assert np.isnan(whole[20])
    np.testing.assert_allclose(whole[21:], whole[:20], atol=1e-7)
    half = refine(tracks.isel(time=slice(0, 20)), rig, frame).correction_px[:, 0]
    np.testing.assert_allclose(whole[:20], half, atol=1e-6)


def test_a_missing_sample_next_to_none_has_only_its_own_terms():
    tracks, rig, frame = simulate(frames=30)
    tracks["position"].values[:, 1::2] = np.nan
    refinement = refine(tracks, rig, frame)
    residuals, frames = paper_residuals_without_pairs(tracks, rig, frame)
    np.testing.assert_allclose(refinement.correction_px[frames, 0], least_squares(residuals, np.zeros(15)).x, atol=1e-4)


def paper_residuals_without_pairs(tracks, rig, frame):
    pixels = tracks["position"].values[:, ::2, 0]

    def displacement(correction):
        moved = pixels.copy()
        moved[1, :, 0] += correction
        return (triangulate(moved, rig) - triangulate(pixels[:, :1], rig)) @ frame.rotation.T

    baseline = displacement(np.zeros(15))
    scale = np.sqrt([np.mean(baseline[:, 2] ** 2), np.mean(np.sum(baseline[:, :2] ** 2, axis=1))])
    scale_u = np.sqrt(np.mean((pixels[1, :, 0] - pixels[1, 0, 0]) ** 2))

    def residuals(correction):
        current = displacement(correction)
        departure = (current - baseline)[:, :2].ravel()
        return np.concatenate(
            [2 * current[:, 2] / scale[0], np.sqrt(6) * departure / scale[1], np.sqrt(0.05) * correction / scale_u]
        )

    return residuals, np.arange(0, 30, 2)


def test_still_interval_is_the_origin():
    tracks, rig, frame = simulate(frames=90, amplitude_mm=(4.0, 6.0, 0.0))
    tracks["position"].values[1, 0, 0, 0] += 3.0  # a bad first frame is no origin when a still interval is given
    first = refine(tracks, rig, frame)
    still = refine(tracks, rig, frame, still_interval_s=(0.5, 2.5))
    assert abs(np.median(still.correction_px)) < 0.05
    assert np.median(first.correction_px) > 1.0


def test_true_motion_passes_as_gain_says():
    # Longitudinal noise is white in the frames, so the gain is that of broadband motion.
    tracks, rig, frame = simulate(frames=4000, seed=5)
    refinement = refine(tracks, rig, frame)
    before = compute_displacement(tracks, rig, frame=frame)["displacement"].values[:, 0]
    after = compute_displacement(refinement.tracks, rig, frame=frame)["displacement"].values[:, 0]
    change = (after - before).T @ before[:, 2] / (before[:, 2] @ before[:, 2])
    np.testing.assert_allclose(np.eye(3)[2] + change, refinement.gain[0][:, 2], atol=0.02)
    assert refinement.prior_share[0] == pytest.approx(1 - refinement.gain[0, 2, 2])
    assert 0.8 < refinement.prior_share[0] < 1.0


def test_true_lateral_motion_is_kept_and_true_longitudinal_motion_is_lost():
    tracks, rig, frame = simulate(frames=120, std_px=(0.0, 0.0), amplitude_mm=(4.0, 6.0, 0.0))
    settings = SgrSettings(uncertain_view=1)
    kept = refine(tracks, rig, frame, settings=settings)
    np.testing.assert_allclose(rmse_of(kept, rig, frame, (4, 6, 0)), 0, atol=1e-4)
    tracks, rig, frame = simulate(frames=120, std_px=(0.0, 0.0), amplitude_mm=(4.0, 6.0, 2.0))
    refinement = refine(tracks, rig, frame, settings=settings)
    assert rmse_of(refinement, rig, frame, (4, 6, 2))[2] > 0.5
    assert refinement.prior_share[0] > 0.6


def rmse_of(refinement, rig, frame, amplitude_mm):
    measured = compute_displacement(refinement.tracks, rig, frame=frame)["displacement"].values[:, 0]
    return np.sqrt(((measured - true_motion_mm(len(measured), amplitude_mm)) ** 2).mean(axis=0))


def test_a_point_at_rest_is_left_at_rest():
    tracks, rig, frame = simulate(std_px=(0.0, 0.0), amplitude_mm=(0.0, 0.0, 0.0))
    refinement = refine(tracks, rig, frame, settings=SgrSettings(uncertain_view="right"))
    assert refinement.status == ("ok",)
    assert np.abs(refinement.correction_px).max() < 1e-9


def test_every_refusal_has_a_name_and_leaves_the_tracks_alone():
    tracks, rig, frame = simulate(frames=40, points=6)
    covariance, position = tracks["position_covariance"].values, tracks["position"].values
    covariance[:, 1:, 1] = 0.6**2 * np.eye(2)
    covariance[1, :, 2] = 0.0
    position[0, 2:, 3] = np.nan
    position[1, 20:, 4] = np.nan
    covariance[0, 1:, 5] = 0.3**2 * np.eye(2)
    refinement = refine(tracks, rig, frame, still_interval_s=(0.7, 1.3))
    assert refinement.status == (
        "ok",
        "both views poor",
        "uncertainty unknown",
        "too few frames",
        "no still frames",
        "ok",
    )
    assert set(refinement.status) < set(REFINEMENT_STATUSES)
    assert refinement.uncertain_view == ("right", None, None, "right", "right", "left")
    after = refinement.tracks["position"].values
    np.testing.assert_array_equal(after[:, :, 1:5], position[:, :, 1:5])
    assert (refinement.correction_px[:, 1] == 0).all()
    assert np.isnan(refinement.cost[1:5]).all()
    assert np.isnan(refinement.gain[1:5]).all()
    assert np.isfinite(refinement.cost[[0, 5]]).all()


def test_a_named_view_needs_no_covariance_but_still_a_good_reference():
    tracks, rig, frame = simulate(frames=40, points=2)
    tracks["position_covariance"].values[:, :, 0] = 0.0
    tracks["position_covariance"].values[:, 1:, 1] = np.eye(2)
    refinement = refine(tracks, rig, frame, settings=SgrSettings(uncertain_view="left"))
    assert refinement.status == ("ok", "both views poor")
    assert refinement.uncertain_view == ("left", None)


def test_too_few_steps_are_not_converged():
    tracks, rig, frame = simulate()
    refinement = refine(tracks, rig, frame, settings=SgrSettings(max_iterations=1))
    assert refinement.status == ("not converged",)
    np.testing.assert_array_equal(refinement.correction_px, 0.0)
    xr.testing.assert_equal(refinement.tracks, tracks)
    assert refinement.tracks.attrs["refined_view"] == ""


def test_misuse_raises():
    tracks, rig, frame = simulate(frames=10)
    with pytest.raises(DatasetError, match="two views, got 1 and 2"):
        refine(tracks.isel(view=[0]), rig, frame)
    three = Rig((*rig.names, "third"), (*rig.cameras, rig.cameras[1]), metric=True)
    with pytest.raises(DatasetError, match=r"expected views \['left', 'right', 'third'\], got \['left', 'right'\]"):
        refine(tracks, three, frame)
    with pytest.raises(DatasetError, match="expected views"):
        refine(tracks.isel(view=[1, 0]), rig, frame)
    with pytest.raises(DatasetError, match="uncertain view: expected"):
        refine(tracks, rig, frame, settings=SgrSettings(uncertain_view="middle"))
    with pytest.raises(DatasetError, match="still interval: expected frames"):
        refine(tracks, rig, frame, still_interval_s=(7.0, 8.0))
    with pytest.raises(DatasetError, match="suppressed axis"):
        SgrSettings(suppressed_axis="forward")
    with pytest.raises(DatasetError, match="max_iterations > 0"):
        SgrSettings(max_iterations=0)
    with pytest.raises(DatasetError, match="weights: expected"):
        SgrWeights(others=-1.0)
    with pytest.raises(DatasetError, match="pixel > 0"):
        SgrWeights(pixel=0.0)
