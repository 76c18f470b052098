"""Single samples that leave their path are stated as such; motion, impacts and jolts of the camera are not."""

import numpy as np
import pytest

from stated_tracks import stated_tracks
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.tracking.lone_errors import find_lone_errors, include_lone_errors

RATE, FRAMES, NOISE_PX = 30.0, 300, 0.02


def positions(points=3, *, seed=0, noise_px=NOISE_PX, frames=FRAMES, rate=RATE):
    """Two modes of several pixels and noise, shape (T, P, 2) [px]."""
    time_s = np.arange(frames) / rate
    wave = 3 * np.sin(2 * np.pi * 1.4 * time_s) + 0.3 * np.sin(2 * np.pi * 2.3 * time_s + 1)
    motion = wave[:, None, None] * np.linspace(0.5, 1.0, points)[:, None] * [0.2, 1.0]
    return motion + np.random.default_rng(seed).normal(0, noise_px, motion.shape)


def stds(tracks):
    return np.sqrt(np.einsum("tpii->tpi", tracks["position_covariance"].values))


def ringing(frequency_hz, damping, *, seed, rate=RATE, frames=900):
    """A structure that is hit eight times: its speed changes at once."""
    rng, time_s = np.random.default_rng(seed), np.arange(frames) / rate
    found = np.zeros(frames)
    for start in rng.uniform(1, frames / rate - 1, 8):
        after = np.maximum(time_s - start, 0)
        decay = np.exp(-damping * 2 * np.pi * frequency_hz * after)
        found += rng.uniform(0.3, 1) * decay * np.sin(2 * np.pi * frequency_hz * after)
    return found


@pytest.mark.parametrize("seed", range(8))
def test_what_leaves_the_path_for_one_frame_is_stated_and_stays(seed):
    truth = positions(seed=seed)
    place = truth.copy()
    place[100, 1, 0] += 0.5  # a rain streak along an edge
    place[200, 2, 1] -= 0.4
    raised = include_lone_errors(stated_tracks(place, NOISE_PX, RATE))
    found = stds(raised)
    assert found[100, 1] == pytest.approx([0.5, NOISE_PX], rel=0.25)
    assert found[200, 2] == pytest.approx([NOISE_PX, 0.4], rel=0.25)
    np.testing.assert_array_equal(raised["position"].values, place)
    found[100, 1, 0] = found[200, 2, 1] = NOISE_PX
    assert (found > 1.01 * NOISE_PX).sum() <= 1
    error = np.abs(place - truth)
    assert (error / stds(raised)).max() < 2


def test_across_an_edge_the_error_is_stated_across_it():
    place = positions()
    across = np.array([0.6, 0.8])
    place[100, 0] += 0.5 * across
    tracks = stated_tracks(place, NOISE_PX, RATE)
    tracks["edge_across"] = (("point", "pixel"), [across, [np.nan] * 2, [np.nan] * 2])
    covariance = include_lone_errors(tracks)["position_covariance"].values[100, 0]
    along = np.array([-0.8, 0.6])
    assert np.sqrt(across @ covariance @ across) == pytest.approx(0.5, rel=0.25)
    assert np.sqrt(along @ covariance @ along) == pytest.approx(NOISE_PX)


def test_sound_tracks_stay_as_they_are():
    alarms = [
        np.isfinite(find_lone_errors(positions(seed=seed), np.arange(FRAMES) / RATE)).mean() for seed in range(20)
    ]
    assert np.mean(alarms) < 2.5e-4  # of noise beyond four standard deviations, these known to a tenth


@pytest.mark.parametrize("frequency_hz", [1.0, 2.0, 4.0, 6.0])
@pytest.mark.parametrize("rate", [30.0, 60.0])
@pytest.mark.parametrize("noise_px", [0.002, 0.02])
def test_impacts_at_one_point_alone_are_motion(frequency_hz, rate, noise_px):
    alarms = []
    for seed in range(8):
        hit = ringing(frequency_hz, 0.02, seed=seed, rate=rate)
        place = hit[:, None, None] * [0.3, 1.0] + np.random.default_rng(seed).normal(0, noise_px, (900, 1, 2))
        alarms.append(np.isfinite(find_lone_errors(place, np.arange(900) / rate)).mean())
    assert np.mean(alarms) < 1e-3  # of eight impacts in 900 frames, one in ten


@pytest.mark.parametrize("frequency_hz", [2.0, 6.0, 12.0, 14.5])
def test_what_all_points_do_is_motion_however_fast(frequency_hz):
    hit = ringing(frequency_hz, 0.05, seed=1)
    noise = np.random.default_rng(2).normal(0, 0.002, (900, 4, 2))
    place = hit[:, None, None] * np.array([[0.3], [0.6], [0.8], [1.0]]) * [0.3, 1.0] + noise
    assert np.isfinite(find_lone_errors(place, np.arange(900) / RATE)).mean() < 5e-4


def test_a_jolt_of_the_camera_is_no_error_of_its_points():
    place = positions(5)
    place[100] += [0.8, -0.5]
    assert not np.isfinite(find_lone_errors(place, np.arange(FRAMES) / RATE)[100]).any()


def test_beside_missing_samples_and_uneven_stamps_nothing_is_told():
    place, time_s = positions(), np.arange(FRAMES) / RATE
    place[[99, 102], 1] = np.nan
    place[100, 1, 0] += 0.5
    assert not np.isfinite(find_lone_errors(place, time_s)[100, 1]).any()
    late = positions()
    late[150:] = positions(frames=FRAMES + 1)[151:]  # a frame is missing, as its stamps say
    dropped = np.append(time_s[:150], time_s[150:] + 1 / RATE)
    assert not np.isfinite(find_lone_errors(late, dropped)[147:154]).any()


@pytest.mark.parametrize("frames", [1, 2, 8, 29])
def test_short_tracks_stay_as_they_are(frames):
    tracks = stated_tracks(positions(frames=frames), NOISE_PX, RATE)
    assert include_lone_errors(tracks).identical(tracks)


def test_untrusted_samples_are_no_neighbours():
    place = positions()
    place[101, 1, 0] += 40.0
    tracks = stated_tracks(place, NOISE_PX, RATE)
    tracks["status"].values[101, 1] = Status.UNRELIABLE
    assert stds(include_lone_errors(tracks)).max() < 4 * NOISE_PX
