"""Injected gain and noise against those of the recording, whose motion is known."""

import numpy as np
import pytest

from compressed import POINT, film, pictures
from vfm_sdm.core.statuses import InjectionStatus
from vfm_sdm.inputs.video import Region, open_video
from vfm_sdm.inputs.video.coding import read_coded_clip
from vfm_sdm.inputs.video.memory import video_in_memory
from vfm_sdm.stages.registration.designs import SubsetDesign, Warp
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.injection.encoder import ClipEncoder
from vfm_sdm.stages.tracking.injection.gains import compute_gain
from vfm_sdm.stages.tracking.injection.inject import inject
from vfm_sdm.stages.tracking.track_noise import include_track_noise

FRAMES = 150
TRACKER = IcgnTracker(subset_px=61)


def injected(video, tracker=TRACKER, **options):
    """Tracks of the plate, and what injection finds."""
    tracks = include_track_noise(tracker.track(video, POINT[None], names=["plate"], **options))
    designs = {"plate": options["designs"][0]} if options else None
    return tracks["position"].values[:, 0], inject(video, tracks, tracker, designs=designs).sel(point="plate")


@pytest.fixture(scope="module")
def weak():
    """Frames of a texture of 6 grey levels, and their motion."""
    return pictures(FRAMES, 6.0, (0.7, 1.2))


@pytest.mark.parametrize(
    ("codec", "crf", "preset", "least"),
    [("libx264", 28, "medium", 0.005), ("libx265", 26, "veryfast", 0.02)],
)
def test_the_gain_of_a_weak_texture_is_found_without_truth(weak, tmp_path, codec, crf, preset, least):
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    made = film(tmp_path / "a.mp4", *weak, codec=codec, crf=crf, preset=preset, **options)
    position, found = injected(open_video(made.path))
    assert found["injection_status"] == InjectionStatus.OK
    for axis in (0, 1):
        true = compute_gain(position[:, axis], made.motion[:, axis])
        gain, std, noise = (
            float(found[name][axis]) for name in ("injected_gain", "injected_gain_std", "injected_noise")
        )
        assert 1 - true.gain > least, "the recording loses something"
        assert abs(gain - true.gain) < 2.5 * np.hypot(std, true.std)
        # The truth is known to its scatter only, which is as large as a small loss; encoders differ by their threads.
        assert abs(gain - true.gain) < 0.7 * (1 - true.gain) + 2 * true.std
        assert std < 0.06
        assert 1 / 1.6 < noise / true.noise < 1.6


def test_the_same_pictures_give_the_same_bytes_whatever_lies_in_memory(weak, tmp_path):
    made = film(tmp_path / "a.mp4", *weak, codec="libx264", crf=18, preset="medium")
    clip = read_coded_clip(open_video(made.path), [Region(88, 56, 80, 80)], frames=FRAMES)
    encoder = ClipEncoder(clip, clip.quantisers.mean(axis=(1, 2)), 0.0)
    rng, found, memory = np.random.default_rng(0), set(), []
    for _ in range(14):
        memory = [*memory[-2:], rng.integers(0, 255, rng.integers(1_000, 900_000), np.uint8)]
        found.add(encoder.run(clip.crops[0]).tobytes())
    assert len(found) == 1


def test_a_strong_texture_at_a_good_quality_loses_nothing(tmp_path):
    made = film(tmp_path / "a.mp4", *pictures(90, 35.0, (0.7, 1.2)), crf=16, preset="fast")
    position, found = injected(open_video(made.path))
    for axis in (0, 1):
        true = compute_gain(position[:, axis], made.motion[:, axis])
        gain = float(found["injected_gain"][axis])
        assert abs(gain - true.gain) < 3 * np.hypot(float(found["injected_gain_std"][axis]), true.std)
        assert abs(gain - true.gain) < 0.01
    assert (found["injected_gain_std"] < 0.006).all()


def test_the_gain_of_an_edge_is_stated_across_it(tmp_path, weak):
    across = np.array([0.6, 0.8])
    made = film(tmp_path / "a.mp4", *weak, crf=24, preset="veryfast")
    _, found = injected(open_video(made.path), designs=[SubsetDesign(61, Warp.EDGE, across=across)])
    np.testing.assert_allclose(found["injected_direction"][0], across)
    assert np.isfinite(found["injected_gain"]).values.tolist() == [True, False]


def test_an_unknown_encoder_makes_the_loss_less_sure(weak, tmp_path):
    known = film(tmp_path / "a.mp4", *weak, crf=28, preset="veryfast")
    _, found = injected(open_video(known.path))
    # The words of the encoder, overwritten; the quantisers stay.
    content = known.path.read_bytes()
    silent = tmp_path / "b.mp4"
    silent.write_bytes(content.replace(b"x264 - core", b"hidden name"))
    _, guessed = injected(open_video(silent))
    gain, std = guessed["injected_gain"].values, guessed["injected_gain_std"].values
    assert (std > 0.5 * np.abs(1 - gain)).all()
    assert (np.abs(gain - found["injected_gain"].values) < 3 * np.hypot(std, found["injected_gain_std"].values)).all()


def test_what_cannot_be_injected_says_why(tmp_path):
    luma, moved = pictures(70, 20.0, (0.0, 0.0))
    luma_moving, moving = pictures(40, 20.0, (0.5, 0.5))
    still = open_video(film(tmp_path / "still.mp4", luma, moved, crf=20, preset="ultrafast").path)
    short = open_video(film(tmp_path / "short.mp4", luma_moving, moving, crf=20, preset="ultrafast").path)
    for video, status in (
        (still, InjectionStatus.STILL),
        (short, InjectionStatus.TOO_SHORT),
        (video_in_memory(luma, fps=30), InjectionStatus.NOT_COMPRESSED),
    ):
        _, found = injected(video)
        assert found["injection_status"] == status
        assert np.isnan(found["injected_gain"]).all()
