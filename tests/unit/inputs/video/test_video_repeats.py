"""Frames that are stored twice, told by their noise; none of films whose encoders pass still blocks on."""

import numpy as np
import pytest

from compressed import film, pictures
from vfm_sdm.inputs.video import open_video
from vfm_sdm.inputs.video.repeats import find_alike

FRAMES, REPEATED = 40, (9, 23, 31)


def stored(path, luma, repeats=(), **options):
    """Numbers of the frames that a pass finds alike, of the frames in a file, some of them there twice."""
    shown = np.arange(len(luma))
    for k in repeats:
        shown[k] = shown[k - 1]
    film(path, luma[shown], np.zeros((len(luma), 2)), **options)
    video = open_video(path)
    assert sum(1 for _ in video.frames()) == len(luma)
    return video.report.alike


@pytest.mark.parametrize(("codec", "crf"), [("libx264", 12), ("libx264", 16), ("libx265", 14)])
@pytest.mark.parametrize("amplitude_px", [0.0, 0.8])
def test_repeats_in_noise_are_found_after_compression(tmp_path, codec, crf, amplitude_px):
    luma, _ = pictures(FRAMES, 40.0, (amplitude_px, amplitude_px), noise=4.0)
    assert stored(tmp_path / "film.mp4", luma, REPEATED, codec=codec, crf=crf) == REPEATED
    assert stored(tmp_path / "sound.mp4", luma, codec=codec, crf=crf) == ()


@pytest.mark.parametrize(("codec", "crf"), [("libx264", 18), ("libx264", 28), ("libx264", 40), ("libx265", 23)])
@pytest.mark.parametrize("noise", [0.0, 1.5, 4.0])
@pytest.mark.parametrize("amplitude_px", [0.0, 0.8])
def test_scenes_still_or_not_of_any_bit_rate_repeat_nothing(tmp_path, codec, crf, noise, amplitude_px):
    luma, _ = pictures(FRAMES, 40.0, (amplitude_px, amplitude_px), noise=noise)
    assert stored(tmp_path / "film.mp4", luma, codec=codec, crf=crf) == ()


def test_most_frames_of_a_converted_rate_may_be_repeats(tmp_path):
    luma, _ = pictures(24, 40.0, (0.8, 0.8), noise=4.0)
    shown = np.arange(60) * 24 // 60
    repeats = tuple(np.flatnonzero(np.diff(shown) == 0) + 1)
    assert stored(tmp_path / "film.mp4", luma[shown], crf=20) == repeats


def test_less_noise_for_a_while_is_no_repeat():
    rms, changed = np.full(80, 4.0), np.full(80, 0.9)
    rms[30:34] = 2.0  # the quantiser of a scene with less to say
    rms[60], changed[60] = 0.8, 0.8
    assert find_alike(rms, changed).size == 0


def test_too_few_frames_tell_nothing():
    assert find_alike(np.array([3.0, 0.1, 3.0]), np.array([0.9, 0.0, 0.9])).size == 0
