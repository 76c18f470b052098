"""Audit of a measurement without a reference: checks along the way, and whether the result is fit to use."""

from math import nan

from vfm_sdm.core.registry import find, part_names
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.stages.audit.model import BETWEEN_VIEWS, Audit, AuditCheck, AuditedInterval, AuditInputs

__all__ = ["Audit", "AuditCheck", "AuditInputs", "AuditedInterval", "audit"]


def audit(inputs: AuditInputs) -> Audit:
    """All checks of a measurement, as far as its views allow.

    Parameters
    ----------
    inputs
        Products of the measurement.

    Notes
    -----
    No check compares with a reference sensor, so an error of all cameras, points and lengths alike stays unseen: above
    all a wrong baseline where no other length was measured, of which the check of the scale warns.

    Of a single view, motion towards the camera, tracks that slip and a wrong distance from the known length stay
    unseen; checks that compare views say that they are not possible.
    """
    views = len(inputs.session.view)
    found = (_run_check(name, inputs, views) for name in part_names("checks"))
    checks = tuple(check for check in found if check is not None)
    return Audit(checks, views, inputs.scale if views > 1 else None)


def _run_check(name: str, inputs: AuditInputs, views: int) -> AuditCheck | None:
    """Result of a check; ``None`` where it does not apply. A failing check of another package is one not possible."""
    if views == 1 and name in BETWEEN_VIEWS:
        return _make_not_possible(BETWEEN_VIEWS[name], "it takes a second view to see it")
    try:
        part = find("checks", name)
    except BackendUnavailableError as error:
        return _make_not_possible(name, str(error))
    if not part.distribution:
        check: AuditCheck | None = part.load()(inputs)
        return check
    # It takes part in every audit of everybody who has the package, so its faults must not cost them the result.
    try:
        answer = part.load()(inputs)
    except Exception as error:  # noqa: BLE001
        return _make_not_possible(name, f"the check of {part.distribution} failed: {type(error).__name__}: {error}")
    if answer is not None and not isinstance(answer, AuditCheck):
        return _make_not_possible(
            name, f"expected the check of {part.distribution} to be an AuditCheck, got {answer!r:.60}"
        )
    return answer


def _make_not_possible(name: str, sentence: str) -> AuditCheck:
    return AuditCheck(name, Outcome.NOT_POSSIBLE, nan, nan, "1", " ".join(sentence.split()))
