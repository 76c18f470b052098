"""Check of renewed reference frames: what they add to the uncertainty of positions."""

import numpy as np

from vfm_sdm.core.covariances import edges_across, judged_std
from vfm_sdm.core.datasets import frames_of_points
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.stages.audit.model import AuditCheck, AuditInputs

__all__ = ["check_references"]

_CAUTION_PX = 0.1
"""Standard deviation above which single positions are not trusted, either [px]."""


def check_references(inputs: AuditInputs) -> AuditCheck | None:
    """Standard deviation that renewed reference frames add, of the worst point [px]; ``None`` where there are none."""
    added: dict[str, float] = {}
    renewed = 0
    for view, tracks in inputs.tracks.items():
        if "reference_covariance" in tracks:
            named = {0, *frames_of_points(inputs.cameras.points.sel(view=view)).tolist()}
            renewed += len(set(tracks["reference_frame"].values.tolist()) - named)
            std = np.nan_to_num(judged_std(tracks["reference_covariance"].values, edges_across(tracks))).max(axis=0)
            added |= {f"{name} in {view}": float(one) for name, one in zip(tracks["point"].values, std, strict=True)}
    if not renewed:
        return None
    worst = max(added, key=lambda where: added[where])
    sentence = (
        f"reference frames were renewed {renewed} times as light changed; that adds {added[worst]:.3f} px in {worst}"
    )
    outcome = Outcome.PASS
    if added[worst] > _CAUTION_PX:
        outcome = Outcome.CAUTION
        sentence += ": slow motion below that cannot be told from light; measure parts of the recording in even light"
    return AuditCheck("reference frames", outcome, added[worst], _CAUTION_PX, "px", sentence, worst)
