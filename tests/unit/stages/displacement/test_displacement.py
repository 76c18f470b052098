import numpy as np
import pytest
import xarray as xr

from simulation import project_all, simple_rig
from stated_tracks import stated_tracks
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.structure_frame import StructureFrame, structure_from_cam1
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.synchronize import align_views

CLOCK = np.arange(90) / 30
FRAME = StructureFrame(structure_from_cam1(0.42, pitch_rad=0.03))
POINTS = np.array([[0.5, -0.2, 21.0], [-1.5, 0.3, 25.0]])


def true_motion_mm():
    """Displacement along the structure's axes, (T, 1, 3) [mm]; at rest for the first third of a second."""
    moving = np.clip((CLOCK - 1 / 3) * 3, 0, 1)
    waves = [5 * np.sin(2 * np.pi * 1.4 * CLOCK), 12 * np.sin(2 * np.pi * 2.2 * CLOCK), 0.5 * np.cos(CLOCK) - 0.5]
    return (moving * np.array(waves)).T[:, None]


def tracks_of(rig, *, noise_px=0.0, seed=0, motion_mm=None):
    motion = true_motion_mm() if motion_mm is None else motion_mm
    X = POINTS + (motion / 1e3) @ FRAME.rotation
    u = project_all(rig, X) + np.random.default_rng(seed).normal(0, noise_px, (len(rig), *X.shape[:2], 2))
    stated = max(noise_px, 1e-9)
    return align_views({n: stated_tracks(u[i], stated, CLOCK, names=["p", "q"]) for i, n in enumerate(rig.names)})


@pytest.mark.parametrize("views", [2, 3])
def test_exact_without_noise(views):
    rig = simple_rig(views, distortion=True)
    result = compute_displacement(tracks_of(rig), rig, frame=FRAME, covariance=np.zeros((10 * views + 3,) * 2))
    np.testing.assert_allclose(result["displacement"].values, np.broadcast_to(true_motion_mm(), (90, 2, 3)), atol=1e-5)
    assert result["displacement"].attrs["units"] == "mm"
    assert list(result["axis"].values) == ["lateral", "vertical", "longitudinal"]
    assert result.attrs["frame"] == "structure"
    assert result["scale_std"].values == pytest.approx(0)
    np.testing.assert_allclose(result["reprojection_error"].values, 0, atol=1e-6)


def test_stated_random_std_is_the_scatter():
    rig = simple_rig()
    still = np.zeros((90, 1, 3))
    errors = [
        compute_displacement(tracks_of(rig, noise_px=0.02, seed=s, motion_mm=still), rig, frame=FRAME)
        for s in range(30)
    ]
    scatter = xr.concat([e["position"] * 1e3 for e in errors], "trial").std("trial").mean("time")
    stated = errors[0]["displacement_std"].mean("time")
    np.testing.assert_allclose(scatter, stated, rtol=0.12)


def test_a_refinement_s_gain_shapes_the_stated_std_and_nothing_else():
    rig = simple_rig()
    still = np.zeros((90, 1, 3))
    gain = np.full((2, 3, 3), np.nan)
    gain[0] = [[0.9, 0.0, 0.3], [0.1, 1.0, 0.0], [0.0, 0.05, 0.1]]
    plain = [
        compute_displacement(tracks_of(rig, noise_px=0.02, seed=s, motion_mm=still), rig, frame=FRAME)
        for s in range(30)
    ]
    tracks = tracks_of(rig, noise_px=0.02, motion_mm=still)
    result = compute_displacement(tracks, rig, frame=FRAME, refinement_gain=gain)
    # What the gain makes of noise, by drawing it.
    noise = xr.concat([one["position"] * 1e3 for one in plain], "trial").values
    refined = (noise - noise.mean(axis=0))[:, :, 0] @ gain[0].T
    stated = result["displacement_std"].mean("time").values
    np.testing.assert_allclose(refined.std(axis=0, ddof=1).mean(axis=0), stated[0], rtol=0.12)
    assert stated[0, 2] < 0.2 * plain[0]["displacement_std"].mean("time").values[0, 2]
    # A point that was not refined keeps what it had, and the tracks are refined already.
    np.testing.assert_array_equal(result["displacement_std"].values[:, 1], plain[0]["displacement_std"].values[:, 1])
    np.testing.assert_array_equal(result["displacement"].values, plain[0]["displacement"].values)


def test_pixel_sensitivity_is_the_millimetres_of_a_pixel():
    rig = simple_rig()
    tracks = tracks_of(rig)
    result = compute_displacement(tracks, rig, frame=FRAME)
    sensitivity = result["pixel_sensitivity"]
    assert sensitivity.dims == ("point", "axis", "view", "pixel")
    assert sensitivity.attrs["units"] == "mm/px"
    assert list(sensitivity["view"].values) == list(rig.names)
    for view in range(2):
        for pixel in range(2):
            moved = tracks.copy(deep=True)
            moved["position"].values[view, 50, :, pixel] += 0.1
            change = compute_displacement(moved, rig, frame=FRAME)["displacement"] - result["displacement"]
            stated = sensitivity.isel(view=view, pixel=pixel).values
            np.testing.assert_allclose(change.values[50] / 0.1, stated, atol=0.01 * np.abs(stated).max())


