"""Whether video and sensor agree at all frequencies: a sensor elsewhere sees modes in other sizes."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import CubicSpline

from vfm_sdm.analysis.fusion.along import Fused, Record, Video
from vfm_sdm.core.arrays import BoolArray, ComplexArray, FloatArray

__all__ = ["BandSize", "compare_bands", "find_contradicting"]

_LOWEST_HZ, _HIGHEST_SHARE, _STEP = 1.0, 0.4, np.sqrt(2)
"""Lowest edge of the bands [Hz], highest one over the frame rate [1], and from edge to edge: half an octave."""
_LEAST_BINS = 4
_NOISE_SHARE = 0.01
"""Of the sensor's motion in a band that may be its noise, which makes the video look too small [1]."""
_LEAST_OFF, _CONTRADICTS = 0.08, 6.0
"""Difference from the others at which a band contradicts them: relative [1], and in standard deviations."""
_WORST_STD = 0.1
"""Standard deviation of a size above which it says nothing [1]."""


@dataclass(frozen=True)
class BandSize:
    """How large the video sees the motion in a band over what the sensor says with the gain of all bands.

    Parameters
    ----------
    low_hz, high_hz
        Edges of the band [Hz].
    size, std
        Video over sensor, and its standard deviation [1].
    """

    low_hz: float
    high_hz: float
    size: float
    std: float


def compare_bands(record: Record, video: Video, fused: Fused) -> list[BandSize]:
    """Video over sensor by bands of half an octave, of those in which both see motion.

    Parameters
    ----------
    record
        The sensor's record.
    video
        The series of the video.
    fused
        What was found of both along that axis.

    Notes
    -----
    Acceleration is integrated twice in the frequency domain, with the exposure's mean, and sampled where the frames
    are; both series are then compared line by line of their spectra. Frames without a value count as lost in both.
    """
    clock = fused.alignment.on_video(record.time_s)
    has = np.isfinite(video.values_mm) & (video.time_s > clock[0]) & (video.time_s < clock[-1])
    if not has.any():
        return []
    frames = slice(int(np.flatnonzero(has)[0]), int(np.flatnonzero(has)[-1]) + 1)
    time_s, here = video.time_s[frames], has[frames]
    moved = CubicSpline(clock, _integrate(record, clock, fused))(time_s)
    taper = np.hanning(len(time_s)) * here
    seen, said = (
        np.fft.rfft(taper * (one - np.average(one[here]))) for one in (np.nan_to_num(video.values_mm[frames]), moved)
    )
    hertz = np.fft.rfftfreq(len(time_s), video.interval_s)
    density = fused.levels.sensor_density * abs(float(fused.gains[fused.own]))
    found = []
    low = _LOWEST_HZ
    while low * _STEP <= _HIGHEST_SHARE / video.interval_s:
        inside = np.asarray((hertz >= low) & (hertz < low * _STEP))
        # Lines of noise of this density, in the tapered series of frames.
        noise = density**2 / video.interval_s * float(np.sum(taper**2)) / (2 * np.pi * np.maximum(hertz, 1e-9)) ** 4
        one = _compare(seen, said, inside, noise)
        if one is not None:
            found.append(BandSize(float(low), float(low * _STEP), *one))
        low *= _STEP
    return found


def _integrate(record: Record, clock: FloatArray, fused: Fused) -> FloatArray:
    """Displacement of the sensor along the axis of the video, above half the lowest band, shape (T,) [mm]."""
    acceleration = (record.acceleration - record.acceleration.mean(axis=0)) @ fused.gains
    acceleration = np.where(record.known, acceleration, 0.0)
    hertz = np.fft.rfftfreq(len(clock), float(clock[-1] - clock[0]) / (len(clock) - 1))
    kept = hertz >= _LOWEST_HZ / 2
    response = np.zeros(len(hertz))
    response[kept] = -np.sinc(hertz[kept] * fused.exposure_s) / (2 * np.pi * hertz[kept]) ** 2
    return np.asarray(np.fft.irfft(response * np.fft.rfft(acceleration), len(clock)))


def _compare(
    seen: ComplexArray, said: ComplexArray, inside: BoolArray, noise: FloatArray
) -> tuple[float, float] | None:
    """Size and standard deviation in a band; nothing where the sensor sees little but its noise."""
    count, power = int(inside.sum()), float(np.sum(np.abs(said[inside]) ** 2))
    if count < _LEAST_BINS or not power > float(np.sum(noise[inside])) / _NOISE_SHARE:
        return None
    size = float(np.sum((np.conj(said) * seen)[inside]).real) / power
    left = float(np.sum(np.abs(seen - size * said)[inside] ** 2)) / (2 * count - 1)
    std = float(np.sqrt(left / power))
    return (size, std) if std < _WORST_STD else None


def find_contradicting(bands: list[BandSize]) -> tuple[BandSize, BandSize] | None:
    """The two bands that contradict each other most; none where all agree.

    Parameters
    ----------
    bands
        As `compare_bands` finds them.

    Examples
    --------
    >>> low, high = find_contradicting([BandSize(1, 1.4, 0.8, 0.01), BandSize(4, 5.7, 1.3, 0.02)])
    >>> low.size, high.size
    (0.8, 1.3)
    >>> find_contradicting([BandSize(1, 1.4, 0.99, 0.01), BandSize(4, 5.7, 1.02, 0.02)])
    """
    worst, found = 0.0, None
    for one, other in combinations(bands, 2):
        apart, std = abs(other.size - one.size), float(np.hypot(one.std, other.std))
        if apart > max(_LEAST_OFF, _CONTRADICTS * std) and apart / max(std, 1e-12) > worst:
            worst, found = apart / max(std, 1e-12), (one, other)
    return found
