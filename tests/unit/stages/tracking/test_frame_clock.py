"""What the motion of all points says of a view's frames: repeats, missing frames and stamps that jitter."""

import numpy as np
import pytest

from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.stages.tracking.frame_clock import check_frames

NOISE_PX = 0.02


def tracks_of(shown_s, time_s, *, seed=0, noise_px=NOISE_PX, same_noise=True, points=4):
    """Tracks of points at true times, under the stamps that the file states; a repeated frame repeats its noise."""
    rng = np.random.default_rng(seed)
    shown = np.asarray(shown_s)
    shape = np.linspace(0.5, 1, points)[:, None] * [0.6, 1.0]
    motion = np.sin(2 * np.pi * 2.2 * shown) + 0.15 * np.sin(2 * np.pi * 6.1 * shown + 1)
    position = 3.0 * motion[:, None, None] * shape + rng.normal(0, noise_px, (len(shown), points, 2))
    if same_noise:
        for k in np.flatnonzero(np.diff(shown) == 0) + 1:
            position[k] = position[k - 1] + rng.normal(0, noise_px / 10, (points, 2))
    covariance = np.tile(noise_px**2 * np.eye(2), (len(shown), points, 1, 1))
    names = [f"p{n}" for n in range(points)]
    return make_tracks(time_s, names, position, covariance, np.zeros((len(shown), points)), attrs={})


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("noise_px", [0.005, 0.02, 0.08])
def test_sound_recordings_stay_as_they_are(seed, noise_px):
    time_s = np.arange(300) / 30
    tracks = tracks_of(time_s, time_s, seed=seed, noise_px=noise_px)
    found = check_frames(tracks)
    assert found.facts == {"repeated": 0, "skipped": 0, "remarks": [], "doubts": []}
    assert found.tracks.identical(tracks)


@pytest.mark.parametrize(("source", "stored"), [(25, 30), (24, 30), (50, 60)])
@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_converted_rate_gets_its_own_clock(source, stored, phase):
    shown = np.floor(np.arange(180) * source / stored + phase) / source
    found = check_frames(tracks_of(shown, np.arange(180) / stored))
    assert "converted from" in found.facts["remarks"][0]
    assert not found.facts["doubts"]
    # Frames of the source, from its first one on.
    true = np.unique(shown)
    assert found.tracks.sizes["time"] == pytest.approx(len(true), abs=1)
    np.testing.assert_allclose(found.tracks["time"], true[: found.tracks.sizes["time"]], atol=2e-3)


def test_frames_in_place_of_lost_ones_are_marked():
    time_s = np.arange(240) / 30
    shown, lost = time_s.copy(), [34, 75, 150, 205]
    for k in lost:
        shown[k] = shown[k - 1]
    found = check_frames(tracks_of(shown, time_s))
    assert "repeat the one before" in found.facts["doubts"][0]
    marked = np.flatnonzero((found.tracks["status"] == Status.UNRELIABLE).all("point"))
    assert set(marked) <= set(lost)
    assert len(marked) >= 3
    np.testing.assert_array_equal(found.tracks["time"], time_s)


def test_frames_that_hold_the_noise_of_those_before_are_marked_whatever_the_motion():
    time_s = np.arange(240) / 30
    still = tracks_of(np.zeros(240), time_s, same_noise=False)
    found = check_frames(still, alike=(34, 150))
    assert found.facts["repeated"] == 2
    assert "2 frames repeat the one before" in found.facts["doubts"][0]
    marked = np.flatnonzero((found.tracks["status"] == Status.UNRELIABLE).all("point"))
    assert marked.tolist() == [34, 150]
    assert check_frames(still.isel(time=slice(8)), alike=(3,)).facts["repeated"] == 1


@pytest.mark.parametrize("missing", [2, 3, 5])
def test_frames_lost_behind_even_stamps_are_named(missing):
    true_s = np.arange(240) / 30
    shown = np.delete(true_s, np.arange(100, 100 + missing))
    found = check_frames(tracks_of(shown, true_s[: len(shown)]))
    assert found.facts["skipped"] >= 1
    assert "all points jump at once at 3.33 s" in found.facts["doubts"][0]


@pytest.mark.parametrize("missing", [2, 3, 5])
@pytest.mark.parametrize("hertz", [(1.5, 3.3), (3.7, 5.9)])
def test_frames_lost_where_the_step_is_no_larger_than_others_are_named(missing, hertz):
    true_s = np.arange(240) / 30
    shown = np.delete(true_s, np.arange(104, 104 + missing))
    rng = np.random.default_rng(4)
    position = 2.0 * np.sin(2 * np.pi * np.outer(shown, hertz)) @ rng.uniform(0.5, 1, (2, 6))
    tracks = tracks_of(shown, true_s[: len(shown)], points=3)
    tracks["position"][:] = (position + rng.normal(0, NOISE_PX, position.shape)).reshape(-1, 3, 2)
    found = check_frames(tracks)
    assert found.facts["skipped"] == 1
    assert "at 3.47 s" in found.facts["doubts"][0]


@pytest.mark.parametrize("seed", range(20))
def test_impacts_on_what_vibrates_are_no_missing_frames(seed):
    time_s = np.arange(240) / 30
    rng = np.random.default_rng(seed)
    hertz, shapes = rng.uniform(1.2, 6, 2), rng.uniform(-1, 1, (2, 6))
    position = np.sin(2 * np.pi * np.outer(time_s, hertz)) @ shapes
    for at in rng.uniform(2, 7, 3):
        since = np.maximum(time_s - at, 0)
        position += np.sin(2 * np.pi * np.outer(since, hertz)) * rng.uniform(-2, 2, 2) @ shapes
    tracks = tracks_of(time_s, time_s, points=3)
    tracks["position"][:] = (position + rng.normal(0, NOISE_PX, position.shape)).reshape(-1, 3, 2)
    assert check_frames(tracks).facts["skipped"] == 0


def test_one_slipping_point_is_no_missing_frame():
    time_s = np.arange(240) / 30
    tracks = tracks_of(time_s, time_s)
    tracks["position"][100:, 1, 1] += 4.0
    assert check_frames(tracks).facts["skipped"] == 0


def test_an_impact_is_no_missing_frame():
    time_s = np.arange(240) / 30
    tracks = tracks_of(np.zeros(240), time_s, same_noise=False)
    ring = np.where(time_s > 4, np.exp(-(time_s - 4)) * np.sin(2 * np.pi * 3 * (time_s - 4)), 0.0)
    tracks["position"][:] += 2.0 * ring[:, None, None]
    assert check_frames(tracks).facts["skipped"] == 0


def test_stamps_that_jitter_give_way_to_an_even_clock():
    time_s = np.arange(240) / 30
    jitter = np.random.default_rng(3).uniform(-0.01, 0.01, 240)
    found = check_frames(tracks_of(time_s, time_s + jitter))
    assert "time stamps jitter by 5.4 ms" in found.facts["remarks"][0]
    np.testing.assert_allclose(np.diff(found.tracks["time"]), 1 / 30, rtol=2e-3)


def test_frames_that_really_come_unevenly_keep_their_stamps():
    uneven = np.arange(240) / 30 + np.random.default_rng(3).uniform(-0.01, 0.01, 240)
    tracks = tracks_of(uneven, uneven)
    found = check_frames(tracks)
    assert not found.facts["remarks"]
    np.testing.assert_array_equal(found.tracks["time"], uneven)