def test_gain_covariance_is_that_of_the_gains_stated():
    rig = simple_rig()
    covariance = np.diag(np.concatenate([np.tile([0.01, 4.0, 4.0, *[0.0] * 7], 2), [0.004] * 3]) ** 2)
    gain = np.full((2, 3, 3), np.nan)
    gain[0] = [[1.0, 0.0, 0.3], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1]]
    plain = compute_displacement(tracks_of(rig), rig, frame=FRAME, covariance=covariance)
    result = compute_displacement(tracks_of(rig), rig, frame=FRAME, covariance=covariance, refinement_gain=gain)
    for one in (plain, result):
        assert one["gain_covariance"].dims == ("point", "axis", "motion_axis", "motion_axis_2")
        np.testing.assert_allclose(
            np.einsum("pabb->pab", one["gain_covariance"].values), one["gain_std"].values ** 2, rtol=1e-9
        )
        np.testing.assert_allclose(np.einsum("paa->pa", one["gain_std"].values), one["scale_std"].values, rtol=1e-9)
    # The refinement leaves a tenth of what wrong cameras bring along the suppressed axis; q was not refined.
    np.testing.assert_allclose(result["gain_std"].values[0, 2], 0.1 * plain["gain_std"].values[0, 2], rtol=1e-9)
    np.testing.assert_array_equal(result["gain_covariance"].values[1], plain["gain_covariance"].values[1])
    assert np.isnan(compute_displacement(tracks_of(rig), rig)["gain_covariance"].values).all()


def test_without_distances_axes_are_the_cameras():
    rig = simple_rig()
    result = compute_displacement(tracks_of(rig), rig)
    assert list(result["axis"].values) == ["right", "down", "forward"]
    assert result.attrs["frame"] == "reference camera"
    in_structure = result["displacement"].values @ FRAME.rotation.T
    np.testing.assert_allclose(in_structure, np.broadcast_to(true_motion_mm(), (90, 2, 3)), atol=1e-5)


def test_unknown_camera_covariance_is_an_unknown_scale_not_a_sure_one():
    rig = simple_rig()
    assert np.isnan(compute_displacement(tracks_of(rig), rig)["scale_std"].values).all()


def test_relative_to_the_mean_of_a_still_interval():
    rig = simple_rig()
    tracks = tracks_of(rig, noise_px=0.05)
    result = compute_displacement(tracks, rig, frame=FRAME, still_interval_s=(0.0, 0.3))
    still = result["displacement"].sel(time=slice(0, 0.3)).mean("time")
    np.testing.assert_allclose(still, 0, atol=1e-9)
    assert result.attrs["relative_to"] == "mean of the still interval"


def test_lost_in_one_view_is_missing_and_says_why():
    rig = simple_rig()
    tracks = tracks_of(rig)
    tracks["position"].values[1, 10:20, 0] = np.nan
    tracks["status"].values[1, 10:20, 0] = Status.OUTSIDE
    tracks["status"].values[0, 30, 1] = Status.UNRELIABLE
    result = compute_displacement(tracks, rig, frame=FRAME)
    missing = np.isnan(result["displacement"].values).all(axis=-1)
    assert missing[10:20, 0].all()
    assert missing.sum() == 10
    assert (result["status"].values[10:20, 0] == Status.OUTSIDE).all()
    assert result["status"].values[30, 1] == Status.UNRELIABLE
    np.testing.assert_allclose(result["displacement"].values[25, 0], true_motion_mm()[25, 0], atol=1e-5)


def test_point_lost_in_the_first_frame_starts_from_its_first_valid_sample():
    rig = simple_rig()
    tracks = tracks_of(rig)
    tracks["position"].values[0, :5, 0] = np.nan
    tracks["status"].values[0, :5, 0] = Status.LOST
    result = compute_displacement(tracks, rig, frame=FRAME)
    expected = true_motion_mm()[:, 0] - true_motion_mm()[5, 0]
    np.testing.assert_allclose(result["displacement"].values[5:, 0], expected[5:], atol=1e-5)


def test_rays_that_meet_behind_a_camera_are_not_numbers():
    rig = simple_rig()
    tracks = tracks_of(rig)
    # The cameras look towards each other; rays turned apart by more than that meet behind them.
    tracks["position"].values[1, ..., 0] += 3000.0
    result = compute_displacement(tracks, rig, frame=FRAME)
    assert np.isnan(result["displacement"].values).all()
    assert (result["status"].values == Status.BEHIND).all()


def test_misuse_is_refused():
    rig = simple_rig()
    tracks = tracks_of(rig)
    with pytest.raises(DatasetError, match="expected views"):
        compute_displacement(tracks.isel(view=[1, 0]), rig)
    with pytest.raises(DatasetError, match="expected metres"):
        compute_displacement(tracks, rig.scaled(0.1, metric=False))
    with pytest.raises(DatasetError, match="still interval: expected frames between 7"):
        compute_displacement(tracks, rig, still_interval_s=(7.0, 8.0))
    with pytest.raises(DatasetError, match="expected dims"):
        compute_displacement(tracks.isel(view=0), rig)
