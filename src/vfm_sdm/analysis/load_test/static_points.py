"""Points that must not move, in a load test or under passages: left out of what is shown, and looked at for motion."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.stats import norm, t

from vfm_sdm.analysis.load_test.levels import LEVEL_FREEDOM
from vfm_sdm.core.arrays import FloatArray

__all__ = ["MovedPoint", "drop_static", "find_moved_static"]

_CHANCE = 0.05
"""Probability with which noise alone makes any of all points that must not move seem to."""


@dataclass(frozen=True)
class MovedPoint:
    """A point that must not move, and did.

    Parameters
    ----------
    point, axis
        Its name, and the axis along which it moved most beyond its uncertainty.
    number
        Step or passage in which it did, counted from 1.
    value_mm, expanded_mm
        By how much, with its expanded uncertainty (95 %) [mm].
    """

    point: str
    axis: str
    number: int
    value_mm: float
    expanded_mm: float


def drop_static(result: xr.Dataset, static: Collection[str]) -> xr.Dataset:
    """The result of the points that may move.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test` or `vfm_sdm.analysis.load_test.judge_passages`.
    static
        Names of the points that must not move.

    Examples
    --------
    >>> drop_static(xr.Dataset(coords={"point": ["mid", "pier"]}), {"pier"})["point"].values.tolist()
    ['mid']
    """
    return result.isel(point=[i for i, name in enumerate(result["point"].values) if str(name) not in static])


def find_moved_static(result: xr.Dataset, static: Collection[str]) -> tuple[MovedPoint, ...]:
    """Points that must not move and did, beyond what noise explains, those that moved most beyond it first.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test` or `vfm_sdm.analysis.load_test.judge_passages`.
    static
        Names of the points that must not move.

    Notes
    -----
    Levels of steps, or the largest static displacement in a passage, over their standard uncertainty. As the largest of
    all points, axes, and steps or passages is looked at, the limit is that which noise exceeds in any of them with a
    probability of 5 % (Bonferroni): of levels by Student's t, whose scatter is known with twelve degrees of freedom; in
    a passage as the largest of as many values as the static part has there, two in a period of the cutoff.
    All axes count, whichever is shown: a camera that turns moves points along others, too.

    Examples
    --------
    Steps of a pier that settles: `tests/unit/analysis/load_test/test_static_points.py`.
    """
    dim = "step" if "deflection" in result else "passage"
    still = result.isel(point=[i for i, name in enumerate(result["point"].values) if str(name) in static])
    value, std, expanded = (one.transpose("point", "axis", dim).values for one in _levels(still))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(np.abs(value) / std, nan=0.0, posinf=0.0)
    tail = 1 - _CHANCE / 2 / max(float(_count_values(still)[ratio > 0].sum()), 1.0)
    limit = t.ppf(tail, LEVEL_FREEDOM) if dim == "step" else norm.ppf(tail)
    moved = []
    for p, of_point in enumerate(ratio):
        a, n = np.unravel_index(int(of_point.argmax()), of_point.shape)
        if of_point[a, n] > limit:
            names = str(still["point"].values[p]), str(still["axis"].values[a])
            one = MovedPoint(*names, int(n) + 1, float(value[p, a, n]), float(expanded[p, a, n]))
            moved.append((float(of_point[a, n]), one))
    return tuple(one for _, one in sorted(moved, key=lambda pair: -pair[0]))


def _count_values(result: xr.Dataset) -> FloatArray:
    """Values that do not depend on each other, of which a level is the largest, shape (P, A, N)."""
    if "deflection" in result:
        return np.ones([result.sizes[dim] for dim in ("point", "axis", "step")])
    duration = result["end_s"] - result["begin_s"]
    values = (2 * result["cutoff"] * duration).transpose("point", "axis", "passage").values
    return np.asarray(np.maximum(np.nan_to_num(values), 1.0))


def _levels(result: xr.Dataset) -> tuple[xr.DataArray, xr.DataArray, xr.DataArray]:
    """Levels with their standard and expanded uncertainty [mm]."""
    if "deflection" in result:
        return result["deflection"], result["combined_std"], result["expanded_uncertainty"]
    return result["largest_static"], result["static_uncertainty"] / 2, result["static_uncertainty"]
