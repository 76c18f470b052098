"""The lag between two recordings of one motion: searched widely, estimated to a fraction of a sample, judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.statuses import ClockStatus, ClockUse
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.synchronize.clock_rate import estimate_drift
from vfm_sdm.stages.synchronize.consensus import Consensus, SearchedLags, find_consensus, is_tie
from vfm_sdm.stages.synchronize.search import Group, compute_dependence
from vfm_sdm.stages.synchronize.signals import Samples, Signal, check_signal, prepare_signal, sampling_rate
from vfm_sdm.stages.synchronize.subsample import SubsampleLag

__all__ = ["LagSearch", "Synchronization", "estimate_lag"]

_FEWEST_STAMPS = 4
_HIGHEST_SHARE = 0.25
"""Highest frequency used, as a share of the lower sampling rate; above, interpolation changes amplitudes."""
_SHORTEST_OVERLAP_S = 3.0
_SHORTEST_OVERLAP = 0.3
"""Share of the shorter recording that must overlap the other at a lag worth considering."""
_PRIOR_REACH = 4.0
"""Standard deviations around a start value that are searched."""
_LEAST_SEARCH = 4.0
"""Samples on either side of a start value that are searched at least."""
_PRIOR_PREFERENCE = 9.0
"""Difference of squared standardised distances from the start value that decides between equal peaks."""


@dataclass(frozen=True)
class LagSearch:
    """Where a lag is looked for.

    Parameters
    ----------
    search_s
        Lags up to this far from the start value are considered [s].
    start_lag_s
        Centre of the search [s].
    start_std_s
        Standard deviation of the start value [s], where it is known (absolute time stamps): it narrows the search to
        four times its value, and decides between peaks that are equally good.
    """

    search_s: float = 2.0
    start_lag_s: float = 0.0
    start_std_s: float | None = None


@dataclass(frozen=True)
class Synchronization:
    """How the clock of a second recording relates to that of the first."""

    lag_s: float
    """Seconds by which an event at ``at_s`` shows up later in the second recording, each on its own clock."""
    lag_std_s: float
    """Standard deviation of the lag [s]."""
    correlation: float
    """Root of the share of the second motion's variance in the band that the first explains at this lag."""
    status: str
    """One of `ClockStatus`."""
    rate_ratio: float = 1.0
    """Seconds of the first clock a second of the second clock; 1 unless estimated."""
    rate_ratio_std: float = np.nan
    """NaN unless estimated."""
    at_s: float = 0.0
    """Time on the first clock at which ``lag_s`` holds."""
    candidates: tuple[float, ...] = ()
    """Lags [s] that explain the recordings about as well as the best one, best first; it is among them."""
    uses: tuple[ClockUse, ...] = ()
    """What became of every group of channels, such as the points of two views."""

    @property
    def ok(self) -> bool:
        """Whether there is a lag."""
        return self.status == ClockStatus.OK

    @property
    def offset_s(self) -> float:
        """Seconds on the first clock at which the second clock reads 0: ``t_a = t_b * rate_ratio + offset_s``.

        With equal clock rates this is ``-lag_s``.
        """
        return self.at_s - self.rate_ratio * (self.at_s + self.lag_s)


