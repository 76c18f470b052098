"""Recorded motion made ready for comparison: uniform clock, band of interest, gaps marked."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import fftconvolve

from vfm_sdm.core.arrays import BoolArray, FloatArray, as_float_array, mean_of_known
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.resampling import interpolate_runs

__all__ = ["Samples", "Signal", "check_signal", "prepare_signal", "sampling_rate"]

_GAP_STEPS = 1.5
"""A step of the clock longer than this many intervals is a gap."""
_LOWEST_COVERAGE = 0.8
"""Share of the smoothing kernel that must lie on valid samples; less near the ends and beside long gaps."""
_ROUNDING = 1e-12
"""Motion below this share of its level is arithmetic, not motion."""


class Samples(NamedTuple):
    """What was recorded, on the clock of the recording.

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s].
    values
        C channels in any units, shape (T, C); NaN where missing.
    """

    time_s: npt.ArrayLike
    values: npt.ArrayLike


@dataclass(frozen=True)
class Signal:
    """Motion in a band on a uniform clock."""

    start_s: float
    """Time of the first sample [s]."""
    rate_hz: float
    """Samples a second [Hz]."""
    values: FloatArray
    """Motion of C channels in any units, shape (T, C), zero mean in the band; 0 where not valid."""
    valid: BoolArray
    """Which samples are known, shape (T, C)."""

    @property
    def time_s(self) -> FloatArray:
        """Time stamps of the samples, shape (T,) [s]."""
        return np.asarray(self.start_s + np.arange(len(self.values)) / self.rate_hz)


def check_signal(samples: Samples, name: str) -> tuple[FloatArray, FloatArray]:
    """Time stamps and values of a recording as arrays.

    Parameters
    ----------
    samples
        Time stamps, shape (T,) [s], and C channels in any units, shape (T, C).
    name
        Name of the recording in messages.

    Raises
    ------
    DatasetError
        Shapes disagree, or the stamps are not finite and increasing.

    Examples
    --------
    >>> time_s, values = check_signal(Samples(np.arange(4) / 30, np.zeros((4, 2))), "left")
    >>> time_s.shape, values.shape
    ((4,), (4, 2))
    """
    time_s = as_float_array(samples.time_s, f"time of {name}", (None,))
    values = as_float_array(samples.values, f"values of {name}", (time_s.size, None))
    if not np.isfinite(time_s).all() or np.any(np.diff(time_s) <= 0):
        raise DatasetError(f"time of {name}: expected finite, increasing stamps, got others; sort the samples")
    return time_s, values


def sampling_rate(time_s: FloatArray) -> float:
    """Samples a second, from the median step [Hz].

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s].

    Examples
    --------
    >>> round(sampling_rate(np.array([0.0, 0.02, 0.04, 0.1])), 6)
    50.0
    """
    return float(1 / np.median(np.diff(time_s)))


def prepare_signal(time_s: FloatArray, values: FloatArray, *, rate_hz: float, band_hz: tuple[float, float]) -> Signal:
    """The motion in a band, on a uniform clock from the first stamp on.

    Parameters
    ----------
    time_s, values
        Time stamps, shape (T,) [s], and C channels in any units, shape (T, C); NaN where missing.
    rate_hz
        Rate of the uniform clock [Hz].
    band_hz
        Frequencies where the filter passes 71 % [Hz].

    Notes
    -----
    The band-pass is the difference of two means under Gaussian weights, a short and a long one. Both are taken over
    the valid samples only, so that a gap needs no filling; samples with too little around them are not valid after it.
    The filter is symmetric in time: it shifts nothing.

    Examples
    --------
    >>> time_s = np.arange(300) / 30
    >>> values = 5.0 + np.sin(2 * np.pi * 3 * time_s)
    >>> signal = prepare_signal(time_s, values[:, None], rate_hz=30.0, band_hz=(0.5, 12.0))
    >>> signal.values.shape, bool(abs(signal.values[signal.valid].mean()) < 0.01)
    ((300, 1), True)
    """
    count = int(np.floor((time_s[-1] - time_s[0]) * rate_hz + 1e-6)) + 1
    grid = time_s[0] + np.arange(count) / rate_hz
    longest = _GAP_STEPS / sampling_rate(time_s)
    columns = [interpolate_runs(time_s, column[:, None], grid, longest_step_s=longest) for column in values.T]
    sampled = np.hstack(columns)
    valid = np.isfinite(sampled)
    level = np.nan_to_num(mean_of_known(sampled))
    filled = np.where(valid, sampled - level, 0.0)
    smooth, near = _weighted_mean(filled, valid, rate_hz * _gaussian_width(band_hz[1], np.sqrt(0.5)))
    drift, wide = _weighted_mean(filled, valid, rate_hz * _gaussian_width(band_hz[0], 1 - np.sqrt(0.5)))
    usable = valid & (near >= _LOWEST_COVERAGE) & (wide >= _LOWEST_COVERAGE)
    moving = np.abs(smooth - drift).max(axis=0, initial=0.0, where=usable) > _ROUNDING * np.abs(level)
    return Signal(float(time_s[0]), rate_hz, np.where(usable & moving, smooth - drift, 0.0), usable)


def _gaussian_width(frequency_hz: float, gain: float) -> float:
    """Standard deviation [s] of the Gaussian weights that pass a frequency with a gain."""
    return float(np.sqrt(-np.log(gain) / 2) / (np.pi * frequency_hz))


def _weighted_mean(values: FloatArray, valid: BoolArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Mean of valid neighbours under Gaussian weights, and the share of the weights on valid samples; (T, C) each."""
    half = int(np.ceil(4 * width))
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
    weights = (weights / weights.sum())[:, None]
    # "same" would centre on the kernel where that is the longer of the two.
    share = fftconvolve(valid.astype(float), weights, axes=0)[half : half + len(values)]
    total = fftconvolve(values, weights, axes=0)[half : half + len(values)]
    return np.asarray(total / np.maximum(share, 1e-3)), np.asarray(share)
