"""Check of the still interval, whose mean is the origin of all displacement."""

import numpy as np

from vfm_sdm.core.arrays import BoolArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.audit.model import NOISE_TRUST, AuditCheck, AuditInputs, Limits, judge

__all__ = ["check_still_interval"]

_FEWEST = 3
_CLEAR = 3.0
"""Standard deviations of noise above which a point's motion over the recording is clear."""
_CAUTION, _FAIL = 0.1, 0.5


def check_still_interval(inputs: AuditInputs) -> AuditCheck | None:
    """Motion during the still interval, beyond noise and what static points show, as a share of all motion [1].

    ``None`` where the session names no still interval.

    Notes
    -----
    The mean of an interval in which the structure moves is off its position of rest by up to that motion, and with it
    every sample: the uncertainty of the origin holds noise alone.
    """
    interval = inputs.session.method.still_interval_s
    if interval is None:
        return None
    data = inputs.displacement
    time_s = data["time"].values
    still = (time_s >= interval[0]) & (time_s <= interval[1])
    axes = [str(a) for a in data["axis"].values if str(a) not in ("longitudinal", "forward")]
    found: dict[str, float] = {}
    for axis in axes:
        air = [x for p in inputs.static if np.isfinite(x := _excess(inputs, p, axis, still)[0])]
        least = max([0.0, *air])
        for point in inputs.moving:
            within, noise = _excess(inputs, point, axis, still)
            whole, _ = _excess(inputs, point, axis, np.ones(len(time_s), np.bool_))
            if whole > (_CLEAR * NOISE_TRUST) ** 2 * noise:
                found[f"{axis} of {point}"] = float(np.sqrt(max(within - least, 0.0) / whole))
    return judge(
        "still interval",
        found,
        Limits(_CAUTION, _FAIL, "1"),
        good="the structure rests during the still interval",
        bad="the structure moves during the still interval ({}): the origin of displacement is off by up to as much; "
        "name a time of rest (method.still_interval_s), or leave it out",
    )


def _excess(inputs: AuditInputs, point: str, axis: str, chosen: BoolArray) -> tuple[float, float]:
    """Variance of a displacement beyond its noise, and the variance of that noise [mm2]; NaN where too few are ok."""
    series = inputs.displacement.sel(point=point, axis=axis)
    values, std = series["displacement"].values, series["displacement_std"].values
    ok = chosen & (series["status"].values == Status.OK) & np.isfinite(values) & np.isfinite(std)
    if ok.sum() < _FEWEST:
        return float("nan"), float("nan")
    noise = float(np.mean(std[ok] ** 2))
    # The variance of few samples scatters: of n by a share of sqrt(2 / n).
    scatter = 1 + 3 * np.sqrt(2 / (ok.sum() - 1))
    return float(np.var(values[ok], ddof=1)) - NOISE_TRUST**2 * scatter * noise, noise
