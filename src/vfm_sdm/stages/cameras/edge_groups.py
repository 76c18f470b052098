"""Which edges run along which axis of the structure, as most of them agree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.cameras.edge_errors import edge_errors
from vfm_sdm.stages.matching.straight_edges import StraightEdges

__all__ = ["AxisEdges", "angles_to", "group_edges"]

_NEAR = np.radians(6.0)
"""Angle within which an edge is looked at for an axis: cameras and axes as they are known before."""
_TOLERANCE = np.radians(1.5)
"""Angle to the direction in which most edges run within which one belongs to it: members are seen out of line by half a
degree, and focal lengths that are off by a few per cent make views disagree by as much."""
_APART = 2.0
"""Tolerances by which an edge has to be away from all other axes."""
_STANDS_OUT = 3.0
"""Standard deviations of a Poisson number by which edges along an axis are more than chance brings there."""
_NARROWEST = np.radians(0.5)
_PRIOR = np.radians(5.0)
"""Standard deviation of the direction in which most edges run, from the axis as it is known before [rad]."""
_AWAY = 3.0
"""Least distance of the vanishing point, over half the edge's length."""
_CELLS, _EDGES_PER_CELL = 6, 4
_LEAST_CELLS = 4
"""Cells over all views in which an axis has edges at least: two determine a vanishing point."""
_LONGEST_PX = 200.0
"""Length up to which longer edges count more: members are no straighter."""


@dataclass(frozen=True, eq=False)
class AxisEdges:
    """Edges of one view that run along axes of the structure.

    Parameters
    ----------
    edges
        N edges.
    axis
        Index of the axis of each (lateral, vertical, longitudinal), shape (N,).
    cell
        Number of its cell, one for each part of the image and axis, shape (N,).
    weight
        One over the square root of the number of edges in the cell of each, shape (N,) [1].
    rows, total
        Place of each among all edges of the view, shape (N,), and their number.
    """

    edges: StraightEdges
    axis: IntArray
    cell: IntArray
    weight: FloatArray
    rows: IntArray
    total: int


def group_edges(edges: Sequence[StraightEdges], rig: Rig, axes: FloatArray | None) -> list[AxisEdges]:
    """Edges along the structure's axes; those of other directions, and of two alike, are left out.

    Parameters
    ----------
    edges
        Edges of each view.
    rig
        Cameras as they are known before.
    axes
        Lateral, vertical and longitudinal axis in the frame of the rig, as they are known before, shape (3, 3) [1];
        ``None`` where nothing is known, and then no edge is chosen.

    Returns
    -------
    groups
        One for each item of ``edges``; an axis with too few edges has none, nor has one whose edges in that view are no
        more than those beside it lead to expect.

    Notes
    -----
    Around each axis the direction in which most edges of a view run is found by iteratively reweighted least squares
    with the Geman-McClure loss, whose width shrinks: edges of any other direction have no influence in the end [1]_.
    Views are looked at one by one, for their relative pose may be known to some degrees only, and edges that agree with
    it would be the ones to stay.

    References
    ----------
    .. [1] Black, M. J., Rangarajan, A. (1996). On the unification of line processes, outlier rejection, and robust
       statistics. International Journal of Computer Vision 19(1), 57-91.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> rig = Rig(("a",), (Camera([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]], (640, 480)),))
    >>> posts = np.array([[[u, 100.0], [u, 200.0], [u, 300.0]] for u in (50.0, 150.0, 250.0, 350.0, 450.0)])
    >>> [group] = group_edges([StraightEdges(0, posts, np.full(5, 0.1), np.full(5, 0.1))], rig, np.eye(3))
    >>> group.axis.tolist()
    [1, 1, 1, 1, 1]
    """
    if axes is None:
        none = [np.full(len(one), -1) for one in edges]
        return [_thin(one, axis, axis) for one, axis in zip(edges, none, strict=True)]
    chosen = [_choose(one, rig, np.stack([_find_direction(one, rig, axis) for axis in axes])) for one in edges]
    cells = [_cells(one, rig, axis) for one, axis in zip(edges, chosen, strict=True)]
    for axis in range(len(axes)):
        seen = sum(len(np.unique(cell[own == axis])) for cell, own in zip(cells, chosen, strict=True))
        if seen < _LEAST_CELLS:
            chosen = [np.where(own == axis, -1, own) for own in chosen]
    return [_thin(one, axis, cell) for one, axis, cell in zip(edges, chosen, cells, strict=True)]