def estimate_lag(
    first: Samples,
    second: Samples,
    *,
    search: LagSearch,
    groups: Sequence[Group] | None = None,
    positive_gain: bool = False,
    band_hz: tuple[float, float] = (0.5, 12.0),
) -> Synchronization:
    """Lag of the second recording behind the first: b(t + lag) = M a(t) + noise, with unknown mixtures M.

    Parameters
    ----------
    first, second
        The recordings a and b: time stamps of Ta and Tb samples, each on its own clock [s], rates may differ; Ca and
        Cb channels of any units, NaN where missing.
    search
        Where the lag is looked for [s].
    groups
        Pairs of channel numbers, of a and of b, that are compared together, such as (u, v) of one point in two views.
        Without them, all channels of a are compared with all of b.
    positive_gain
        Both sides of a group have the same channels in the same order, and on the whole these cannot be negatively
        related (same axes, same signs).
    band_hz
        Band of interest [Hz]. The upper end is at most a quarter of the lower sampling rate.

    Returns
    -------
    synchronization
        The lag [s] and what is known of it; NaN and a named status where the recordings do not tell it.

    Raises
    ------
    DatasetError
        Arrays, groups, search or band are malformed.

    Notes
    -----
    The objective is the likelihood of the regression with unknown residual covariance, -log det(1 - R^2) over the
    canonical correlations R. It does not change when either side is mixed or scaled, so that two views of a motion in
    mainly two directions compare without knowing the cameras, and noisy points count less by themselves.

    Peaks are listed by their mean log generalised residual variance. For residuals of n independent samples in q
    channels, its difference between two lags scatters by at most 2 sqrt(q / n); what is better by three times that has
    no rival. What is not, is compared with the best peak over the samples that both predict, where they share most of
    their noise (`SubsampleEstimator.compare`); 2.5 standard deviations make a peak unique.

    A lag of whole samples is found first, by Fourier transforms, and then estimated to a fraction of a sample
    (`SubsampleEstimator`). Noise in a weakens M but does not shift the lag. Motion that only one side sees shifts it
    where it is coherent with the seen motion a quarter period apart, by at most about arctan(ratio) / (2 pi f);
    channels that it disturbs weigh less.

    For a common time over a minute the ratio of the clock rates is estimated from windows (`estimate_drift`); the two
    clocks must agree so well that the drift over the recording stays under a quarter period of the motion.

    References
    ----------
    .. [1] Hotelling, H. (1936). Relations between two sets of variates. Biometrika 28(3/4), 321-377.

    Examples
    --------
    >>> time_s = np.arange(600) / 30
    >>> def seen(t):
    ...     motion = np.sin(2 * np.pi * 1.7 * t) + np.sin(2 * np.pi * (1 + 0.05 * t) * t)
    ...     return Samples(time_s, motion[:, None])
    >>> found = estimate_lag(seen(time_s), seen(time_s - 0.125), search=LagSearch(search_s=1.0))
    >>> found.ok, round(found.lag_s, 3)
    (True, 0.125)
    """
    time_a, values_a = check_signal(first, "a")
    time_b, values_b = check_signal(second, "b")
    groups = groups or [(tuple(range(values_a.shape[1])), tuple(range(values_b.shape[1])))]
    _check_options(groups, values_a.shape[1], values_b.shape[1], positive_gain)
    _check_search(search)
    if min(time_a.size, time_b.size) < _FEWEST_STAMPS:
        return _report_failure(ClockStatus.TOO_SHORT)
    rates = sampling_rate(time_a), sampling_rate(time_b)
    band = (band_hz[0], min(band_hz[1], _HIGHEST_SHARE * min(rates)))
    if not 0 < band_hz[0] < band_hz[1]:
        raise DatasetError(f"band_hz: expected 0 < low < high, got {band_hz}; correct it")
    if not band[0] < band[1]:
        return _report_failure(ClockStatus.TOO_SLOW)
    signal_a = prepare_signal(time_a, values_a, rate_hz=max(rates), band_hz=band)
    signal_b = prepare_signal(time_b, values_b, rate_hz=max(rates), band_hz=band)
    if search.start_std_s is not None:
        # A peak is seen only with its neighbours, however well the start is known.
        reach = max(_PRIOR_REACH * search.start_std_s, _LEAST_SEARCH / min(rates))
        search = replace(search, search_s=min(search.search_s, reach))
    fewest = signal_a.rate_hz / band[0]
    searched = _search_lags(signal_a, signal_b, groups, search, positive_gain)
    searched = replace(searched, fewest=fewest, trials=2 * band[1] * searched.lags.size / signal_a.rate_hz)
    consensus = find_consensus(searched)
    return replace(_judge_consensus(searched, consensus, search), uses=consensus.uses)


def _judge_consensus(searched: SearchedLags, consensus: Consensus, search: LagSearch) -> Synchronization:
    """The lag of the groups that agree, or the reason why there is none."""
    joint = consensus.joint
    if not joint.estimated:
        if not np.isfinite(joint.highest):
            return _report_failure(ClockStatus.TOO_SHORT)
        still = not joint.highest > 0
        return _report_failure(
            ClockStatus.NO_MOTION if still else ClockStatus.AT_EDGE if joint.at_edge else ClockStatus.NOT_CONVERGED
        )
    best = joint.estimated[0]
    if not searched.is_related(best, consensus.members):
        return _report_failure(ClockStatus.NO_MOTION, best.correlation)
    if joint.beside:
        return _report_failure(ClockStatus.AT_EDGE, best.correlation)
    chosen, candidates = _choose_peak(consensus, search)
    if chosen is None or consensus.rivals:
        return _report_failure(ClockStatus.NOT_UNIQUE, best.correlation, (*candidates, *consensus.rivals))
    found = _with_clock_rate(consensus, chosen, candidates)
    return replace(found, lag_std_s=found.lag_std_s * consensus.scatter(searched, chosen))


