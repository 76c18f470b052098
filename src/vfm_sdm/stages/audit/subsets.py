"""Checks of what subsets cover: whether most of a square moves with its point, and its parts by one amount."""

import numpy as np

from vfm_sdm.core.covariances import find_edges
from vfm_sdm.stages.audit.model import AuditCheck, AuditInputs, Limits, judge

__all__ = ["check_believed", "check_parts"]

_BELIEVED_CAUTION, _BELIEVED_FAIL = 2 / 3, 0.97
"""Share of a square that is seen to move otherwise than its point, or is next to what does: of two thirds it is as
likely that the point is what stands out [1]."""
_PARTS_CAUTION, _PARTS_FAIL = 0.05, np.inf
"""Spread of the gains of a subset's parts [1]: half of it is 2.5 % of the motion, a limit of figures that are right."""


def check_believed(inputs: AuditInputs) -> AuditCheck:
    """Share of a point's square that is not believed to move with it, the largest [1]; edges by their own half."""
    found = {}
    for view, tracks in inputs.tracks.items():
        if "believed" not in tracks:
            continue
        edge = dict(zip(tracks["point"].values.tolist(), find_edges(tracks), strict=True))
        for point in inputs.moving:
            share = float(np.nanmean(tracks["believed"].sel(point=point).values))
            if share > 0:
                # Beyond an edge there is something else in any case.
                found[f"{point} in {view}"] = 1 - min(2 * share, 1) if edge[point] else 1 - share
    return judge(
        "share of a subset",
        found,
        Limits(_BELIEVED_CAUTION, _BELIEVED_FAIL, "1"),
        good="most of every subset moves with its point",
        bad="most of the square around {} moves otherwise: what was followed may be a cable, a shadow or what lies "
        "behind. Look at the figure of its subset, or name a place with more of the structure around it",
    )


def check_parts(inputs: AuditInputs) -> AuditCheck:
    """Spread of the gains of a subset's parts, in rows and columns, the largest [1]."""
    found = {}
    for view, tracks in inputs.tracks.items():
        if "part_gain_std" not in tracks:
            continue
        for point in inputs.moving:
            spread = tracks["part_gain_std"].sel(point=point).values
            if np.isfinite(spread).any():
                found[f"{point} in {view}"] = float(np.nanmax(spread))
    return judge(
        "parts of a subset",
        found,
        Limits(_PARTS_CAUTION, _PARTS_FAIL, "1"),
        good="all parts of every subset move by one amount",
        bad="parts of the subset of {} move by different amounts, as where a still band crosses it: a cable, a hand "
        "rail, background. Name a place that moves as a whole",
    )
