"""Ratio of two clocks' rates from the lag in successive windows."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.stages.synchronize.subsample import SubsampleEstimator, SubsampleLag

__all__ = ["Drift", "estimate_drift"]

_SHORTEST_S = 60.0
_WINDOW_S = 15.0
_FEWEST_WINDOWS = 3


@dataclass(frozen=True)
class Drift:
    """A lag that grows steadily."""

    lag_s: float
    """The lag at ``at_s``, where it is independent of the slope [s]."""
    lag_std_s: float
    """Standard deviation of that lag [s]."""
    slope: float
    """Seconds of lag a second of the first clock [1]."""
    slope_std: float
    """Standard deviation of the slope [1]."""
    at_s: float
    """Time on the first clock that the lag belongs to [s]."""


def estimate_drift(estimator: SubsampleEstimator, start: SubsampleLag) -> Drift | None:
    """Lag and its growth over a long recording, by a weighted line through the lags of windows.

    Parameters
    ----------
    estimator
        Estimator for the two recordings.
    start
        Lag of the recording as a whole [s].

    Returns
    -------
    drift
        Lag [s] and slope [1]; ``None`` below a minute of common time, or with motion in fewer than three windows.

    Notes
    -----
    Windows are taken from the middle outwards, each started at the lag of its neighbour. Standard deviations grow by
    the root of the line's reduced chi-square where that is above 1.
    """
    first, second = estimator.first, estimator.second
    begin = max(first.time_s[0], second.time_s[0] - start.lag_s)
    end = min(first.time_s[-1], second.time_s[-1] - start.lag_s)
    if end - begin < _SHORTEST_S:
        return None
    edges = np.linspace(begin, end, int((end - begin) / _WINDOW_S) + 1)
    middle = (edges.size - 1) // 2
    fits = _follow_windows(estimator, start.lag_s, edges[middle:])
    fits += _follow_windows(estimator, fits[0].lag_s if fits else start.lag_s, edges[middle::-1])
    if len(fits) < _FEWEST_WINDOWS:
        return None
    at, lag, std = (np.array([getattr(fit, name) for fit in fits]) for name in ("at_s", "lag_s", "lag_std_s"))
    weight = 1 / std**2
    centre = float((weight * at).sum() / weight.sum())
    level = float((weight * lag).sum() / weight.sum())
    spread = float((weight * (at - centre) ** 2).sum())
    slope = float((weight * (at - centre) * lag).sum() / spread)
    misfit = float((weight * (lag - level - slope * (at - centre)) ** 2).sum() / (len(fits) - 2))
    factor = float(np.sqrt(max(1.0, misfit)))
    return Drift(level, factor / float(np.sqrt(weight.sum())), slope, factor / float(np.sqrt(spread)), centre)


def _follow_windows(estimator: SubsampleEstimator, lag_s: float, edges: FloatArray) -> list[SubsampleLag]:
    """Lags of successive windows, each started at the one before; windows without a clear lag are left out."""
    fits = []
    for one, other in pairwise(edges):
        fit = estimator.estimate(lag_s, (min(one, other), max(one, other)))
        if fit.converged and 0 < fit.lag_std_s < 0.5 / estimator.first.rate_hz:
            fits.append(fit)
            lag_s = fit.lag_s
    return fits
