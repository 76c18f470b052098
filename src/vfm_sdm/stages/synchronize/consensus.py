"""Which points tell a lag, which of them agree on it, and the peaks that those have together."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import ClockUse
from vfm_sdm.stages.synchronize.search import Group, average_groups
from vfm_sdm.stages.synchronize.signals import Signal
from vfm_sdm.stages.synchronize.subsample import SubsampleEstimator, SubsampleLag

__all__ = ["Consensus", "Joint", "SearchedLags", "find_consensus", "is_tie", "tie_limit"]

_NEARLY_WHOLE = 0.8
"""Share of the samples needed that must meet at the start value, where other lags have them all."""
_ESTIMATED_PEAKS = 12
_REACH = 1.5
"""Samples between a peak of the search and its estimated place; what lies farther away is another peak."""
_TIE = 3.0
"""Standard deviations by which a peak must be better than the next."""
_BETTER = 2.5
"""The same for peaks that are compared sample by sample: one in 160 for motion that repeats itself exactly."""
_MOSTLY = 0.5
"""Share of the second signal's variance that a lag must explain to be compared sample by sample."""
_CHANCE = 1e-3
"""Probability with which two unrelated recordings of noise may pass for related."""


@dataclass(frozen=True, eq=False)
class Joint:
    """What some groups say together."""

    estimator: SubsampleEstimator
    estimated: list[SubsampleLag]
    """The peaks that may be the best, each to a fraction of a sample; the best first."""
    highest: float
    """Highest dependence at the lags that were searched; NaN where too few samples meet at all of them."""
    at_edge: bool
    """Whether that lies at an end of the search."""

    @property
    def beside(self) -> bool:
        """Whether the search ends on a rise: the best lag may lie beyond."""
        return self.at_edge and self.highest > self.estimated[0].dependence


