"""Straight edges of the structure as residuals of the site adjustment: vanishing points and straightness."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.cameras.edge_errors import EdgeErrors, StraightenedEdges, straighten
from vfm_sdm.stages.cameras.edge_groups import AxisEdges
from vfm_sdm.stages.cameras.whitening import ROBUST_STD, bend

__all__ = ["EdgeNoise", "EdgeResiduals"]

_UNKNOWN_SLANT, _UNKNOWN_BOW = np.radians(0.5), 1e-3
"""By how much members are out of line [rad] and out of straight over their length [1], until residuals tell it:
tolerances of steel structures (EN 1090-2) are a five-hundredth and a thousandth."""
_GROSS = 4.0
_END_ON = 0.05
"""Sine of the least angle at which a member is seen: edges near their vanishing point are left out."""
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
    rig, directions
        Cameras, and directions of lateral, vertical and longitudinal edges in the frame of the rig, shape (3, 3) [1],
        as they are known before.

    Attributes
    ----------
    noise
        What members differ by.
    size
        Number of residuals: those of edges that are left out are 0.

    Notes
    -----
    A member out of line is so in all V views that see it: its slant has the variance ``V s^2`` in each, so that all
    together count as one. It shows the larger the more the member is seen end-on; standard deviations are those at
    cameras that stay fixed, or the adjustment would prefer cameras to which everything looks uncertain, those with long
    lenses. The residual over its standard deviation passes through the pseudo-Huber loss.
    """

    def __init__(self, groups: Sequence[AxisEdges], rig: Rig, directions: FloatArray) -> None:
        self._groups = list(groups)
        self.noise = EdgeNoise()
        self._kept: list[BoolArray] = [np.ones(len(one.edges), dtype=np.bool_) for one in groups]
        # Of all edges, so that problems with other cameras, which other edges agree with, have as many.
        self.size = 2 * sum(one.total for one in groups)
        self._views_of = np.array([sum(bool((one.axis == axis).any()) for one in groups) for axis in range(3)])
        self._straightened: list[tuple[Camera, StraightenedEdges] | None] = [None] * len(self._groups)
        self._seen = [self._errors(number, rig, directions).foreshortening for number in range(len(self._groups))]

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
        rig, directions
            Cameras and directions of edges.
        """
        parts = [np.empty(0)]
        for number, (group, kept) in enumerate(zip(self._groups, self._kept, strict=True)):
            found = self._errors(number, rig, directions)
            slant_px, bow_px = self._member_stds(number)
            for errors, common, own in (
                (found.slope_px, slant_px, group.edges.slope_std_px),
                (found.bow_px, bow_px, group.edges.bow_std_px),
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
        found = [self._errors(number, rig, directions) for number in range(len(self._groups))]
        self._seen = [one.foreshortening for one in found]
        self._kept = [np.isfinite(one.slope_px) & np.isfinite(one.bow_px) for one in found]
        fitted = 2 * len(self.axes) + len(rig)
        for _ in range(2):
            slants, bows = [np.empty((0, 3))], [np.empty((0, 3))]
            for group, one, kept in zip(self._groups, found, self._kept, strict=True):
                half, views = group.edges.length_px / 2, self._views_of[group.axis]
                angle = one.foreshortening / half
                of_group = (group, kept, views)
                slants.append(_cell_means(*of_group, one.slope_px * angle, group.edges.slope_std_px * angle))
                bows.append(_cell_means(*of_group, one.bow_px / (2 * half), group.edges.bow_std_px / (2 * half)))
            self.noise = EdgeNoise(
                _spread(np.concatenate(slants), fitted, _UNKNOWN_SLANT),
                _spread(np.concatenate(bows), len(rig), _UNKNOWN_BOW),
            )
            self._kept = [self._near(number, one) for number, one in enumerate(found)]

    def _errors(self, number: int, rig: Rig, directions: FloatArray) -> EdgeErrors:
        """Errors of the edges of one view; derivatives by the directions ask again for the same camera."""
        group = self._groups[number]
        camera = rig.cameras[group.edges.view]
        known = self._straightened[number]
        if known is None or known[0] is not camera:
            known = (camera, straighten(group.edges.places, camera))
            self._straightened[number] = known
        return known[1].errors(camera, directions[group.axis])

    def _member_stds(self, number: int) -> tuple[FloatArray, FloatArray]:
        """What members differ by at the ends and in the middle of each edge of one view, shape (N,) [px]."""
        group = self._groups[number]
        views, length = np.sqrt(self._views_of[group.axis]), group.edges.length_px
        slant = self.noise.slant_rad / np.fmax(self._seen[number], _END_ON)
        return slant * views * length / 2, self.noise.bow * views * length

    def _near(self, number: int, found: EdgeErrors) -> BoolArray:
        """Whether each edge of one view is within four standard deviations, shape (N,)."""
        edges, (slant_px, bow_px) = self._groups[number].edges, self._member_stds(number)
        near = np.abs(found.slope_px) < _GROSS * np.hypot(slant_px, edges.slope_std_px)
        return np.asarray(near & (np.abs(found.bow_px) < _GROSS * np.hypot(bow_px, edges.bow_std_px)))


def _cell_means(
    group: AxisEdges, known: BoolArray, views: FloatArray, error: FloatArray, std: FloatArray
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
    limit = ROBUST_STD * MAD_TO_STD * float(np.median(np.abs(mean)))
    square = np.minimum(np.abs(mean), limit) ** 2

    def excess(variance: float) -> float:
        return float(np.sum(square / (own + views * variance))) - free

    most = float(square.max()) + 1e-12
    if excess(0.0) <= 0:
        return 0.0
    variance = float(brentq(excess, 0.0, most)) if excess(most) < 0 else most
    return float(np.sqrt(variance * free / (free - 2)))
