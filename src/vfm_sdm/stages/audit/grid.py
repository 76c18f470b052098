"""Check of the points of grids: each is judged by itself, and what counts is how many of them are left."""

import numpy as np

from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.stages.audit.model import AuditCheck, AuditInputs

__all__ = ["check_grid"]

_MISSING = 0.1
"""Share of its samples that a point may lack [1]."""
_CAUTION, _FAIL = 0.5, 0.9
"""Share of the points of all grids that may be missing [1]: places that one view does not see are part of any grid."""
_NAMED = 5


def check_grid(inputs: AuditInputs) -> AuditCheck | None:
    """Share of the points of grids that are not measured [1]; nothing where there is no grid."""
    if inputs.grid is None:
        return None
    names, status = inputs.grid["point"].values.tolist(), inputs.grid.transpose("time", "point").values
    missing = np.asarray((status != Status.OK).mean(axis=0) > _MISSING)
    share = float(missing.mean())
    lost = [name for name, gone in zip(names, missing, strict=True) if gone]
    outcome = Outcome.FAIL if share >= _FAIL else Outcome.CAUTION if share >= _CAUTION else Outcome.PASS
    sentence = f"{len(names) - len(lost)} of {len(names)} points of the grid are measured"
    if lost:
        named = ", ".join(lost[:_NAMED]) + ", ..." * (len(lost) > _NAMED)
        sentence += f"; left out: {named}"
    if outcome != Outcome.PASS:
        sentence += "; draw the polygon where both views see the face, and where it has texture"
    return AuditCheck("points of the grid", outcome, share, _CAUTION, "1", sentence)
