"""Matches grouped by cells of the image, so that every cell counts as one observation."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.stages.cameras.shared_points import SharedPoints
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["CellMatches", "CellPoints", "cell_medians", "group_matches", "group_points", "list_epipolar_errors"]

_CELLS = 6
"""Number of cells along a side of the grid over an image; matches of one cell count as one observation."""
_MATCHES_PER_CELL = 12


@dataclass(frozen=True, eq=False)
class CellMatches:
    """Matches of two views with their cells.

    Parameters
    ----------
    matches
        N matches, at most twelve in a cell.
    weight
        Weight of each match, shape (N,) [1]: one over the square root of the number of matches in its cell.
    cell
        Number of the cell of the first image in which each match lies, shape (N,).
    """

    matches: Matches
    weight: FloatArray
    cell: IntArray


@dataclass(frozen=True, eq=False)
class CellPoints:
    """Points of three views or more with their cells.

    Parameters
    ----------
    points
        N points, at most twelve in a cell.
    weight
        Weight of each point, shape (N,) [1]: one over the square root of the number of points in its cell.
    cell
        Number of the cell of the first view's image in which each point lies, shape (N,).
    """

    points: SharedPoints
    weight: FloatArray
    cell: IntArray


def group_matches(matches: Matches, image_size: tuple[int, int]) -> CellMatches:
    """Thinned matches in which every cell of the first image counts as one observation.

    Parameters
    ----------
    matches
        Matches of two views; at least one.
    image_size
        Width and height of the first view's image [px].

    Returns
    -------
    grouped
        Matches that are kept, with their weights and cells.

    Examples
    --------
    >>> pixels = np.array([[10.0, 10.0], [20.0, 10.0], [600.0, 400.0]])
    >>> grouped = group_matches(Matches(0, 1, pixels, pixels), (640, 480))
    >>> grouped.cell.tolist(), grouped.weight.round(3).tolist()
    ([0, 0, 35], [0.707, 0.707, 1.0])
    """
    chosen, weight, cell = _thin_by_cell(matches.points_first, image_size)
    return CellMatches(matches.chosen(chosen), weight, cell)


def group_points(points: SharedPoints, image_size: tuple[int, int]) -> CellPoints:
    """Thinned points of several views in which every cell of the first image counts as one observation.

    Parameters
    ----------
    points
        Points of three views or more; at least one.
    image_size
        Width and height of the first of these views' image [px].

    Returns
    -------
    grouped
        Points that are kept, with their weights and cells.

    Examples
    --------
    >>> pixels = np.array([[10.0, 10.0], [20.0, 10.0], [600.0, 400.0]])
    >>> group_points(SharedPoints((0, 1, 2), np.stack([pixels] * 3)), (640, 480)).cell.tolist()
    [0, 0, 35]
    """
    chosen, weight, cell = _thin_by_cell(points.pixels[0], image_size)
    return CellPoints(points.thinned(chosen), weight, cell)


def _thin_by_cell(pixels: FloatArray, image_size: tuple[int, int]) -> tuple[IntArray, FloatArray, IntArray]:
    """Indices of chosen pixels (N, 2), the weight of each and its cell, shape (chosen,) each."""
    column = np.clip(pixels[:, 0] * _CELLS // image_size[0], 0, _CELLS - 1)
    row = np.clip(pixels[:, 1] * _CELLS // image_size[1], 0, _CELLS - 1)
    cell = (row * _CELLS + column).astype(int)
    kept, weights = [], []
    for index in np.unique(cell):
        members = np.flatnonzero(cell == index)
        members = members[:: max(1, -(-members.size // _MATCHES_PER_CELL))]
        kept.append(members)
        weights.append(np.full(members.size, 1 / np.sqrt(members.size)))
    chosen = np.concatenate(kept)
    return chosen, np.concatenate(weights), cell[chosen]


def list_epipolar_errors(groups: Sequence[CellMatches], rig: Rig) -> Iterator[tuple[CellMatches, FloatArray]]:
    """Groups of matches with the Sampson error of each match, shape (N,) [px].

    Parameters
    ----------
    groups
        Matches of pairs of views.
    rig
        Cameras of these views.
    """
    for group in groups:
        m = group.matches
        yield group, sampson_error(m.points_first, m.points_second, rig, first=m.first, second=m.second)


def cell_medians(errors: FloatArray, cell: IntArray) -> FloatArray:
    """Median of the errors of each cell, shape (cells, ...).

    Parameters
    ----------
    errors
        Errors of N matches, shape (N, ...), in any unit.
    cell
        Cell of each match, shape (N,).
    """
    return np.array([np.nanmedian(errors[cell == one], axis=0) for one in np.unique(cell)])
