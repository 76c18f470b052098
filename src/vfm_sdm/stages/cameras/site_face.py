"""Points and matches on the structure's face as residuals: how far out of it they show."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.cameras.match_cells import CellMatches
from vfm_sdm.stages.cameras.relief import Relief, show_relief
from vfm_sdm.stages.cameras.whitening import OUTLIER, bend
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["FacePlace", "FaceRelief"]


@dataclass(frozen=True, eq=False)
class FacePlace:
    """Where the face lies at some parameters.

    Parameters
    ----------
    rig
        Cameras.
    lateral_axis
        Unit vector across the face in the rig's frame, shape (3,) [1].
    lateral_m
        Lateral coordinate of the face, its common offset included [m].
    lean_m
        What is added to it at the lower border of an image, and taken off at the upper one [m].
    """

    rig: Rig
    lateral_axis: FloatArray
    lateral_m: float
    lean_m: float


class FaceRelief:
    """Distances of named points and of matches from the face, as they show, over their standard deviations.

    Parameters
    ----------
    names
        Named points on the face; empty where its distance was not measured.
    cells
        Matches of pairs of views, of which those on the face count; empty where its distance was not measured.
    std_m
        Standard deviation of a distance from the face [m].

    Notes
    -----
    Left out until `weigh` has told their standard deviations in pixels: see `vfm_sdm.stages.cameras.relief.Relief`.
    """

    def __init__(self, names: Sequence[str], cells: Sequence[CellMatches], std_m: float) -> None:
        self.names = list(names)
        self._std_m = std_m
        # Of the cells' few matches on the face; one cell is one place of it, as of the epipolar errors.
        self._groups = [group for group in cells if group.matches.on_face.any()]
        self._matches = [group.matches.chosen(group.matches.on_face) for group in self._groups]
        self._relief: list[FloatArray] = []
        self._triangulated: tuple[Rig | None, list[FloatArray]] = (None, [])

    @property
    def has_matches(self) -> bool:
        """Whether any match lies on the face."""
        return bool(self._groups)

    def weigh(self, place: FacePlace, points: Mapping[str, FloatArray]) -> None:
        """Gives distances from the face, left out until then, the standard deviations that follow from a solution.

        Parameters
        ----------
        place
            Cameras and face of a solution.
        points
            Named points in the reference camera's frame, shape (3,) each [m].
        """
        shown = [one.per_metre for one in self._show_matches(place)]
        self._relief = [*shown, self._show_points(place, points).per_metre] if self.names else shown

    def log_spread(self) -> float:
        """Twice the logarithm of the standard deviations of relief, summed as its residuals are [1]."""
        weights = [np.square(group.weight[group.matches.on_face]) for group in self._groups]
        weights += [np.ones(len(self.names))] if self.names else []
        spread = sum(float(w @ np.log(one)) for w, one in zip(weights, self._relief, strict=True))
        return 2 * spread if np.isfinite(spread) else float("inf")

    def log_spread_of(self, point: str) -> float:
        """Part of `log_spread` that a named point has [1]; 0 where it is not on the face.

        Parameters
        ----------
        point
            Name of the point.
        """
        known = bool(self._relief) and point in self.names
        return 2 * float(np.log(self._relief[-1][self.names.index(point)])) if known else 0.0

    def residuals_of_points(self, place: FacePlace, points: Mapping[str, FloatArray]) -> FloatArray:
        """Distances of the named points from the face over the standard deviation, shape (names,) [1].

        Parameters
        ----------
        place, points
            As of `weigh`.
        """
        if not self.names:
            return np.empty(0)
        if not self._relief:
            return np.zeros(len(self.names))
        away = self._show_points(place, points).scaled(self._std_m, self._relief[-1])
        # At a trial step the face may lie behind a camera.
        return np.where(np.isfinite(away), away, OUTLIER)

    def residuals_of_matches(self, place: FacePlace, own_px: float) -> FloatArray:
        """Robust, weighted distances of the matches from the face, shape (matches on it,) [1].

        Parameters
        ----------
        place
            Cameras and face.
        own_px
            Standard deviation of a match's own error [px].
        """
        if not self._relief:
            return np.zeros(sum(map(len, self._matches)))
        parts = [np.empty(0)]
        shown = zip(self._groups, self._show_matches(place), self._relief, strict=False)
        for group, relief, per_metre in shown:
            weight = group.weight[group.matches.on_face]
            parts.append(bend(relief.scaled(self._std_m, per_metre, own_px)) * weight)
        return np.concatenate(parts)

    def _show_points(self, place: FacePlace, points: Mapping[str, FloatArray]) -> Relief:
        """Distances of the named points from the face."""
        places = np.array([points[name] for name in self.names])
        return show_relief(places, place.rig, place.lateral_axis, place.lateral_m)

    def _show_matches(self, place: FacePlace) -> Iterator[Relief]:
        """Distances of the matches of each pair from the face."""
        rig = place.rig
        for m, points3d in zip(self._matches, self._triangulate(rig), strict=True):
            # What lies on a face is stepped along its height: an edge beam above, a girder behind it below.
            height = rig.cameras[m.first].image_size[1] / 2
            shift = place.lean_m * (m.points_first[:, 1] / height - 1)
            yield show_relief(points3d, _pair(rig, m), place.lateral_axis, place.lateral_m + shift)

    def _triangulate(self, rig: Rig) -> list[FloatArray]:
        """Points of the matches on the face, shape (N, 3) each; derivatives by the face's parameters ask again."""
        if self._triangulated[0] is not rig:
            found = [triangulate(np.stack([m.points_first, m.points_second]), _pair(rig, m)) for m in self._matches]
            self._triangulated = (rig, found)
        return self._triangulated[1]


def _pair(rig: Rig, matches: Matches) -> Rig:
    return Rig(("first", "second"), (rig.cameras[matches.first], rig.cameras[matches.second]))
