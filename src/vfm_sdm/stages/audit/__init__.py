"""Audit of a measurement without a reference: checks along the way, and whether the result is fit to use."""

from math import nan

from vfm_sdm.core.registry import find, part_names
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.stages.audit.model import Audit, AuditCheck, AuditInputs

__all__ = ["Audit", "AuditCheck", "AuditInputs", "audit"]


def audit(inputs: AuditInputs) -> Audit:
    """All checks of a measurement with two views or more.

    Parameters
    ----------
    inputs
        The measurement, as its stages left it.

    Notes
    -----
    Nothing here compares with a reference, so what moves all cameras, points and lengths alike stays unseen: above all
    a wrong baseline where no other length was measured, which the check of the scale says.
    """
    found = (_look(name, inputs) for name in part_names("checks"))
    return Audit(tuple(check for check in found if check is not None))


def _look(name: str, inputs: AuditInputs) -> AuditCheck | None:
    """What a check says; ``None`` where it does not apply. Another package's that fails is a check not possible."""
    try:
        part = find("checks", name)
    except BackendUnavailableError as error:
        return _not_possible(name, str(error))
    if not part.distribution:
        check: AuditCheck | None = part.load()(inputs)
        return check
    # It takes part in every audit of everybody who has the package, so its faults must not cost them the result.
    try:
        answer = part.load()(inputs)
    except Exception as error:  # noqa: BLE001
        return _not_possible(name, f"the check of {part.distribution} failed: {type(error).__name__}: {error}")
    if answer is not None and not isinstance(answer, AuditCheck):
        return _not_possible(name, f"expected the check of {part.distribution} to be an AuditCheck, got {answer!r:.60}")
    return answer


def _not_possible(name: str, sentence: str) -> AuditCheck:
    return AuditCheck(name, Outcome.NOT_POSSIBLE, nan, nan, "1", " ".join(sentence.split()))