def angles_to(one: StraightEdges, rig: Rig, direction: FloatArray) -> FloatArray:
    """Angle in the picture between each edge and the way to its vanishing point, shape (N,) [rad].

    Parameters
    ----------
    one
        Edges of a view.
    rig
        Cameras.
    direction
        Direction in the frame of the rig, shape (3,) [1].

    Returns
    -------
    angles
        Infinite where the vanishing point is on the edge or near it, or a pixel has no ray.
    """
    slope, _, away, _ = edge_errors(one.places, rig.cameras[one.view], direction)
    angle = np.arcsin(np.clip(slope / (one.length_px / 2), -1, 1))
    return np.where(np.isfinite(angle) & (away > _AWAY), angle, np.inf)


def _find_direction(one: StraightEdges, rig: Rig, axis: FloatArray) -> FloatArray:
    """Direction near an axis in which most edges of a view run, shape (3,) [1]."""
    near = one.chosen(np.abs(angles_to(one, rig, axis)) < _NEAR)
    length = np.minimum(near.length_px, _LONGEST_PX) / _LONGEST_PX
    tangents = np.linalg.svd(axis[None])[2][1:]
    away, width = np.zeros(2), _NEAR

    def angles(off: FloatArray) -> FloatArray:
        found = angles_to(near, rig, axis + off @ tangents)
        return np.where(np.isfinite(found), found, _NEAR)

    for _ in range(12):
        now = angles(away)
        slopes = np.stack([(angles(away + step) - now) / 1e-5 for step in 1e-5 * np.eye(2)], axis=1)
        weight = length / (1 + (now / width) ** 2) ** 2
        normal = slopes.T @ (weight[:, None] * slopes) + np.eye(2) * (width / _PRIOR) ** 2
        away = away - np.linalg.solve(normal, slopes.T @ (weight * now) + away * (width / _PRIOR) ** 2)
        width = max(0.7 * width, _NARROWEST)
    return np.asarray(axis + away @ tangents)


def _choose(one: StraightEdges, rig: Rig, directions: FloatArray) -> IntArray:
    """Axis of each edge, shape (N,); -1 of none."""
    angles = np.abs(np.stack([angles_to(one, rig, direction) for direction in directions], axis=1))
    slopes = np.stack([_raw_angle(one, rig, direction) for direction in directions], axis=1)
    best = angles.argmin(axis=1)
    rows = np.arange(len(one))
    slopes[rows, best] = np.inf
    clear = (angles[rows, best] < _TOLERANCE) & (slopes.min(axis=1) > _APART * _TOLERANCE)
    chosen = np.where(clear, best, -1)
    for axis in range(len(directions)):
        # What runs beside the axis, and along no other: as many edges of any direction lie within the tolerance, too.
        beside = (angles[:, axis] >= _TOLERANCE) & (angles[:, axis] < _NEAR) & (angles.min(axis=1) >= _TOLERANCE)
        by_chance = float(beside.sum()) * _TOLERANCE / (_NEAR - _TOLERANCE)
        if (chosen == axis).sum() <= by_chance + _STANDS_OUT * np.sqrt(by_chance):
            chosen[chosen == axis] = -1
    return chosen


def _raw_angle(one: StraightEdges, rig: Rig, direction: FloatArray) -> FloatArray:
    """As `angles_to` without its sign, and also of edges near the vanishing point."""
    found = edge_errors(one.places, rig.cameras[one.view], direction)
    angle = np.abs(np.arcsin(np.clip(found.slope_px / (one.length_px / 2), -1, 1)))
    return np.where(np.isfinite(angle), angle, 0.0)


def _cells(one: StraightEdges, rig: Rig, axis: IntArray) -> IntArray:
    """Cell of each edge, shape (N,)."""
    size = np.array(rig.cameras[one.view].image_size)
    place = np.clip(one.places[:, 1] * _CELLS // size, 0, _CELLS - 1).astype(int)
    return np.asarray((axis * _CELLS + place[:, 1]) * _CELLS + place[:, 0])


def _thin(one: StraightEdges, axis: IntArray, cell: IntArray) -> AxisEdges:
    """The longest edges of each cell."""
    kept, weights = [np.empty(0, dtype=int)], [np.empty(0)]
    for index in np.unique(cell[axis >= 0]):
        members = np.flatnonzero((cell == index) & (axis >= 0))
        members = members[np.argsort(-one.length_px[members], kind="stable")][:_EDGES_PER_CELL]
        kept.append(members)
        weights.append(np.full(members.size, members.size**-0.5))
    rows = np.concatenate(kept)
    return AxisEdges(one.chosen(rows), axis[rows], cell[rows], np.concatenate(weights), rows, len(one))