def _with_clock_rate(consensus: Consensus, chosen: SubsampleLag, candidates: tuple[float, ...]) -> Synchronization:
    """The lag that was chosen, freed from drift where the recording is long enough to see it."""
    drift = estimate_drift(consensus.joint.estimator, chosen)
    if drift is None:
        return Synchronization(
            chosen.lag_s, chosen.lag_std_s, chosen.correlation, ClockStatus.OK, at_s=chosen.at_s, candidates=candidates
        )
    return Synchronization(
        lag_s=drift.lag_s,
        lag_std_s=drift.lag_std_s,
        correlation=chosen.correlation,
        status=ClockStatus.OK,
        rate_ratio=1 / (1 + drift.slope),
        rate_ratio_std=drift.slope_std / (1 + drift.slope) ** 2,
        at_s=drift.at_s,
        candidates=candidates,
    )


def _search_lags(
    first: Signal, second: Signal, groups: Sequence[Group], search: LagSearch, positive_gain: bool
) -> SearchedLags:
    """Lags of the search, whole samples apart, and every group's dependence there."""
    rate, ahead = first.rate_hz, second.start_s - first.start_s
    lowest = int(np.floor((search.start_lag_s - search.search_s - ahead) * rate))
    highest = int(np.ceil((search.start_lag_s + search.search_s - ahead) * rate))
    steps = np.arange(max(lowest, 1 - len(first.values)), min(highest, len(second.values) - 1) + 1)
    dependence, samples = compute_dependence(first, second, groups, steps, positive_gain=positive_gain)
    shortest = max(_SHORTEST_OVERLAP_S * rate, _SHORTEST_OVERLAP * min(len(first.values), len(second.values)))
    lags, start = ahead + steps / rate, search.start_lag_s
    return SearchedLags(first, second, groups, lags, dependence, samples, start_lag_s=start, shortest=shortest)


def _choose_peak(consensus: Consensus, search: LagSearch) -> tuple[SubsampleLag | None, tuple[float, ...]]:
    """The peak that stands out, by itself or by its start value; and all that are about as good."""
    estimated = consensus.joint.estimated
    best = estimated[0]
    tied: list[SubsampleLag] = []
    for fit in estimated:
        known = any(abs(fit.lag_s - other.lag_s) < 3 * max(fit.lag_std_s, other.lag_std_s, 1e-4) for other in tied)
        if is_tie(consensus.joint.estimator, best, fit) and not known:
            tied.append(fit)
    candidates = tuple(fit.lag_s for fit in tied)
    if len(tied) == 1:
        return best, candidates
    if search.start_std_s is None:
        return None, candidates
    ranked = sorted(tied, key=lambda fit: abs(fit.lag_s - search.start_lag_s))
    near, next_near = (((fit.lag_s - search.start_lag_s) / search.start_std_s) ** 2 for fit in ranked[:2])
    return (ranked[0] if next_near - near > _PRIOR_PREFERENCE else None), candidates


def _report_failure(status: str, correlation: float = np.nan, candidates: tuple[float, ...] = ()) -> Synchronization:
    """A result without a lag that names the reason."""
    return Synchronization(np.nan, np.nan, correlation, status, np.nan, candidates=candidates)


def _check_search(search: LagSearch) -> None:
    """Refuses a search that has no meaning."""
    search_s, start_lag_s, start_std_s = search.search_s, search.start_lag_s, search.start_std_s
    if not (np.isfinite([search_s, start_lag_s]).all() and search_s > 0 and (start_std_s is None or start_std_s > 0)):
        raise DatasetError(
            f"search: expected positive seconds around a start, got {search_s=}, {start_lag_s=}, {start_std_s=}"
        )


def _check_options(groups: Sequence[Group], channels_a: int, channels_b: int, positive_gain: bool) -> None:
    """Refuses groups that have no meaning."""
    for group_a, group_b in groups:
        numbers = {*range(channels_a)}, {*range(channels_b)}
        if not group_a or not group_b or not {*group_a} <= numbers[0] or not {*group_b} <= numbers[1]:
            raise DatasetError(
                f"groups: expected channels below {channels_a} and {channels_b}, got {group_a} and {group_b}"
            )
        if positive_gain and len(group_a) != len(group_b):
            raise DatasetError(
                f"positive_gain: expected as many channels on both sides, got {group_a} and {group_b}; split them"
            )
