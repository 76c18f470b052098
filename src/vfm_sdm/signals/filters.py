"""Filters of evenly sampled signals, shared by the reference sensors and the metrics."""

import math

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, as_float_array, unbroken_runs
from vfm_sdm.errors import DatasetError

__all__ = ["band_pass", "hampel", "low_pass", "shortest_band_pass_s"]

_PERIODS = 2.0
"""Periods of the band's lower edge that a series must hold to be filtered."""


def band_pass(values: npt.ArrayLike, rate_hz: float, band_hz: tuple[float, float], *, order: int = 4) -> FloatArray:
    """The part of a signal inside a frequency band, without phase shift.

    Parameters
    ----------
    values
        Any unit, shape (T, ...), evenly sampled along the first axis. NaN splits a series: each unbroken run is
        filtered on its own, and a run shorter than `shortest_band_pass_s` becomes NaN.
    rate_hz
        Samples a second [Hz].
    band_hz
        Lower and upper edge [Hz], below half the sampling rate.
    order
        Order of each edge of the Butterworth filter.

    Returns
    -------
    filtered
        Shape (T, ...), in the unit of the values.

    Raises
    ------
    DatasetError
        The band is empty, does not fit the sampling rate, or the order is not positive.

    Notes
    -----
    Run forwards and backwards in second-order sections: no phase shift, the squared response of the single pass. The
    edges are therefore at half the amplitude (-6 dB), and each falls off as order ``2 order`` would. The response
    differs from 1 by less than 0.5 % between about 1.6 and 6.2 Hz for a band of 1 to 10 Hz. Both ends ring for about a
    period of the lower edge.

    References
    ----------
    .. [1] Gustafsson, F. (1996). Determining the initial states in forward-backward filtering. IEEE Transactions on
       Signal Processing 44(4), 988-992.

    Examples
    --------
    >>> time_s = np.arange(600) / 60
    >>> slow, fast = np.sin(2 * np.pi * 0.1 * time_s), np.sin(2 * np.pi * 4 * time_s)
    >>> kept = band_pass(slow + fast, 60, (1.0, 10.0))
    >>> bool(np.abs(kept - fast)[120:-120].max() < 0.01)
    True
    """
    _check_band(rate_hz, band_hz, order)
    series = as_float_array(values, "values", (-1,))
    if series.ndim == 0:
        raise DatasetError("values: expected samples along the first axis, got a single number; pass an array")
    sections = signal.butter(order, band_hz, btype="bandpass", fs=rate_hz, output="sos")
    shortest = round(shortest_band_pass_s(rate_hz, band_hz, order=order) * rate_hz)
    columns = series.reshape(len(series), -1)
    filtered = np.full_like(columns, np.nan)
    for column in range(columns.shape[1]):
        for run in unbroken_runs(np.isfinite(columns[:, column])):
            if run.stop - run.start >= shortest:
                filtered[run, column] = signal.sosfiltfilt(sections, columns[run, column])
    return filtered.reshape(series.shape)


def shortest_band_pass_s(rate_hz: float, band_hz: tuple[float, float], *, order: int = 4) -> float:
    """How long an unbroken series must be for `band_pass` [s]: two periods of its lower edge, or the filter's start.

    Parameters
    ----------
    rate_hz
        Samples a second [Hz].
    band_hz
        Lower and upper edge [Hz], below half the sampling rate.
    order
        Order of each edge of the Butterworth filter.

    Raises
    ------
    DatasetError
        The band is empty, does not fit the sampling rate, or the order is not positive.

    Examples
    --------
    >>> shortest_band_pass_s(60, (1.0, 10.0))
    2.0
    """
    _check_band(rate_hz, band_hz, order)
    start = 3 * (2 * order + 1) + 1
    return max(math.ceil(_PERIODS / band_hz[0] * rate_hz), start) / rate_hz


