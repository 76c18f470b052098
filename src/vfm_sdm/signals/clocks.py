"""Stamps of series: which lie in an interval, two series on the same ones, and the lag that is left between them."""

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, is_even_clock
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.resampling import interpolate_runs

__all__ = ["ROUNDED_STAMPS", "estimate_remaining_lag", "even_clock", "interpolate", "still_frames"]

_GAP_STEPS = 1.5
"""A step of a clock longer than this many intervals is a gap."""
ROUNDED_STAMPS = 0.05
"""Share of a frame interval by which stamps may miss an even clock and still count as that clock: containers round to
milliseconds, which is 3 % of an interval at 60 frames a second."""


def even_clock(time_s: FloatArray) -> tuple[FloatArray, float]:
    """The even clock nearest to the stamps, and its rate.

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s]; T is at least 2.

    Returns
    -------
    clock_s
        ``t0 + i / rate`` over the whole time, shape (T',) [s]; the stamps themselves where they are even to 5 % of an
        interval and none is missing.
    rate_hz
        Samples a second [Hz].

    Examples
    --------
    >>> clock_s, rate_hz = even_clock(np.array([0.0, 0.1, 0.2, 0.4, 0.5]))
    >>> clock_s.round(6).tolist(), round(rate_hz, 6)
    ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], 10.0)
    """
    steps = np.diff(time_s)
    whole = steps < _GAP_STEPS * np.median(steps)
    # The mean, because containers round stamps, and the median of rounded intervals is off.
    interval = float(steps[whole].mean())
    numbers = np.arange(int(np.floor((time_s[-1] - time_s[0]) / interval + 0.5)) + 1)
    grid = time_s[0] + numbers * interval
    if len(grid) == len(time_s) and is_even_clock(time_s, interval, tolerance=ROUNDED_STAMPS):
        return time_s, 1 / interval
    return grid, 1 / interval


def still_frames(time_s: FloatArray, still_interval_s: tuple[float, float]) -> BoolArray:
    """Frames of the interval during which the structure rests, shape (T,).

    Raises
    ------
    DatasetError
        No frame lies in it.
    """
    still = (time_s >= still_interval_s[0]) & (time_s <= still_interval_s[1])
    if not still.any():
        raise DatasetError(
            f"still interval: expected frames between {still_interval_s[0]} and {still_interval_s[1]} s, got a "
            f"recording from {time_s[0]:.3f} to {time_s[-1]:.3f} s; correct method.still_interval_s"
        )
    return np.asarray(still)


def interpolate(have_s: FloatArray, values: FloatArray, want_s: FloatArray) -> FloatArray:
    """One series at other times.

    Parameters
    ----------
    have_s
        Increasing time stamps, shape (T,) [s].
    values
        The series, any unit, shape (T,); NaN where there is no value.
    want_s
        Times wanted, shape (T',) [s].

    Returns
    -------
    interpolated
        Shape (T',); NaN over gaps and outside the series.

    Examples
    --------
    >>> time_s = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    >>> interpolate(time_s, 2 * time_s, np.array([0.15, 0.5])).round(6).tolist()
    [0.3, nan]
    """
    longest = _GAP_STEPS * float(np.median(np.diff(have_s)))
    return interpolate_runs(have_s, values[:, None], want_s, longest_step_s=longest)[:, 0]


def estimate_remaining_lag(time_s: FloatArray, values: FloatArray, truth: FloatArray) -> float:
    """How much later the values happen than the truth [s], for lags much shorter than a period.

    Parameters
    ----------
    time_s
        Increasing time stamps of both, shape (T,) [s].
    values, truth
        Series of one unit, shape (T,); NaN where there is no value.

    Returns
    -------
    lag_s
        Positive when the values happen later [s]; NaN where the series do not say.

    Notes
    -----
    Least squares of ``values = a + g truth - g lag d(truth)/dt``, with the derivative from splines through the truth.

    Examples
    --------
    >>> time_s = np.arange(300) / 30
    >>> late, truth = np.sin(2 * np.pi * (time_s - 0.004)), np.sin(2 * np.pi * time_s)
    >>> round(estimate_remaining_lag(time_s, late, truth), 3)
    0.004
    """
    step = 0.05 * float(np.median(np.diff(time_s)))
    ahead, behind = (interpolate(time_s, truth, time_s + shift) for shift in (step, -step))
    columns = np.column_stack([np.ones_like(truth), truth, (ahead - behind) / (2 * step)])
    known = np.isfinite(columns).all(axis=1) & np.isfinite(values)
    if known.sum() < columns.shape[1] or np.linalg.matrix_rank(columns[known]) < columns.shape[1]:
        return float("nan")
    _, gain, slope = np.linalg.lstsq(columns[known], values[known])[0]
    return float(-slope / gain) if gain > 0 else float("nan")
