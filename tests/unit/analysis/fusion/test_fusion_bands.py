"""A sensor that sees modes in other sizes than the video does, as one elsewhere on the structure."""

import numpy as np
import pytest

from vfm_sdm.analysis.fusion.along import Alignment, Fused, Record, Video
from vfm_sdm.analysis.fusion.bands import compare_bands, find_contradicting
from vfm_sdm.analysis.fusion.levels import Levels

MODES = ((1.7, 0.6), (4.3, 0.25), (9.0, 0.08))
"""Frequencies [Hz] and amplitudes [mm]."""
GAIN, LAG_S, EXPOSURE_S, NOISE = 0.8, 0.3, 1 / 60, 0.3


def records(sizes=(1.0, 1.0, 1.0), noise=NOISE, seconds=20.0):
    """A sensor [mm/s2] that sees the modes so many times as large as the video does, and what is known of both."""
    rng = np.random.default_rng(0)
    stamps, frames = np.arange(0, seconds + 2, 1 / 200), np.arange(0.5, seconds, 1 / 30)
    acceleration, seen = noise * rng.normal(size=len(stamps)), 0.02 * rng.normal(size=len(frames))
    for number, ((hertz, mm), size) in enumerate(zip(MODES, sizes, strict=True)):
        omega = 2 * np.pi * hertz
        acceleration -= size / GAIN * mm * omega**2 * np.sin(omega * (stamps - LAG_S) + number)
        seen += mm * np.sinc(hertz * EXPOSURE_S) * np.sin(omega * frames + number)
    record = Record(stamps, acceleration[:, None], np.ones(len(stamps), np.bool_), ("vertical",))
    alignment = Alignment(1.0, -LAG_S, 1e-4, 1e-6, 10.0, 0.1, 0.05)
    levels = Levels(noise / np.sqrt(200), 0.0, 1.0, 0.3, 2.0, 0.5)
    nothing = np.zeros(0)
    fused = Fused(
        nothing, nothing, nothing, nothing, nothing, alignment, np.array([GAIN]), np.array([0.01]), 0.0, levels,
        *(0.0,) * 6, EXPOSURE_S, 0, GAIN, 0.01,
    )  # fmt: skip
    return record, Video(frames, seen, np.full(len(frames), 0.02)), fused


def test_one_motion_has_one_size_at_all_frequencies():
    bands = compare_bands(*records())
    assert len(bands) >= 3
    for one in bands:
        assert one.size == pytest.approx(1.0, abs=4 * one.std + 0.005)
    assert find_contradicting(bands) is None


def test_modes_of_another_place_contradict_each_other():
    first, second = find_contradicting(compare_bands(*records((1.0, 1.3, 1.3))))
    assert first.high_hz < 3 < second.low_hz
    assert first.size / second.size == pytest.approx(1.3, rel=0.02)


def test_frames_without_a_value_count_in_neither():
    record, video, fused = records()
    video.values_mm[200:260] = np.nan
    assert find_contradicting(compare_bands(record, video, fused)) is None


def test_what_the_sensor_hardly_sees_is_no_contradiction():
    bands = compare_bands(*records((1.0, 1.0, 0.0)))
    assert find_contradicting(bands) is None
    assert compare_bands(*records((0.0, 0.0, 0.0))) == []
