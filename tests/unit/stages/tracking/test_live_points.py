"""Points followed picture by picture, and the last minute of them."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from moving_frames import NaturalTexture
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.inputs.video import VideoInfo
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.live import LivePoints, summarize_motion

INFO = VideoInfo("live", 256, 256, np.nan, None, None, "live", "", 8, 0)
POINTS = np.array([[100.0, 120.0], [60.0, 60.0]])


def test_motion_is_that_of_the_pictures_and_the_past_is_forgotten():
    rng, texture = np.random.default_rng(0), NaturalTexture(1)
    time_s = np.arange(120) / 30
    truth = np.stack([0.3 * np.cos(9 * time_s), 1.2 * np.sin(6 * time_s)], axis=1)
    truth -= truth[0]
    pictures = [
        np.clip(texture.image(moved) + rng.normal(0, 2, (256, 256)), 0, 255).round().astype(np.uint8) for moved in truth
    ]
    with ThreadPoolExecutor(2) as executor:
        live = LivePoints(
            pictures[0], POINTS, ["mid", "refused"], designs=[SubsetDesign(41), None], executor=executor, kept_s=3.0
        )
        for at, picture in zip(time_s, pictures, strict=True):
            live.advance(float(at), picture)
    tracks = live.tracks(INFO)
    kept = time_s >= time_s[-1] - 3.0
    np.testing.assert_allclose(tracks["time"], time_s[kept])
    mid, refused = summarize_motion(tracks, POINTS)
    np.testing.assert_allclose(mid.now_px, truth[-1], atol=0.05)
    assert mid.lost == mid.unreliable == 0.0
    assert abs(mid.along[1]) > 0.95
    along = truth[kept] @ mid.along
    np.testing.assert_allclose(mid.trace_px, along - along.mean(), atol=0.05)
    np.testing.assert_allclose([mid.peak_px, mid.rms_px], [np.ptp(along), np.std(along)], atol=0.05)
    # What is stated is the error: within a factor of two of its standard deviation.
    error = np.std(mid.trace_px - along)
    assert error / 2 < mid.noise_px < 2 * error
    assert mid.signal_to_noise == mid.rms_px / mid.noise_px > 30
    assert refused.lost == 1.0
    assert np.isnan([refused.peak_px, refused.signal_to_noise, *refused.now_px]).all()


def still(covariance_px2, across, noise_px=0.02):
    rng = np.random.default_rng(2)
    position = 50 + rng.normal(0, noise_px, (400, 1, 2))
    covariance = np.tile(covariance_px2 * np.eye(2), (400, 1, 1, 1))
    tracks = make_tracks(np.arange(400) / 30, ["a"], position, covariance, np.zeros((400, 1)), attrs={})
    return tracks.assign(edge_across=(("point", "pixel"), np.array([across])))


def test_noise_alone_has_a_signal_of_one():
    motion = summarize_motion(still(0.02**2, [np.nan, np.nan]), np.full((1, 2), 50.0))[0]
    np.testing.assert_allclose(motion.signal_to_noise, 1.0, atol=0.15)


def test_an_edge_is_shown_across():
    tracks = still(0.02**2, [0.6, 0.8])
    motion = summarize_motion(tracks, np.full((1, 2), 50.0))[0]
    assert motion.along.tolist() == [0.6, 0.8]
    across = (tracks["position"].values[:, 0] - 50) @ [0.6, 0.8]
    np.testing.assert_allclose(motion.trace_px, across - across.mean())
