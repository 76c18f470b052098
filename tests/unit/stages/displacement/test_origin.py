"""Error of the origin against noise whose mean over the still interval is known."""

import numpy as np
import pytest
import xarray as xr
from test_uncertainty import CLOCK, FPS, STILL_S, VIEWS, measured, part, pixels, white

from stated_tracks import stated_tracks
from vfm_sdm.core.covariances import edges_across
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.stages.displacement.origin import include_origin
from vfm_sdm.stages.displacement.uncertainty import BudgetInputs, add_uncertainty

FRAMES, AIR_PX, NOISE_PX, KEPT = 600, 0.3, 0.02, 0.8
NAMES = ("mid", "wall", "pier", "abutment")
STATIC = NAMES[1:]


def air(rng, shape, *, std_px=AIR_PX):
    """Noise that keeps 0.8 of itself from frame to frame, shape (T, ...)."""
    steps = rng.normal(0, std_px * np.sqrt(1 - KEPT**2), shape)
    steps[0] = rng.normal(0, std_px, shape[1:])
    for frame in range(1, shape[0]):
        steps[frame] += KEPT * steps[frame - 1]
    return steps


def tracks_in_air(rng, *, std_px=AIR_PX):
    """One view of four points in trembling air, of which the first moves; covariances state white noise alone."""
    position = air(rng, (FRAMES, 4, 2), std_px=std_px) + rng.normal(0, NOISE_PX, (FRAMES, 4, 2))
    position[:, 0, 1] += np.sin(np.arange(FRAMES) / 3)
    covariance = np.tile(NOISE_PX**2 * np.eye(2), (FRAMES, 4, 1, 1))
    one = make_tracks(np.arange(FRAMES) / 30, NAMES, position, covariance, np.zeros((FRAMES, 4)), attrs={})
    return xr.concat([one], "view").assign_coords(view=["left"])


def std_of_mean(frames):
    """Standard deviation of the mean of so many frames of the air [px]."""
    apart = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    return AIR_PX * np.sqrt(np.mean(KEPT**apart))


def stated(tracks, point, axis="u"):
    return float(tracks["origin_covariance"].sel(view="left", point=point, pixel_a=axis, pixel_b=axis)) ** 0.5


def test_static_points_tell_how_well_the_mean_in_trembling_air_is_known():
    found = [include_origin(tracks_in_air(np.random.default_rng(seed)), STATIC, (0.0, 0.6)) for seed in range(8)]
    expected = std_of_mean(19)
    assert expected > 0.15 > 4 * AIR_PX / np.sqrt(FRAMES)
    for point in NAMES:
        got = np.sqrt(np.mean([[stated(one, point, axis) ** 2 for axis in "uv"] for one in found]))
        assert got == pytest.approx(expected, rel=0.15)


def test_without_air_the_mean_is_known_by_the_root_of_the_frames():
    found = include_origin(tracks_in_air(np.random.default_rng(0), std_px=0.0), STATIC, (0.0, 0.6))
    assert stated(found, "mid") == pytest.approx(NOISE_PX / np.sqrt(19), rel=0.2)


def test_a_single_frame_as_the_origin_has_the_whole_error_of_the_air():
    found = include_origin(tracks_in_air(np.random.default_rng(0)), STATIC)
    assert stated(found, "mid") == pytest.approx(AIR_PX, rel=0.25)


def test_one_static_point_says_nothing_of_others():
    found = include_origin(tracks_in_air(np.random.default_rng(0)), ["wall"], (0.0, 0.6))
    assert stated(found, "mid") == pytest.approx(NOISE_PX / np.sqrt(19), rel=1e-6)
    assert stated(found, "wall") > 0.1


def test_an_edge_has_an_origin_across_itself_alone():
    tracks = tracks_in_air(np.random.default_rng(0))
    across = np.full((1, 4, 2), np.nan)
    across[0, 0] = 0.6, 0.8
    tracks["edge_across"] = (("view", "point", "pixel"), across)
    assert np.isfinite(edges_across(tracks)[0, 0]).all()
    covariance = include_origin(tracks, STATIC, (0.0, 0.6))["origin_covariance"].sel(point="mid").values[0]
    assert np.array([-0.8, 0.6]) @ covariance @ [-0.8, 0.6] == pytest.approx(0.0, abs=1e-12)
    assert np.array([0.6, 0.8]) @ covariance @ [0.6, 0.8] > 0.1**2


def test_all_samples_share_the_error_of_the_origin():
    errors, stds = [], []
    still = pixels(amplitude_mm=(0.0, 0.0, 0.0))
    for seed in range(40):
        noise = air(np.random.default_rng(seed), (len(CLOCK), 2, 3, 2), std_px=0.1).swapaxes(0, 1)
        views = [stated_tracks(moved, white(0.1, 0.1)[k], CLOCK) for k, moved in enumerate(still + noise)]
        tracks = xr.concat(views, dim="view").assign_coords(view=list(VIEWS)).transpose("view", ...)
        tracks = include_origin(tracks, [str(name) for name in tracks["point"].values], STILL_S)
        budget = add_uncertainty(measured(tracks), BudgetInputs(tracks))
        origin = part(budget, "origin")
        assert np.ptp(origin, axis=0).max() == 0.0
        after = STILL_S[1] + 20 / FPS < CLOCK
        errors.append(budget["displacement"].values[after].mean(axis=0))
        stds.append(origin[0])
    ratio = np.sqrt(np.mean(np.square(errors))) / np.sqrt(np.mean(np.square(stds)))
    assert 0.8 < ratio < 1.35