def low_pass(values: FloatArray, rate_hz: float, cutoff_hz: float, *, order: int = 4) -> FloatArray:
    """The part of a signal below a frequency, without phase shift.

    Parameters
    ----------
    values
        Any unit, shape (T, ...), evenly sampled along the first axis, without gaps.
    rate_hz
        Samples a second [Hz].
    cutoff_hz
        Where half the amplitude passes [Hz], below half the sampling rate.
    order
        Order of the Butterworth filter, which runs forwards and backwards.

    Returns
    -------
    filtered
        Shape (T, ...), in the unit of the values.

    Raises
    ------
    DatasetError
        The cutoff does not fit the sampling rate, or the order is not positive.

    Examples
    --------
    >>> time_s = np.arange(600) / 60
    >>> slow, fast = np.sin(2 * np.pi * 0.1 * time_s), np.sin(2 * np.pi * 4 * time_s)
    >>> bool(np.abs(low_pass(slow + fast, 60, 1.0) - slow)[120:-120].max() < 0.005)
    True
    """
    _check_band(rate_hz, (min(cutoff_hz / 2, rate_hz / 8), cutoff_hz), order)
    sections = signal.butter(order, cutoff_hz, btype="lowpass", fs=rate_hz, output="sos")
    room = min(len(values) - 1, math.ceil(2 * rate_hz / cutoff_hz))
    return np.asarray(signal.sosfiltfilt(sections, values, axis=0, padlen=room))


def hampel(values: FloatArray, width: int, *, threshold: float = 3.5) -> tuple[FloatArray, BoolArray]:
    """The signal with outliers replaced by the median around them, and which samples those are.

    Parameters
    ----------
    values
        Any unit, shape (T, ...); each series along the first axis is filtered by itself.
    width
        Samples in the window, an odd number; near an end, the window is the first or the last full one.
    threshold
        Distance from the median above which a sample is an outlier, in scaled median absolute deviations (x 1.4826) of
        the window [1].

    Returns
    -------
    filtered
        The values with outliers replaced, shape (T, ...).
    replaced
        Which samples were, shape (T, ...).

    Raises
    ------
    DatasetError
        The window is even, or longer than the signal.

    References
    ----------
    .. [1] Hampel, F. R. (1974). The influence curve and its role in robust estimation. Journal of the American
       Statistical Association 69(346), 383-393.

    Examples
    --------
    >>> filtered, replaced = hampel(np.array([1.0, 1.1, 0.9, 25.0, 1.0, 1.1, 0.9]), 5)
    >>> filtered.tolist(), int(replaced.sum())
    ([1.0, 1.1, 0.9, 1.1, 1.0, 1.1, 0.9], 1)
    """
    if width % 2 == 0 or not 0 < width <= len(values):
        raise DatasetError(f"width: expected an odd number up to {len(values)} samples, got {width}; correct it")
    place = np.clip(np.arange(len(values)) - width // 2, 0, len(values) - width)
    columns = values.reshape(len(values), -1)
    result = columns.copy()
    for column in range(columns.shape[1]):
        windows = sliding_window_view(columns[:, column], width)
        middle = np.median(windows, axis=-1)
        spread = MAD_TO_STD * np.median(np.abs(windows - middle[:, None]), axis=-1)
        outlying = np.abs(columns[:, column] - middle[place]) > threshold * spread[place]
        result[outlying, column] = middle[place][outlying]
    return result.reshape(values.shape), (result != columns).reshape(values.shape)


def _check_band(rate_hz: float, band_hz: tuple[float, float], order: int) -> None:
    low, high = band_hz
    if not (0 < low < high < rate_hz / 2 and np.isfinite(rate_hz)):
        raise DatasetError(
            f"band_hz: expected 0 < low < high < {rate_hz / 2:g} Hz (half the sampling rate), got {low:g} and "
            f"{high:g}; choose another band or a higher sampling rate"
        )
    if order < 1:
        raise DatasetError(f"order: expected a positive number, got {order}; 4 is the usual one")