@dataclass(frozen=True, eq=False)
class SearchedLags:
    """Dependence of every group at the lags of a search."""

    first: Signal
    second: Signal
    groups: Sequence[Group]
    lags: FloatArray
    """Lags searched, whole samples apart, shape (K,) [s]."""
    dependence: FloatArray
    """Of each of G groups, shape (G, K) [1]."""
    samples: FloatArray
    """Samples that meet, shape (G, K) [1]."""
    start_lag_s: float
    """Centre of the search [s]."""
    shortest: float
    """Samples that must meet at a lag worth considering."""
    fewest: float = 0.0
    """Samples below which a group does not count: a period of the slowest motion."""
    trials: float = 1.0
    """Independent lags in the search."""
    _own: dict[int, Joint] = field(default_factory=dict)

    def own(self, group: int) -> Joint:
        """What a group says alone, where it has enough samples for that; computed once."""
        if group not in self._own:
            enough = self.samples[group].max(initial=0.0) >= self.shortest
            self._own[group] = self.joint([group], None if enough else self.fewest)
        return self._own[group]

    @cached_property
    def counted(self) -> list[int]:
        """Groups that have enough samples to count at some lag."""
        return np.flatnonzero(self.samples.max(axis=1, initial=0.0) >= self.fewest).tolist()

    def joint(self, members: Sequence[int], shortest: float | None = None) -> Joint:
        """What some groups say together, at lags where enough samples meet."""
        chosen = list(members)
        dependence, samples = average_groups(self.dependence[chosen], self.samples[chosen], self.fewest)
        least = self.shortest if shortest is None else shortest
        covered = self._covered(chosen, samples)
        enough = covered >= least
        # A lag that samples are missing for may be the true one: what is seen must be whole around the start value,
        # but for a few samples at the ends of short recordings.
        start = int(np.argmin(np.abs(self.lags - self.start_lag_s))) if self.lags.size else 0
        seen = enough.any() and covered[start] >= _NEARLY_WHOLE * min(covered.max(), least)
        whole = seen and np.count_nonzero(np.diff(np.flatnonzero(enough)) > 1) == 0
        dependence = np.where(enough & whole, dependence, np.nan)
        estimator = self._estimator(chosen)
        if not np.isfinite(dependence).any():
            return Joint(estimator, [], np.nan, at_edge=False)
        estimated = _estimate_peaks(estimator, self.lags, dependence)
        at_edge = int(np.nanargmax(dependence)) not in _find_peaks(dependence)
        return Joint(estimator, estimated, float(np.nanmax(dependence)), at_edge)

    def _covered(self, members: Sequence[int], samples: FloatArray) -> FloatArray:
        """Samples at which any of some groups meets, shape (K,); those of the mean group where these suffice."""
        covered = samples.copy()
        ahead = self.second.start_s - self.first.start_s
        for number in np.flatnonzero((samples < self.shortest) & (samples > 0)) if len(members) > 1 else ():
            step = round((self.lags[number] - ahead) * self.first.rate_hz)
            stop = min(len(self.first.valid), len(self.second.valid) - step)
            here, there = (slice(max(0, -step) + shift, stop + shift) for shift in (0, step))
            meets = [
                self.first.valid[here, self.groups[m][0]].all(axis=1)
                & self.second.valid[there, self.groups[m][1]].all(axis=1)
                for m in members
                if self.samples[m, number] >= self.fewest
            ]
            covered[number] = np.any(meets, axis=0).sum()
        return covered

    def _estimator(self, members: Sequence[int]) -> SubsampleEstimator:
        """Estimator of some groups, with their channels alone."""
        if len(members) == len(self.groups):
            return SubsampleEstimator(self.first, self.second, self.groups, fewest=self.fewest)
        columns = [sorted({c for m in members for c in self.groups[m][side]}) for side in (0, 1)]
        first, second = (
            Signal(signal.start_s, signal.rate_hz, signal.values[:, kept], signal.valid[:, kept])
            for signal, kept in zip((self.first, self.second), columns, strict=True)
        )
        groups = [
            (
                tuple(columns[0].index(c) for c in self.groups[m][0]),
                tuple(columns[1].index(c) for c in self.groups[m][1]),
            )
            for m in members
        ]
        return SubsampleEstimator(first, second, groups, fewest=self.fewest)

    def is_related(self, fit: SubsampleLag, members: Sequence[int]) -> bool:
        """Whether noise alone would hardly explain this much at the best of so many lags."""
        parameters = max(len(self.groups[m][0]) * len(self.groups[m][1]) for m in members)
        limit = float(chi2.isf(_CHANCE / max(self.trials, 1.0), parameters))
        return fit.dependence * fit.independent_samples > limit

    def dissent(self, group: int, lag_s: float) -> float:
        """How much better a group's own best lag explains it than another lag, over what noise may cause [1].

        Above 1, the group disagrees with that lag.
        """
        own = self.own(group)
        if not own.estimated:
            return 0.0
        best = own.estimated[0]
        here, there = own.estimator.dependences_at(best.lag_s, lag_s)
        limit = tie_limit(best, best, own.estimator.groups)
        return (here - there) / limit if np.isfinite(there) else 0.0


@dataclass(frozen=True, eq=False)
class Consensus:
    """The groups that agree on a lag."""

    members: tuple[int, ...]
    """Groups that agree."""
    joint: Joint
    uses: tuple[ClockUse, ...]
    """What became of every group."""
    rivals: tuple[float, ...] = ()
    """Lags [s] of as many other groups, which agree on another one."""

    def scatter(self, searched: SearchedLags, fit: SubsampleLag) -> float:
        """Factor by which the members' own lags scatter more than their standard deviations say, at least 1.

        The root of the reduced chi-square, as for any weighted mean.
        """
        if len(self.members) < 2:
            return 1.0
        own = [searched.own(m).estimator.estimate(fit.lag_s) for m in self.members]
        reach = _REACH / searched.first.rate_hz
        near = [one for one in own if one.converged and abs(one.lag_s - fit.lag_s) < reach and one.lag_std_s > 0]
        if len(near) < 2:
            return 1.0
        squares = sum(((one.lag_s - fit.lag_s) / one.lag_std_s) ** 2 for one in near)
        return float(np.sqrt(max(1.0, squares / (len(near) - 1))))


