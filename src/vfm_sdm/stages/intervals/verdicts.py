"""Audits of intervals as one of the whole recording: ten bad minutes do not condemn a day, and are named."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.stages.audit import Audit, AuditCheck
from vfm_sdm.stages.audit.model import NOISE_TRUST, AuditedInterval, Limits, judge
from vfm_sdm.stages.intervals.division import Interval

__all__ = ["is_quiet", "is_refused", "join_audits"]

_MOST = 0.5
"""Share of the intervals that must fail for the whole to fail."""
_DRIFT_CAUTION, _DRIFT_FAIL = 0.1, 0.5
"""Limits of the slow motion of what must not move, as shares of the structure's motion [1]."""
_ORDER = (Outcome.FAIL, Outcome.CAUTION, Outcome.NOT_POSSIBLE, Outcome.PASS)


def is_quiet(audit: Audit) -> bool:
    """Whether nothing moved in an interval more than noise does: its checks against the motion then say nothing.

    Parameters
    ----------
    audit
        Audit of the interval.
    """
    return any(check.name == "signal to noise" and check.outcome == Outcome.FAIL for check in audit.checks)


def is_refused(audit: Audit) -> bool:
    """Whether the samples of an interval are not to be used.

    Parameters
    ----------
    audit
        Audit of the interval.
    """
    return audit.verdict == Verdict.REFUSED and not is_quiet(audit)


def join_audits(audits: Sequence[tuple[Interval, Audit]], displacement: xr.Dataset, static: Sequence[str]) -> Audit:
    """The audit of the whole, of those of its intervals.

    Parameters
    ----------
    audits
        Intervals and their audits, in the order of time.
    displacement
        The whole displacement, shape (T, P, 3) [mm], of `JoinedDisplacement`.
    static
        Names of the points that must not move.

    Notes
    -----
    A check fails where it does in half of the intervals or more; where it does in fewer, those are not to be used, and
    it is a caution. Intervals in which nothing moved do not count, unless nothing ever does. What is too slow for an
    interval shows between them: points that must not move and drift.
    """
    counted = [(interval, one) for interval, one in audits if not is_quiet(one)] or list(audits)
    names = list(dict.fromkeys(check.name for _, one in counted for check in one.checks))
    checks = (*(_join_checks(name, counted) for name in names), _check_slow_drift(displacement, static))
    first = counted[0][1]
    intervals = tuple(
        AuditedInterval(interval.begin_s, interval.end_s, _state_verdict(one), _state_reasons(one))
        for interval, one in audits
    )
    return replace(first, checks=checks, intervals=intervals)


def _check_slow_drift(displacement: xr.Dataset, static: Sequence[str]) -> AuditCheck:
    """Range of the means of points that must not move, beyond noise, as a share of the structure's motion [1]."""
    name = "slow drift"
    points = [str(point) for point in displacement["point"].values]
    known = [point for point in static if point in points]
    if not known:
        sentence = "no point that must not move was named: whether cameras or structure drift, nobody can tell"
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _DRIFT_CAUTION, "1", sentence)
    mean, rms, std = (displacement[f"interval_{one}"].isel(axis=slice(2)) for one in ("mean", "rms", "std"))
    structure = float(rms.sel(point=[point for point in points if point not in known]).max())
    found = {}
    for point in known:
        drift = mean.sel(point=point).max("interval") - mean.sel(point=point).min("interval")
        beyond = np.maximum(drift - 2 * NOISE_TRUST * std.sel(point=point).median("interval"), 0.0)
        found[point] = float(beyond.max()) / structure if structure > 0 else float("nan")
    return judge(
        name,
        found,
        Limits(_DRIFT_CAUTION, _DRIFT_FAIL, "1"),
        good="what must not move stays where it is over all intervals",
        bad="point '{}' must not move and drifts from interval to interval: slow motion of the others is as doubtful",
    )


def _state_verdict(audit: Audit) -> Verdict:
    return Verdict.NOT_JUDGED if is_quiet(audit) else audit.verdict


def _state_reasons(audit: Audit) -> str:
    if is_quiet(audit):
        return "nothing moved"
    return "; ".join(f"{check.name}: {check.sentence}" for check in audit.flagged)


def _join_checks(name: str, audits: Sequence[tuple[Interval, Audit]]) -> AuditCheck:
    """One check of all intervals: that of the worst, with the outcome for all of them."""
    found = [(interval, check) for interval, one in audits for check in one.checks if check.name == name]
    worst_at, worst = min(found, key=lambda pair: (_ORDER.index(pair[1].outcome), -_share(pair[1])))
    alike = sum(check.outcome == worst.outcome for _, check in found)
    if worst.outcome == Outcome.NOT_POSSIBLE and alike < len(found):
        # What could be checked some of the time was checked.
        worst = next(check for _, check in found if check.outcome == Outcome.PASS)
        return worst
    if worst.outcome in {Outcome.PASS, Outcome.NOT_POSSIBLE} or alike == len(found):
        return worst
    outcome = worst.outcome
    if outcome == Outcome.FAIL and alike < _MOST * len(found):
        outcome = Outcome.CAUTION
    when = f"in {alike} of {len(found)} intervals, worst from {worst_at.begin_s:.0f} to {worst_at.end_s:.0f} s"
    return replace(worst, outcome=outcome, sentence=f"{worst.sentence} ({when})")


def _share(check: AuditCheck) -> float:
    share = check.share_of_limit
    return share if np.isfinite(share) else 0.0
