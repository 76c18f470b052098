"""Check of the scale: how well it is known, and which further reading on site would tell it best."""

from vfm_sdm.core.statuses import Outcome
from vfm_sdm.stages.audit.lenses import find_unseen_lens_error
from vfm_sdm.stages.audit.model import AuditCheck, AuditInputs
from vfm_sdm.stages.audit.scale_budget import ScaleBudget, list_slopes, say_percent

__all__ = ["check_scale"]

_NAME = "scale"
_UNUSABLE = 0.5
"""Expanded relative uncertainty of the scale beyond which displacement is not even known by its size [1]."""
_WORTH_SAYING = 0.8
"""Share of today's uncertainty that a reading must leave at most to be worth a visit [1]."""


def check_scale(inputs: AuditInputs) -> AuditCheck:
    """Expanded relative uncertainty of the scale (k = 2), of the worst point and axis [1].

    Notes
    -----
    Above the session's limit a result is never fit to use. The reading that would help most is the one that leaves the
    least of that uncertainty: see `vfm_sdm.stages.audit.scale_budget.weigh_scale`.
    """
    limit, budget = inputs.session.method.scale_limit, inputs.scale
    if budget is None:
        sentence = "nobody knows how well the scale is known: the cameras come without their uncertainty"
        return AuditCheck(_NAME, Outcome.NOT_POSSIBLE, float("nan"), limit, "1", sentence)
    value, where = budget.expanded, f"{budget.axis} of {budget.point}"
    slopes = list_slopes(inputs, budget.point).values()
    unseen = max((find_unseen_lens_error(inputs.cameras, one) for one in slopes), default=0.0)
    if value <= limit < unseen:
        sentence = (
            f"known to {say_percent(value)} (k = 2) if the lenses are as stated; it rests on them, and nothing would "
            f"show a lens so wrong that the scale is off by {say_percent(unseen)}. {_advise_check(budget)} checks them"
        )
        return AuditCheck(_NAME, Outcome.CAUTION, value, limit, "1", sentence, where)
    if value <= limit:
        return AuditCheck(_NAME, Outcome.PASS, value, limit, "1", f"known to {say_percent(value)} (k = 2)", where)
    advice = "no single length, range or lens would tell it much better; measure several"
    if budget.readings and budget.readings[0].left < _WORTH_SAYING * value:
        best = budget.readings[0]
        advice = f"{best.sentence} brings {say_percent(value)} to {say_percent(best.left)}"
    outcome = Outcome.FAIL if value > _UNUSABLE else Outcome.CAUTION
    sentence = f"known to {say_percent(value)} only (k = 2), most of it common to all points and samples; {advice}"
    return AuditCheck(_NAME, outcome, value, limit, "1", sentence, where)


def _advise_check(budget: ScaleBudget) -> str:
    """The reading that would tell most of what the lenses tell now."""
    of_sites = [one.sentence for one in budget.readings if "lens" not in one.sentence]
    best = next(iter(of_sites), "a calibration of the lenses")
    return best[:1].upper() + best[1:]
