"""Matches of pairs of views, and points that three views or more see, as residuals of the site adjustment."""

from collections.abc import Sequence

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.cameras.match_cells import (
    MatchNoise,
    estimate_match_noise,
    group_matches,
    group_points,
    list_epipolar_errors,
)
from vfm_sdm.stages.cameras.shared_points import chain_matches
from vfm_sdm.stages.cameras.whitening import OUTLIER, ROBUST_STD, bend
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["MatchResiduals"]


class MatchResiduals:
    """Robust, weighted residuals of matches; a cell of a 6 x 6 grid over the image weighs as one observation.

    Parameters
    ----------
    matches
        Matches between views; may be empty.
    rig
        Cameras, for the sizes of their images [px].

    Attributes
    ----------
    noise
        Standard deviations of the errors of matches.
    cells
        Thinned matches of all pairs of views.
    """

    def __init__(self, matches: Sequence[Matches], rig: Rig) -> None:
        self.cells = [group_matches(m, rig.cameras[m.first].image_size) for m in matches if len(m.points_first)]
        pairs, shared = chain_matches(matches)
        self._pairs = [group_matches(m, rig.cameras[m.first].image_size) for m in pairs if len(m.points_first)]
        self._shared = [group_points(points, rig.cameras[points.views[0]].image_size) for points in shared]
        self.noise = MatchNoise()

    @property
    def has_shared(self) -> bool:
        """Whether three views or more see a point."""
        return bool(self._shared)

    def weigh(self, rig: Rig) -> None:
        """Gives matches the standard deviations that follow from cameras that fit them.

        Parameters
        ----------
        rig
            Adjusted cameras.
        """
        self.noise = estimate_match_noise(self._pairs, self._shared, rig)

    def epipolar_rms(self, rig: Rig) -> float:
        """Root mean square epipolar error of all matches [px]; NaN without matches.

        Parameters
        ----------
        rig
            Cameras.
        """
        errors = [one for _, one in list_epipolar_errors(self.cells, rig)]
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")

    def residuals_of_pairs(self, rig: Rig) -> FloatArray:
        """Residuals of the matches of pairs of views, shape (matches,) [1].

        Parameters
        ----------
        rig
            Cameras.
        """
        parts = [np.empty(0)]
        for group, errors in list_epipolar_errors(self._pairs, rig):
            std_px, factor = self.noise.spread(group.weight, group.matches.std_px)
            parts.append(bend(errors / std_px) * factor)
        return np.concatenate(parts)

    def residuals_of_shared(self, rig: Rig) -> FloatArray:
        """Residuals of the points that three views or more see, one for each of their coordinates [1].

        Parameters
        ----------
        rig
            Cameras.
        """
        parts = [np.empty(0)]
        for group in self._shared:
            std_px, factor = self.noise.spread(group.weight)
            scaled = group.points.errors(rig) / std_px
            # All errors of a point are made smaller together where one of them is gross; as `bend`, and smooth at zero.
            reach = ROBUST_STD**2 * group.points.constraints
            square = np.sum(scaled**2, axis=1, keepdims=True)
            robust = scaled * np.sqrt(2 / (np.sqrt(1 + square / reach) + 1))
            known = np.isfinite(robust).all(axis=1, keepdims=True)
            parts.append((np.where(known, robust, OUTLIER) * factor[:, None]).ravel())
        return np.concatenate(parts)
