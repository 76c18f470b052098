"""Audit of a measurement without a reference: checks along the way, and whether the result is fit to use."""

from vfm_sdm.stages.audit.clocks import check_drift, check_synchronization
from vfm_sdm.stages.audit.geometry import (
    check_agreement,
    check_baseline,
    check_epipolar_level,
    check_epipolar_motion,
    check_site,
)
from vfm_sdm.stages.audit.model import Audit, AuditCheck, AuditInputs, Outcome, Verdict
from vfm_sdm.stages.audit.signal import check_gain, check_recording, check_refinement, check_signal
from vfm_sdm.stages.audit.tracks import (
    check_camera_motion,
    check_frozen,
    check_halves,
    check_slip,
    check_stabilization,
    check_static_points,
    check_tracked,
)

__all__ = ["Audit", "AuditCheck", "AuditInputs", "Outcome", "Verdict", "audit"]

_CHECKS = (
    check_site,
    check_baseline,
    check_epipolar_level,
    check_epipolar_motion,
    check_agreement,
    check_synchronization,
    check_drift,
    check_tracked,
    check_frozen,
    check_slip,
    check_halves,
    check_static_points,
    check_camera_motion,
    check_stabilization,
    check_signal,
    check_gain,
    check_recording,
)


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
    refined = inputs.session.method.refinement != "none"
    return Audit(tuple(check(inputs) for check in (*_CHECKS, *([check_refinement] if refined else []))))
