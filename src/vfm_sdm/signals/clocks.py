"""Two series brought to the same stamps, and the lag that is left between them."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray, is_even_clock
from vfm_sdm.signals.resampling import interpolate_runs

__all__ = ["ROUNDED_STAMPS", "estimate_remaining_lag", "even_clock", "interpolate"]

_GAP_STEPS = 1.5
"""A step of a clock longer than this many intervals is a gap."""
ROUNDED_STAMPS = 0.05
"""Share of a frame interval by which stamps may miss an even clock and still count as that clock: containers round to
milliseconds, which is 3 % of an interval at 60 frames a second."""


def even_clock(time_s: FloatArray) -> tuple[FloatArray, float]:
    """The clock ``t0 + i / rate`` nearest to the stamps, and its rate; the stamps themselves where they are even."""
    steps = np.diff(time_s)
    whole = steps < _GAP_STEPS * np.median(steps)
    # The mean, because containers round stamps, and the median of rounded intervals is off.
    interval = float(steps[whole].mean())
    numbers = np.arange(int(np.floor((time_s[-1] - time_s[0]) / interval + 0.5)) + 1)
    grid = time_s[0] + numbers * interval
    if len(grid) == len(time_s) and is_even_clock(time_s, interval, tolerance=ROUNDED_STAMPS):
        return time_s, 1 / interval
    return grid, 1 / interval


def interpolate(have_s: FloatArray, values: FloatArray, want_s: FloatArray) -> FloatArray:
    """One series at other times, NaN over gaps and outside, shape (T',)."""
    longest = _GAP_STEPS * float(np.median(np.diff(have_s)))
    return interpolate_runs(have_s, values[:, None], want_s, longest_step_s=longest)[:, 0]


def estimate_remaining_lag(time_s: FloatArray, values: FloatArray, truth: FloatArray) -> float:
    """How much later the values happen than the truth [s], for lags much shorter than a period."""
    step = 0.05 * float(np.median(np.diff(time_s)))
    ahead, behind = (interpolate(time_s, truth, time_s + shift) for shift in (step, -step))
    columns = np.column_stack([np.ones_like(truth), truth, (ahead - behind) / (2 * step)])
    known = np.isfinite(columns).all(axis=1) & np.isfinite(values)
    if known.sum() < columns.shape[1] or np.linalg.matrix_rank(columns[known]) < columns.shape[1]:
        return float("nan")
    _, gain, slope = np.linalg.lstsq(columns[known], values[known])[0]
    return float(-slope / gain) if gain > 0 else float("nan")
