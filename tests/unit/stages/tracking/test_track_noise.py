import numpy as np
import pytest

from stated_tracks import stated_tracks
from vfm_sdm.stages.tracking.track_noise import include_static_noise, include_track_noise

RATE = 60.0
STATED = 0.003


def tracks_of(position, *, stated=STATED):
    # The reference frame is where it is.
    std = np.append(0.0, np.full(len(position) - 1, stated))
    return stated_tracks(position, std[:, None, None, None] ** 2 * np.eye(2), RATE, tracker="test")


def motion(frames, points=1):
    time = np.arange(frames) / RATE
    wave = 4 * np.sin(2 * np.pi * 2.3 * time) + 0.3 * np.sin(2 * np.pi * 6.9 * time)
    return np.repeat(np.column_stack([0.4 * wave, wave])[:, None], points, axis=1)


def stds(tracks):
    return np.sqrt(np.einsum("tpii->tpi", tracks["position_covariance"].values))


@pytest.mark.parametrize("std", [0.01, 0.04])
def test_white_noise_beyond_what_is_stated_is_found_to_ten_percent(std):
    rng = np.random.default_rng(4)
    raised = include_track_noise(tracks_of(motion(900, 4) + rng.normal(0, std, (900, 4, 2))))
    assert np.median(stds(raised)[1:]) == pytest.approx(std, rel=0.1)
    np.testing.assert_array_equal(stds(raised)[0], 0)  # the reference frame is given, not found
    assert raised["scatter"].attrs["units"] == "px"


def test_motion_of_a_structure_is_not_taken_for_noise():
    np.testing.assert_allclose(stds(include_track_noise(tracks_of(motion(600))))[1:], STATED, rtol=0.01)


def test_each_direction_is_raised_by_itself_and_correlation_is_kept():
    rng = np.random.default_rng(5)
    noise = rng.normal(0, 1, (800, 1, 2)) * [0.02, 1e-5]
    tracks = tracks_of(motion(800) + noise)
    tracks["position_covariance"].values[1:, :, 0, 1] = tracks["position_covariance"].values[1:, :, 1, 0] = (
        0.5 * STATED**2
    )
    raised = include_track_noise(tracks)
    u, v = stds(raised)[400, 0]
    assert u == pytest.approx(0.02, rel=0.3)
    assert v == pytest.approx(STATED, rel=0.01)
    assert raised["position_covariance"].values[400, 0, 0, 1] == pytest.approx(0.5 * u * v)


def test_noise_that_comes_with_the_motion_is_stated_when_it_is_there():
    rng = np.random.default_rng(6)
    noise = rng.normal(0, 0.03, (1200, 1, 2)) * (np.arange(1200) > 600)[:, None, None]
    found = stds(include_track_noise(tracks_of(noise)))
    assert found[60:360].max() == pytest.approx(STATED, rel=0.01)
    assert np.median(found[840:]) == pytest.approx(0.03, rel=0.2)


def test_gaps_split_the_series_and_short_runs_keep_what_is_stated():
    rng = np.random.default_rng(7)
    position = motion(500) + rng.normal(0, 0.02, (500, 1, 2))
    position[[60, 320], 0] = np.nan
    raised = include_track_noise(tracks_of(position))
    found = stds(raised)[:, 0, 0]
    np.testing.assert_allclose(found[1:60], STATED)
    assert np.isnan(raised["scatter"].values[:61, 0]).all()
    assert np.median(found[61:320]) == pytest.approx(0.02, rel=0.25)
    np.testing.assert_array_equal(raised["position"].values, position)


def trembling(std):
    """Two static points and one that moves, before air that bends the picture slowly."""
    rng = np.random.default_rng(8)
    kernel = np.hanning(25)
    series = [np.convolve(rng.normal(0, 1, 924), kernel, mode="valid") for _ in range(6)]
    haze = np.stack(series, axis=1).reshape(900, 3, 2)
    haze *= std / haze.std()
    moves = np.stack([0 * motion(900)[:, 0], 0 * motion(900)[:, 0], motion(900)[:, 0]], axis=1)
    return tracks_of(haze + rng.normal(0, STATED, haze.shape) + moves)


def test_what_static_points_show_of_the_air_is_noise_of_all():
    raised = include_static_noise({"left": trembling(0.3)}, ["p0", "p1"])["left"]
    assert np.median(stds(raised)[1:, 2]) == pytest.approx(0.3, rel=0.25)
    np.testing.assert_array_equal(stds(raised)[0], 0)


@pytest.mark.parametrize(("std", "static"), [(0.0, ["p0", "p1"]), (0.3, ["p0"]), (0.3, [])])
def test_calm_air_and_too_few_static_points_change_nothing(std, static):
    tracks = trembling(max(std, 1e-9))
    assert include_static_noise({"left": tracks}, static)["left"] is tracks
