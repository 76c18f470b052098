"""Audits of intervals as one of the whole recording: ten bad minutes do not condemn a day, and are named."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.stages.audit import Audit, AuditCheck
from vfm_sdm.stages.audit.model import NOISE_TRUST, AuditedInterval, Limits, judge
from vfm_sdm.stages.intervals.division import Interval

__all__ = ["join_audits"]

_QUIET = 0.1
"""Share of the liveliest interval's motion below which an interval's own is no measure for anything."""
_AGAINST_MOTION = frozenset(
    {
        *("signal to noise", "static points", "tripods", "stabilised video", "still interval", "halves of a subset"),
        *("epipolar error in motion", "slipping tracks", "frozen tracks", "clocks", "clock drift"),
        *("agreement of the views", "refinement"),
    }
)
"""Names of the checks that compare with the structure's motion."""
_MOST = 0.5
"""Share of the intervals that must fail for the whole to fail."""
_DRIFT_CAUTION, _DRIFT_FAIL = 0.1, 0.5
"""Limits of the slow motion of what must not move, as shares of the structure's motion [1]."""
_ORDER = (Outcome.FAIL, Outcome.CAUTION, Outcome.NOT_POSSIBLE, Outcome.PASS)


@dataclass(frozen=True)
class _Judged:
    """An interval with its audit, without the checks that say nothing where hardly anything moved."""

    interval: Interval
    audit: Audit
    quiet: bool

    @property
    def verdict(self) -> Verdict:
        if self.quiet and self.audit.verdict != Verdict.REFUSED:
            return Verdict.NOT_JUDGED
        return self.audit.verdict

    def state(self) -> AuditedInterval:
        reasons = "; ".join(f"{check.name}: {check.sentence}" for check in self.audit.flagged)
        if self.quiet:
            reasons = f"hardly any motion; {reasons}" if reasons else "hardly any motion"
        return AuditedInterval(self.interval.begin_s, self.interval.end_s, self.verdict, reasons)


def join_audits(
    audits: Sequence[tuple[Interval, Audit]], facts: xr.Dataset, moving: Sequence[str], static: Sequence[str]
) -> Audit:
    """The audit of the whole, of those of its intervals.

    Parameters
    ----------
    audits
        Intervals and their audits, in the order of time.
    facts
        What was measured in them, of `JoinedDisplacement.facts`.
    moving, static
        Names of the points on the structure, and of those that must not move.

    Notes
    -----
    A check fails where it does in half of the intervals or more; where it does in fewer, those are not to be used, and
    it is a caution. In an interval with less than a tenth of the motion of the liveliest, checks that compare with
    motion do not count: of a night without traffic, noise and a tripod that settles are a large share. What is too
    slow for an interval shows between them: points that must not move and drift.
    """
    motion = facts["interval_rms"].sel(point=list(moving)).max(["point", "axis"]).values
    liveliest = np.fmax.reduce(motion, initial=0.0)
    judged = []
    for (interval, one), rms in zip(audits, motion, strict=True):
        quiet = bool(rms < _QUIET * liveliest)
        kept = tuple(check for check in one.checks if not (quiet and check.name in _AGAINST_MOTION))
        judged.append(_Judged(interval, replace(one, checks=kept), quiet))
    names = list(dict.fromkeys(check.name for one in audits for check in one[1].checks))
    checks = (*(_join_checks(name, judged) for name in names), _check_slow_drift(facts, moving, static))
    return replace(audits[0][1], checks=checks, intervals=tuple(one.state() for one in judged))


def _check_slow_drift(facts: xr.Dataset, moving: Sequence[str], static: Sequence[str]) -> AuditCheck:
    """Range of the means of points that must not move, beyond noise, as a share of the structure's motion [1]."""
    name = "slow drift"
    known = [point for point in static if point in facts["point"].values]
    if not known:
        sentence = "no point that must not move was named: whether cameras or structure drift, nobody can tell"
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _DRIFT_CAUTION, "1", sentence)
    mean, rms, std = (facts[f"interval_{one}"].isel(axis=slice(2)) for one in ("mean", "rms", "std"))
    structure = float(rms.sel(point=list(moving)).max())
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


def _join_checks(name: str, judged: Sequence[_Judged]) -> AuditCheck:
    """One check of all intervals: that of the worst, with the outcome for all of them."""
    found = [(one.interval, check) for one in judged for check in one.audit.checks if check.name == name]
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
