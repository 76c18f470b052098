"""Matches grouped by cells of the image, so that every cell counts as one observation."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, FloatArray, IntArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.stages.cameras.shared_points import SharedPoints
from vfm_sdm.stages.cameras.whitening import ROBUST_STD
from vfm_sdm.stages.matching.matches import Matches

__all__ = [
    "CellMatches",
    "CellPoints",
    "MatchNoise",
    "estimate_match_noise",
    "group_matches",
    "group_points",
    "list_epipolar_errors",
]

_CELLS = 6
"""Number of cells along a side of the grid over an image; matches of one cell count as one observation."""
_MATCHES_PER_CELL = 12
_POSE_PARAMETERS = 7
"""Largest number of parameters of the epipolar geometry of two views."""
_LEAST_STD_PX = 0.25
"""Least standard deviation of the error that the matches of a cell share [px]: that of the camera model, which is
alike for neighbours."""
_LEAST_DIFFERENCES = 10


@dataclass(frozen=True)
class MatchNoise:
    """Standard deviations of the errors of matches.

    Parameters
    ----------
    shared_px
        Of the error that the matches of a cell share: that of the camera model [px].
    own_px
        Of each match's own error: that of its features [px].

    Examples
    --------
    A cell of one match tells less than one of twelve, but not by twelve times.

    >>> noise = MatchNoise(shared_px=0.3, own_px=0.4)
    >>> [round(float(noise.spread(np.array(n**-0.5))[1]) * n**0.5, 2) for n in (1, 12)]
    [1.0, 1.56]
    """

    shared_px: float = _LEAST_STD_PX
    own_px: float = 0.0

    def spread(self, weight: FloatArray, stated_px: float = 0.0) -> tuple[float, FloatArray]:
        """Standard deviation of one match, and the factor of its residual with which its cell has unit variance.

        Parameters
        ----------
        weight
            One over the square root of the number of matches in the cell of each, shape (N,) [1].
        stated_px
            Standard deviation that the matches state of themselves [px].

        Returns
        -------
        std_px, factor
            Scalar [px], and shape (N,) [1].
        """
        shared = float(np.hypot(self.shared_px, stated_px))
        single = float(np.hypot(shared, self.own_px))
        return single, np.asarray(weight * single / np.hypot(shared, self.own_px * weight))


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


def estimate_match_noise(pairs: Sequence[CellMatches], shared: Sequence[CellPoints], rig: Rig) -> MatchNoise:
    """Standard deviations of the errors of matches, from the residuals of adjusted cameras.

    Parameters
    ----------
    pairs, shared
        Matches of pairs of views, and points that several views see.
    rig
        Adjusted cameras of all views.

    Returns
    -------
    noise
        At least what any camera model has [px].

    Notes
    -----
    Matches of one cell differ by their own errors, the medians of cells by what their matches share and by what the
    median of a few leaves of their own: the variance components of a random-effects model [1]_. A standard deviation
    from a few cells is uncertain itself: parameters adjusted with it have Student's distribution, whose variance is
    larger by ``f / (f - 2)`` with f the number of cells less that of fitted parameters.

    References
    ----------
    .. [1] Searle, S. R., Casella, G., McCulloch, C. E. (1992). Variance Components. Wiley, chapter 3.
    """
    medians, left, differences = [np.empty(0)], [np.empty(0)], [np.empty(0)]
    free = -_POSE_PARAMETERS * (len(rig) - 1)
    for group, errors in list_epipolar_errors(pairs, rig):
        if group.matches.std_px:
            continue
        middle, share = _cell_medians(errors[:, None], group.cell)
        # Wrong matches must not make the right ones count less.
        limit = ROBUST_STD * MAD_TO_STD * float(np.median(np.abs(middle)))
        medians.append(np.clip(middle, -limit, limit).ravel())
        left.append(share)
        free += len(middle)
        differences.append(_differences(errors[:, None], group.cell))
    for points in shared:
        errors = points.points.errors(rig)
        # What the position of a point took up of its errors.
        kept = points.points.constraints / errors.shape[1]
        middle, share = _cell_medians(errors, points.cell)
        medians.append(middle.ravel())
        left.append(np.repeat(kept * share, errors.shape[1]))
        free += points.points.constraints * len(middle)
        differences.append(_differences(errors, points.cell) / np.sqrt(kept))
    apart = np.concatenate(differences)
    own = float(MAD_TO_STD * np.median(apart) / np.sqrt(2)) if len(apart) >= _LEAST_DIFFERENCES else 0.0
    if free <= _POSE_PARAMETERS:
        return MatchNoise(own_px=own)
    square = (np.sum(np.square(np.concatenate(medians))) - own**2 * np.sum(np.concatenate(left))) / (free - 2)
    return MatchNoise(float(np.sqrt(max(square, _LEAST_STD_PX**2))), own)


def _cell_medians(errors: FloatArray, cell: IntArray) -> tuple[FloatArray, FloatArray]:
    """Median of the errors (N, E) of each cell, shape (cells, E); and the share of own variance in it, (cells,)."""
    cells, count = np.unique(cell, return_counts=True)
    medians = np.array([np.nanmedian(errors[cell == one], axis=0) for one in cells])
    return medians, np.where(count <= 2, 1 / count, np.pi / 2 / count)


def _differences(errors: FloatArray, cell: IntArray) -> FloatArray:
    """Absolute differences of the errors (N, E) of successive matches of a cell, shape (D,) [px]."""
    order = np.argsort(cell, kind="stable")
    apart = np.abs(np.diff(errors[order], axis=0))[np.diff(cell[order]) == 0].ravel()
    return np.asarray(apart[np.isfinite(apart)])
