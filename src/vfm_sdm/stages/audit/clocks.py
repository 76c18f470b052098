"""Checks of the views' clocks: the offset that is left after synchronisation, and its drift."""

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import ClockStatus, ClockUse, Outcome
from vfm_sdm.stages.audit.model import AuditCheck, AuditInputs, Limits, judge
from vfm_sdm.stages.synchronize import LagSearch, Synchronization, estimate_view_lag

__all__ = ["check_drift", "check_synchronization"]

_SEARCH_STD_S = 0.05
_SIGNIFICANT = 4.0
_LAG_CAUTION_S, _LAG_FAIL_S = 0.004, 0.02
"""Limits of the lag [s]: at 3 Hz, 4 ms move one view against the other by 8 % of the amplitude."""
_SHORTEST_HALF_S = 4.0


def check_synchronization(inputs: AuditInputs) -> AuditCheck:
    """Lag that is left between the views on their common clock [s]."""
    name = "clocks"
    unknown = [view for view in inputs.tracks if _is_unknown(inputs, view)]
    if unknown:
        bad = f"nobody knows when {unknown[0]!r} began: neither the motion nor the session tells its offset"
        return AuditCheck(name, Outcome.FAIL, float("nan"), _LAG_CAUTION_S, "s", bad, unknown[0])
    lags = _estimate_lags(inputs, inputs.aligned)
    left = {view: _exceed_noise(lag) for view, lag in lags.items() if lag.ok}
    if not left:
        return AuditCheck(
            name, Outcome.NOT_POSSIBLE, float("nan"), _LAG_CAUTION_S, "s", _explain_no_lag(*lags.values())
        )
    return judge(
        name,
        left,
        Limits(_LAG_CAUTION_S, _LAG_FAIL_S, "s"),
        good="the views are synchronised" + _name_others(inputs),
        bad="'{}' is not synchronised with the reference view; let the motion do it (method.synchronization)"
        + _name_others(inputs),
    )


def check_drift(inputs: AuditInputs) -> AuditCheck:
    """Change of the lag from the first to the second half of the recording [s]."""
    name, time_s = "clock drift", inputs.aligned["time"].values
    middle = (time_s[0] + time_s[-1]) / 2
    if time_s[-1] - middle < _SHORTEST_HALF_S:
        sentence = f"the recording is shorter than {2 * _SHORTEST_HALF_S:g} s: clocks hardly drift in that time"
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _LAG_CAUTION_S, "s", sentence)
    halves = [inputs.aligned.sel(time=part) for part in (slice(None, middle), slice(middle, None))]
    first, second = (_estimate_lags(inputs, half) for half in halves)
    found = {view: _exceed_noise(first[view], second[view]) for view in first if first[view].ok and second[view].ok}
    if not found:
        both = _explain_no_lag(*first.values(), *second.values())
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _LAG_CAUTION_S, "s", both)
    return judge(
        name,
        found,
        Limits(_LAG_CAUTION_S, _LAG_FAIL_S, "s"),
        good="the clocks keep step",
        bad="the clock of '{}' drifts against the reference view's; use a shorter part, or a constant frame rate",
    )


def _estimate_lags(inputs: AuditInputs, aligned: xr.Dataset) -> dict[str, Synchronization]:
    """Lag of every further view behind the reference view, near zero [s]."""
    if not inputs.moving:
        return {}
    reference, *others = (str(view) for view in aligned["view"].values)
    first = aligned.sel(view=reference, drop=True)
    return {
        view: estimate_view_lag(
            first,
            aligned.sel(view=view, drop=True),
            points=inputs.moving,
            search=LagSearch(4 * _SEARCH_STD_S, start_std_s=_SEARCH_STD_S),
        )
        for view in others
    }


def _explain_no_lag(*lags: Synchronization) -> str:
    """Sentence that says why the motion tells no lag."""
    return f"the motion does not tell: {next((lag.status for lag in lags if not lag.ok), ClockStatus.NO_MOTION)}"


def _name_others(inputs: AuditInputs) -> str:
    """Part of a sentence that names the points left out because they move otherwise."""
    uses = inputs.aligned.get("clock_use")
    if uses is None:
        return ""
    names = [str(p) for p in uses["point"].values if (uses.sel(point=p) == ClockUse.DISAGREES).any()]
    return f"; without {', '.join(map(repr, names))}, which moves otherwise than most: check its place" if names else ""


def _exceed_noise(lag: Synchronization, other: Synchronization | None = None) -> float:
    """Size of a lag, or of the difference of two lags, beyond what its uncertainty explains [s]."""
    value, std = lag.lag_s, lag.lag_std_s
    if other is not None:
        value, std = value - other.lag_s, float(np.hypot(std, other.lag_std_s))
    return max(abs(value) - _SIGNIFICANT * std, 0.0)


def _is_unknown(inputs: AuditInputs, view: str) -> bool:
    """Whether neither motion nor session tells a view's offset."""
    return bool(np.isnan(inputs.aligned["clock_offset_std"].sel(view=view).item()))
