"""Straight edges of the structure as residuals of the site adjustment: vanishing points and straightness."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.cameras.edge_errors import edge_errors
from vfm_sdm.stages.cameras.edge_groups import AxisEdges
from vfm_sdm.stages.cameras.whitening import ROBUST_STD, bend

__all__ = ["EdgeNoise", "EdgeResiduals"]

_UNKNOWN_SLANT, _UNKNOWN_BOW = np.radians(0.5), 1e-3
"""By how much members are out of line [rad] and out of straight over their length [1], until residuals tell it:
tolerances of steel structures (EN 1090-2) are a five-hundredth and a thousandth."""
_GROSS = 4.0
_END_ON = 0.05
"""Sine of the least angle at which a member is seen: edges near their vanishing point are left out."""
_NORMAL = 1.4826
_LEAST_FREE = 4


@dataclass(frozen=True)
class EdgeNoise:
    """Standard deviations of what members of a structure differ by from straight lines along its axes.

    Parameters
    ----------
    slant_rad
        Angle between members of one axis [rad].
    bow
        Distance of the middle of a member from its chord, over the length [1].
    """

    slant_rad: float = _UNKNOWN_SLANT
    bow: float = _UNKNOWN_BOW


class EdgeResiduals:
    """Robust, weighted residuals of edges; a cell of a 6 x 6 grid over the image weighs as one observation of an axis.

    Parameters
    ----------
    groups
        Edges of each view that run along axes of the structure.

    Attributes
    ----------
    noise
        What members differ by.
    size
        Number of residuals: those of edges that are left out are 0.

    Notes
    -----
    A member out of line is so in all V views that see it: its slant has the variance ``V s^2`` in each, so that all
    together count as one. The residual over its standard deviation passes through the pseudo-Huber loss.
    """

    def __init__(self, groups: Sequence[AxisEdges]) -> None:
        self._groups = list(groups)
        self.noise = EdgeNoise()
        self._kept: list[BoolArray] = [np.ones(len(one.edges), dtype=np.bool_) for one in groups]
        # Of all edges, so that problems with other cameras, which other edges agree with, have as many.
        self.size = 2 * sum(one.total for one in groups)
        self._views_of = np.array([sum(bool((one.axis == axis).any()) for one in groups) for axis in range(3)])

    @property
    def axes(self) -> list[int]:
        """Indices of the axes that have edges."""
        return [axis for axis in range(3) if self._views_of[axis]]

    def count(self, axis: int) -> int:
        """Number of edges along an axis.

        Parameters
        ----------
        axis
            Index of the axis.
        """
        return int(sum((one.axis == axis).sum() for one in self._groups))

    def residuals(self, rig: Rig, directions: FloatArray) -> FloatArray:
        """Slopes and bows of all edges over their standard deviations, shape (size,) [1].

        Parameters
        ----------
        rig
            Cameras.
        directions
            Directions of lateral, vertical and longitudinal edges in the frame of the rig, shape (3, 3) [1].
        """
        parts = [np.empty(0)]
        for group, kept in zip(self._groups, self._kept, strict=True):
            slope, bow, _, seen = edge_errors(group.edges.places, rig.cameras[group.edges.view], directions[group.axis])
            half = group.edges.length_px / 2
            shared = self.noise.slant_rad * half * np.sqrt(self._views_of[group.axis]) / np.fmax(seen, _END_ON)
            bent = self.noise.bow * 2 * half * np.sqrt(self._views_of[group.axis])
            for errors, common, own in (
                (slope, shared, group.edges.slope_std_px),
                (bow, bent, group.edges.bow_std_px),
            ):
                single = np.hypot(common, own)
                factor = group.weight * single / np.hypot(common, own * group.weight)
                of_all = np.zeros(group.total)
                of_all[group.rows] = np.where(kept, bend(errors / single) * factor, 0.0)
                parts.append(of_all)
        return np.concatenate(parts)

    def weigh(self, rig: Rig, directions: FloatArray) -> None:
        """Gives members the standard deviations that follow from a solution, and leaves out edges far from it.

        Parameters
        ----------
        rig, directions
            As of `residuals`, at the solution.

        Notes
        -----
        The variance between members is that with which the squares of the means of cells, over their variances, sum up
        to their number less that of what was fitted to them (the estimator of Paule and Mandel [1]_). It is larger by
        ``f / (f - 2)``, as that of matches is (`vfm_sdm.stages.cameras.match_cells.estimate_match_noise`).

        References
        ----------
        .. [1] Paule, R. C., Mandel, J. (1982). Consensus values and weighting factors. Journal of Research of the
           National Bureau of Standards 87(5), 377-385.
        """
        self._kept = [np.ones(len(one.edges), dtype=np.bool_) for one in self._groups]
        for _ in range(2):
            slants, bows = [np.empty((0, 3))], [np.empty((0, 3))]
            for group, kept in zip(self._groups, self._kept, strict=True):
                slope, bow, _, seen = edge_errors(
                    group.edges.places, rig.cameras[group.edges.view], directions[group.axis]
                )
                half, views = group.edges.length_px / 2, self._views_of[group.axis]
                known = kept & np.isfinite(slope) & np.isfinite(bow)
                for found, error, own, length in (
                    (slants, slope * seen, group.edges.slope_std_px * seen, half),
                    (bows, bow, group.edges.bow_std_px, 2 * half),
                ):
                    found.append(_cell_means(group, known, error / length, own / length, views))
            fitted = 2 * len(self.axes) + len(rig)
            self.noise = EdgeNoise(
                _spread(np.concatenate(slants), fitted, _UNKNOWN_SLANT),
                _spread(np.concatenate(bows), len(rig), _UNKNOWN_BOW),
            )
            self._kept = [self._near(group, rig, directions) for group in self._groups]

    def _near(self, group: AxisEdges, rig: Rig, directions: FloatArray) -> BoolArray:
        """Whether each edge is within four standard deviations, shape (N,)."""
        slope, bow, _, seen = edge_errors(group.edges.places, rig.cameras[group.edges.view], directions[group.axis])
        length, views = group.edges.length_px, np.sqrt(self._views_of[group.axis])
        slant = self.noise.slant_rad / np.fmax(seen, _END_ON)
        slope_std = np.hypot(slant * length / 2 * views, group.edges.slope_std_px)
        bow_std = np.hypot(self.noise.bow * length * views, group.edges.bow_std_px)
        with np.errstate(invalid="ignore"):
            return np.asarray((np.abs(slope) < _GROSS * slope_std) & (np.abs(bow) < _GROSS * bow_std))


def _cell_means(
    group: AxisEdges, known: BoolArray, error: FloatArray, std: FloatArray, views: FloatArray
) -> FloatArray:
    """Mean error, its own variance and the number of views, of each cell of a view, shape (cells, 3)."""
    rows = []
    for index in np.unique(group.cell[known]):
        members = known & (group.cell == index)
        weight = std[members] ** -2
        rows.append((float(weight @ error[members] / weight.sum()), 1 / float(weight.sum()), float(views[members][0])))
    return np.array(rows).reshape(-1, 3)


def _spread(cells: FloatArray, fitted: int, unknown: float) -> float:
    """Standard deviation between members."""
    mean, own, views = cells.T
    free = len(cells) - fitted
    if free < _LEAST_FREE:
        return unknown
    limit = ROBUST_STD * _NORMAL * float(np.median(np.abs(mean)))
    square = np.minimum(np.abs(mean), limit) ** 2

    def excess(variance: float) -> float:
        return float(np.sum(square / (own + views * variance))) - free

    most = float(square.max()) + 1e-12
    if excess(0.0) <= 0:
        return 0.0
    variance = float(brentq(excess, 0.0, most)) if excess(most) < 0 else most
    return float(np.sqrt(variance * free / (free - 2)))
