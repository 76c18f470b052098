"""Tracks are corrected by a gain where it is certain, and say what is left."""

import numpy as np
import xarray as xr

from stated_tracks import stated_tracks
from vfm_sdm.stages.tracking.injection.views import correct_tracks, read_injection, write_injection

TRUE = np.column_stack([np.sin(np.arange(60) / 3), np.cos(np.arange(60) / 5)])
TRUE = TRUE - TRUE[0]


def gains(gain, std, directions=None):
    """Gains of one point in a view, as injection states them."""
    directions = np.eye(2) if directions is None else directions
    dims = ("view", "point", "direction")
    return xr.Dataset(
        {
            "injected_gain": (dims, [[gain]], {"units": "1"}),
            "injected_gain_std": (dims, [[std]], {"units": "1"}),
            "injected_noise": (dims, np.zeros((1, 1, 2)), {"units": "px"}),
            "injected_direction": ((*dims, "pixel"), [[directions]]),
        },
        coords={"view": ["left"], "point": ["p0"], "pixel": ["u", "v"]},
    )


def corrected(gain, std, directions=None):
    directions = np.eye(2) if directions is None else directions
    seen = TRUE @ directions.T * np.where(np.isfinite(gain), gain, 1.0) @ directions + [100.0, 50.0]
    tracks = {"left": stated_tracks(seen[:, None], 0.02, 30.0)}
    return tracks["left"], correct_tracks(tracks, gains(gain, std, directions))["left"]


def test_a_certain_gain_is_taken_out_of_motion_and_covariance():
    _, found = corrected([0.9, 0.8], [0.01, 0.02])
    np.testing.assert_allclose(found["position"].values[:, 0] - [100, 50], TRUE, atol=1e-12)
    np.testing.assert_allclose(found["position_covariance"].values[5, 0], np.diag([0.02 / 0.9, 0.02 / 0.8]) ** 2)
    np.testing.assert_allclose(found["gain_left_std"].values[0], [0.01 / 0.9, 0.025])


def test_an_uncertain_gain_is_stated_and_not_corrected():
    before, found = corrected([0.97, 1.0], [0.02, 0.01])
    np.testing.assert_array_equal(found["position"].values, before["position"].values)
    np.testing.assert_array_equal(found["position_covariance"].values, before["position_covariance"].values)
    np.testing.assert_allclose(found["gain_left_std"].values[0], [np.hypot(0.03, 0.02), 0.01])


def test_only_motion_across_an_edge_is_corrected():
    across = np.array([[0.6, 0.8], [-0.8, 0.6]])
    _, found = corrected([0.9, np.nan], [0.01, np.nan], across)
    np.testing.assert_allclose(found["position"].values[:, 0] - [100, 50], TRUE, atol=1e-12)
    assert np.isfinite(found["gain_left_std"].values[0]).tolist() == [True, False]


def test_without_injection_tracks_are_as_they_are():
    tracks = {"left": stated_tracks(TRUE[:, None], 0.02, 30.0)}
    assert correct_tracks(tracks, None)["left"] is tracks["left"]


def test_gains_are_read_as_they_were_written(tmp_path):
    found = gains([0.9, np.nan], [0.01, np.nan])
    write_injection(tmp_path / "injection.nc", found, {"key": "abc"})
    read, key = read_injection(tmp_path / "injection.nc")
    assert key == "abc"
    xr.testing.assert_equal(read["injected_gain"], found["injected_gain"])
