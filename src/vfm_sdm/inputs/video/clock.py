"""What the time stamps of a view say about frames that are missing."""

import numpy as np
from scipy.ndimage import median_filter

from vfm_sdm.core.arrays import FloatArray, as_float_array

__all__ = ["count_dropped"]

_NEIGHBOURS = 61
"""Intervals over which the nominal interval is taken: one to two seconds, longer than any burst of lost frames."""
_DROP_RATIO = 1.5
_WHOLE_TOLERANCE = 0.25
_REGULAR_SHARE = 0.8


def count_dropped(time_s: FloatArray) -> tuple[int, bool]:
    """Number of frames missing in a clock, and whether the clock is regular enough to tell.

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s].

    Returns
    -------
    missing
        Frames missing between the first and the last.
    regular
        ``False`` where the intervals are so irregular that a long one is no sign of a lost frame; ``missing`` is
        then 0.

    Raises
    ------
    DatasetError
        The stamps are not one row of numbers.

    Notes
    -----
    The nominal interval is the median of the intervals seen: of all of them in a short recording, of the 61 around
    it in a longer one, so that a camera that changes its rate on the way (variable frame rate) is not taken for one
    that loses frames. An interval above 1.5 nominal ones has lost ``round(interval / nominal) - 1`` frames. A clock
    counts as regular when at least 80 % of its intervals lie within a quarter of a nominal interval of a whole
    multiple of it; of intervals spread at random, half do.

    Examples
    --------
    >>> count_dropped(np.array([0.0, 0.1, 0.2, 0.5, 0.6]))
    (2, True)
    """
    intervals = np.diff(as_float_array(time_s, "time_s", (None,)))
    if intervals.size < 2:
        return 0, True
    # "mirror" takes the end intervals once, so that a gap right at the start is not its own nominal interval.
    short = intervals.size <= _NEIGHBOURS
    nominal = np.median(intervals) if short else median_filter(intervals, _NEIGHBOURS, mode="mirror")
    ratio = intervals / nominal
    multiple = np.maximum(np.rint(ratio), 1)
    if np.mean(np.abs(ratio - multiple) <= _WHOLE_TOLERANCE) < _REGULAR_SHARE:
        return 0, False
    return int(np.sum(multiple[ratio > _DROP_RATIO] - 1)), True
