"""What a named point should measure, in words, before anything is measured."""

from enum import StrEnum

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import PointStatus

__all__ = ["Worth", "describe_expectation"]

_WORTH_SAYING_SHARE = 0.95
_LEVEL_DEG = 15.0


class Worth(StrEnum):
    """What a point is worth in a view."""

    GOOD = "good"
    """Both directions are measured, by all of its subset."""
    PART = "part"
    """Both are, by the part of its subset that moves with it."""
    EDGE = "edge"
    """One is, across an edge."""
    UNKNOWN = "unknown"
    REFUSED = "refused"


def describe_expectation(subset: xr.Dataset) -> tuple[str, Worth]:
    """What a point should measure, with what to do where that is little.

    Parameters
    ----------
    subset
        The point's part of a dataset of `vfm_sdm.stages.tracking.subset_design.describe_subsets`, lengths in px.
    """
    std_px = subset["expected_std"].values
    if subset["status"].item() != PointStatus.OK:
        place = subset["nearest"].values
        advice = "name another place" + (f": ({place[0]:.0f}, {place[1]:.0f}) would do" if place[0] >= 0 else "")
        return f"refused: {subset['status'].item()}; {advice}", Worth.REFUSED
    if not np.isfinite(std_px[0]):
        return "not known: too few frames, or too near to the border", Worth.UNKNOWN
    share = subset["believed"].item()
    rest = f"; {share:.0%} of its square moves with it" if share < _WORTH_SAYING_SHARE else ""
    rest += "; light that moves over it is taken out" if subset["shading"].item() else ""
    if not np.isfinite(std_px[1]):
        u, v = subset["across"].values
        angle = np.degrees(np.arctan2(-v, u)) % 180
        words = "horizontally" if min(angle, 180 - angle) < _LEVEL_DEG else f"at {angle:.0f} degrees"
        words = "vertically" if abs(angle - 90) < _LEVEL_DEG else words
        return f"{std_px[0]:.3f} px {words}, across its edge; nothing along it{rest}", Worth.EDGE
    worth = Worth.GOOD if share >= _WORTH_SAYING_SHARE else Worth.PART
    return f"{std_px[0]:.3f} to {std_px[1]:.3f} px{rest}", worth
