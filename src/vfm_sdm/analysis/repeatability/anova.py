"""Analysis of variance of one factor with random effects: how far results of one person, and of several, differ."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from vfm_sdm.core.arrays import FloatArray, IntArray

__all__ = ["Spread", "analyse_variance"]

_COVERAGE = 0.95


@dataclass(frozen=True)
class Spread:
    """Standard deviations of results, in the unit of the results; NaN where too few results tell.

    Parameters
    ----------
    repeatability, repeatability_low, repeatability_high
        Of results of one person, with an interval of 95 %.
    between
        Of what a person adds to all his results; zero where nothing can be told from chance.
    reproducibility, reproducibility_low, reproducibility_high
        Of single results of different persons, both together.
    p_value
        Probability of persons that differ so much by chance.
    """

    repeatability: float
    repeatability_low: float
    repeatability_high: float
    between: float
    reproducibility: float
    reproducibility_low: float
    reproducibility_high: float
    p_value: float


def analyse_variance(values: FloatArray, persons: Sequence[int] | IntArray) -> Spread:
    """Repeatability and reproducibility of results.

    Parameters
    ----------
    values
        Results, shape (R,), or (R, N) of N samples each, whose variances are averaged.
    persons
        Who made each, shape (R,).

    Notes
    -----
    ``s_r^2`` is the mean square within persons, ``s_L^2`` what that between persons is larger by, over the mean number
    of results a person, and ``s_R^2 = s_r^2 + s_L^2`` [1]_; negative estimates of ``s_L^2`` are zero. Where everybody
    has one result alone, the spread of all is the reproducibility, and nothing tells the repeatability. The interval of
    ``s_r`` is that of chi-square, and of ``s_R`` with Satterthwaite's degrees of freedom [2]_. Samples of one series
    are alike, and give no more degrees of freedom than one.

    References
    ----------
    .. [1] ISO 5725-2:2019. Accuracy (trueness and precision) of measurement methods and results, section 7.4.
    .. [2] Satterthwaite, F. E. (1946). An approximate distribution of estimates of variance components. Biometrics
       Bulletin 2(6), 110-114.

    Examples
    --------
    >>> spread = analyse_variance(np.array([4.9, 5.1, 5.4, 5.6]), [0, 0, 1, 1])
    >>> round(spread.repeatability, 3), round(spread.reproducibility, 3)
    (0.141, 0.367)
    """
    results = np.asarray(values, dtype=float).reshape(len(values), -1)
    results = results[:, np.isfinite(results).all(axis=0)]
    names, member, counts = np.unique(persons, return_inverse=True, return_counts=True)
    groups, total = len(names), len(results)
    nothing, unknown = float("nan"), (float("nan"),) * 3
    if total < 2 or not results.shape[1]:
        return Spread(*unknown, nothing, *unknown, nothing)
    means = np.stack([results[member == group].mean(axis=0) for group in range(groups)])
    within_freedom, between_freedom = total - groups, groups - 1
    within = float(np.mean(np.sum((results - means[member]) ** 2, axis=0))) / max(within_freedom, 1)
    if not between_freedom:
        return Spread(*_limits(within, within_freedom), nothing, *unknown, nothing)
    deviations = counts[:, None] * (means - results.mean(axis=0)) ** 2
    between = float(np.mean(deviations.sum(axis=0))) / between_freedom
    if not within_freedom:
        return Spread(*unknown, nothing, *_limits(between, between_freedom), nothing)
    each = (total - np.sum(counts**2) / total) / between_freedom
    added = max(between - within, 0.0) / each
    both = within + added
    freedom = float(total - 1)
    if added:
        parts = (between / each) ** 2 / between_freedom + ((1 - 1 / each) * within) ** 2 / within_freedom
        freedom = float(both**2 / parts)
    p_value = float(stats.f.sf(between / within, between_freedom, within_freedom)) if within else nothing
    return Spread(*_limits(within, within_freedom), float(np.sqrt(added)), *_limits(both, freedom), p_value)


def _limits(variance: float, freedom: float) -> tuple[float, float, float]:
    """A standard deviation and its interval."""
    tails = (1 - _COVERAGE) / 2
    low, high = (float(stats.chi2.ppf(share, freedom)) for share in (1 - tails, tails))
    return float(np.sqrt(variance)), float(np.sqrt(variance * freedom / low)), float(np.sqrt(variance * freedom / high))