def find_consensus(searched: SearchedLags) -> Consensus:
    """The largest set of groups that agree on a lag, and why the others do not belong to it.

    Notes
    -----
    A group takes part if its own motion shows in both signals at some lag beyond what noise would explain; where none
    does alone, all are asked together. A group disagrees with a lag if its own best one explains it better by more
    than noise may cause. The one that disagrees most is left out, again and again, until all agree; if those left out
    agree on another lag and are more, they are taken instead. If they are as many, both lags are named.

    Parameters
    ----------
    searched
        The groups' dependence at all lags.
    """
    count = len(searched.groups)
    uses = [ClockUse.TOO_FEW] * count
    counted = searched.counted
    if len(counted) < 2:
        for group in counted:
            uses[group] = ClockUse.USED
        members = counted or list(range(count))
        return Consensus(tuple(members), searched.joint(members), tuple(uses))
    telling = [g for g in counted if (own := searched.own(g)).estimated and searched.is_related(own.estimated[0], [g])]
    for group in counted:
        uses[group] = ClockUse.DISAGREES if group in telling else ClockUse.NO_MOTION
    members, joint = _find_agreeing(searched, telling or counted)
    others, other = _find_agreeing(searched, [g for g in telling if g not in members])
    if len(others) > len(members):
        members, joint, others, other = others, other, members, joint
    for group in members:
        uses[group] = ClockUse.USED
    if joint.estimated:
        step = int(np.argmin(np.abs(searched.lags - joint.estimated[0].lag_s)))
        uses = [
            u if n >= searched.fewest else ClockUse.TOO_FEW
            for u, n in zip(uses, searched.samples[:, step], strict=True)
        ]
    rivals = tuple(fit.lag_s for fit in other.estimated[:1]) if len(others) == len(members) and other else ()
    return Consensus(tuple(members), joint, tuple(uses), rivals)


def _find_agreeing(searched: SearchedLags, members: Sequence[int]) -> tuple[list[int], Joint]:
    """Those of some groups that agree on a lag, and what they say together."""
    kept = list(members)
    joint = searched.joint(kept)
    while len(kept) > 1 and joint.estimated:
        dissent = [searched.dissent(g, joint.estimated[0].lag_s) for g in kept]
        worst = int(np.argmax(dissent))
        if dissent[worst] <= 1:
            break
        del kept[worst]
        joint = searched.joint(kept)
    return kept, joint


def tie_limit(one: SubsampleLag, other: SubsampleLag, groups: Sequence[Group]) -> float:
    """Difference in dependence that noise may cause between two lags.

    Parameters
    ----------
    one, other
        What was estimated at the two lags [s].
    groups
        The groups that were compared; the residuals of several may be one and the same, so that they count as one.
    """
    channels = max(len(group[1]) for group in groups)
    samples = max(min(one.independent_samples, other.independent_samples), 1.0)
    return float(_TIE * 2 * np.sqrt(channels / samples))


def is_tie(estimator: SubsampleEstimator, best: SubsampleLag, other: SubsampleLag) -> bool:
    """Whether noise may make one lag better than another by as much.

    Parameters
    ----------
    estimator
        What estimated both.
    best, other
        What was estimated at the two lags [s].
    """
    if other is best:
        return True
    if best.dependence - other.dependence > tie_limit(best, other, estimator.groups):
        return False
    if best.correlation**2 < _MOSTLY:  # the best of many peaks of noise is better than most of them, too
        return True
    return not estimator.compare(best.lag_s, other.lag_s) > _BETTER


def _find_peaks(dependence: FloatArray) -> list[int]:
    """Places higher than both neighbours, the highest first."""
    inner = dependence[1:-1]
    tops = np.flatnonzero((inner > dependence[:-2]) & (inner >= dependence[2:])) + 1
    return [int(top) for top in tops[np.argsort(-dependence[tops])]]


def _estimate_peaks(estimator: SubsampleEstimator, lags: FloatArray, dependence: FloatArray) -> list[SubsampleLag]:
    """The peaks that may be the best, each to a fraction of a sample; the best first."""
    tops = _find_peaks(dependence)
    estimated: list[SubsampleLag] = []
    lowest = -np.inf
    for top in tops[:_ESTIMATED_PEAKS]:
        if dependence[top] < lowest:
            break
        fit = estimator.estimate(float(lags[top]))
        if not (fit.converged and abs(fit.lag_s - lags[top]) < _REACH / estimator.first.rate_hz):
            continue
        if not estimated:
            # A peak as good, but half-way between two samples, is on the grid no lower than this one's neighbours.
            lowest = min(dependence[top - 1], dependence[top + 1]) - tie_limit(fit, fit, estimator.groups)
        estimated.append(fit)
    return sorted(estimated, key=lambda fit: -fit.dependence)
