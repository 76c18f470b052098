"""Observation equations of the site adjustment: parameters, priors and residuals."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.session import Readings, Site
from vfm_sdm.stages.cameras.culprits import Claim
from vfm_sdm.stages.cameras.edge_axes import find_edge_axes
from vfm_sdm.stages.cameras.edge_groups import group_edges
from vfm_sdm.stages.cameras.match_cells import MatchNoise
from vfm_sdm.stages.cameras.site_axes import AXES, OFF_FACE, AxesParameters, AxesValues
from vfm_sdm.stages.cameras.site_cameras import list_distances, list_focal_claims, list_intrinsics
from vfm_sdm.stages.cameras.site_face import FacePlace, FaceRelief
from vfm_sdm.stages.cameras.site_lines import EdgeResiduals
from vfm_sdm.stages.cameras.site_matches import MatchResiduals
from vfm_sdm.stages.cameras.site_points import PointParameters
from vfm_sdm.stages.cameras.site_values import AdjustedValue, SitePoint, SiteState, list_measured
from vfm_sdm.stages.cameras.whitening import STEP, RigParameters, differentiate, differentiate_centrally
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.straight_edges import StraightEdges

__all__ = ["SiteProblem"]

_EDGE_STEP = 1e-6
"""Of the derivative of edges: pixels without distortion are found to rounding errors of 1e-12 px [1]."""


class SiteProblem:
    """Whitened parameters, each with a standard normal prior, and the residuals of everything that was measured.

    Parameters
    ----------
    rig, matches, site, points, readings, edges
        Arguments of `vfm_sdm.stages.cameras.site.adjust_to_site`.

    Raises
    ------
    CameraError
        The rig has no prior covariance, or a range or length names a point without pixels.

    Notes
    -----
    The parameters are those of the rig, with the pose of the reference camera fixed, and distortion by what it does to
    pixels, so that its prior keeps its meaning when the focal length moves; pitch and roll of the reference
    camera; perpendicular and longitudinal distance; the common offset of points from the face and its lean, the offset
    of matches at the lower border of the image; pixel errors of the named points in use; and, with edges, what their
    directions differ from the axes by, and the axes themselves where the distances were not measured.

    The residual of a match is its Sampson error over ``sqrt(n s^2 + o^2)``, with ``n`` the number of matches in its
    cell of a 6 x 6 grid over the image, ``s`` the standard deviation of what they share and ``o`` that of each one's
    own error, so that a cell weighs as one observation however many matches it holds, and one with few of them less.
    Points that three views or more see have the reprojection errors of all their pixels as residuals, over the same
    standard deviation: unlike epipolar lines, these determine the distances of cameras that stand in a row. With
    independent weights thousands of correlated errors would outweigh the lens prior: on the real pair
    ``multidic_cylinder`` that gave 73 % too much displacement with a residual of 0.2 px.

    Residuals of matches and shared points pass through the pseudo-Huber loss with a limit of three standard
    deviations. So do the distances from the face of matches that lie on it, over its standard deviation, and what edges
    differ from leading to their vanishing points and from straight by.
    """

    def __init__(
        self,
        rig: Rig,
        matches: Sequence[Matches],
        site: Site,
        points: Mapping[str, SitePoint],
        *,
        readings: Mapping[str, Readings],
        edges: Sequence[StraightEdges] = (),
    ) -> None:
        if rig.covariance is None:
            raise CameraError("site adjustment: expected a rig with a prior covariance, got none; state the priors")
        self._start = rig
        self._site = site
        self._readings = dict(readings)
        self._lenses_and_poses = RigParameters(rig)
        self._rig_size = self._lenses_and_poses.size
        edges = edges if site.lines is not None else ()
        distances = site.perpendicular_distance is not None
        found = find_edge_axes(edges, rig, site) if edges and not distances else None
        self._axes = AxesParameters(site, found)
        self.has_axes = self._axes.has_axes
        on_face = [name for name, point in points.items() if point.on_face and self._axes.has_face]
        self._points = PointParameters(points, site, on_face, len(rig))
        self._matches = MatchResiduals(matches, rig)
        on_face_cells = self._matches.cells if self._axes.has_face else []
        self._face = FaceRelief(on_face, on_face_cells, site.face_offset_std)
        self.size = self._rig_size + self._axes.size + self._points.size
        axes = self.structure_rotation(np.zeros(self.size)) if self.has_axes else None
        groups = group_edges(edges, rig, axes) if edges else []
        start = np.zeros(self.size)
        self._edges = EdgeResiduals(groups, self.rig(start), self._edge_directions(start) if groups else np.eye(3))
        self.notes: list[str] = []
        if site.lines is not None:
            self.notes.append(self._describe_edges())
        if self._axes.has_face and site.reference_camera_level is None:
            self.notes.append("no level reading of the reference camera: pitch and roll taken as 0 +- 1 degree")

    @property
    def noise(self) -> MatchNoise:
        """Standard deviations of the errors of matches."""
        return self._matches.noise

    @noise.setter
    def noise(self, noise: MatchNoise) -> None:
        self._matches.noise = noise

    def rig(self, z: FloatArray) -> Rig:
        """Cameras at these parameters.

        Parameters
        ----------
        z
            Whitened parameters, shape (M,).

        Returns
        -------
        rig
            Rig without covariance.
        """
        return self._lenses_and_poses.rig(z[: self._rig_size])

    def common_focal(self) -> tuple[FloatArray, float]:
        """Whitened parameters of all focal lengths one prior standard deviation longer, and that deviation.

        Returns
        -------
        direction, std
            Shape (M,); and the mean relative standard deviation [1].
        """
        direction, std = self._lenses_and_poses.common_focal()
        return np.pad(direction, (0, self.size - len(direction))), std

    def structure_rotation(self, z: FloatArray) -> FloatArray:
        """Rotation from the reference camera to the structure's axes at these parameters.

        Parameters
        ----------
        z
            Whitened parameters, shape (M,).

        Returns
        -------
        structure_from_cam1
            Rotation matrix, shape (3, 3); the identity when neither distances nor edges tell the axes.
        """
        values = self._axes_values(z)
        return self._axes.rotation(values, self.rig(z).cameras[0]) if self.has_axes else np.eye(3)

    def residuals(self, z: FloatArray) -> FloatArray:
        """All residuals over their standard deviations: priors, matches, lengths.

        Parameters
        ----------
        z
            Whitened parameters, shape (M,).

        Returns
        -------
        residuals
            Residuals, shape (M + R,) [1]; the first M are the parameters themselves.
        """
        of_rig = [self._compute_pair_residuals(z), self._compute_shared_residuals(z)]
        of_axes = [self._compute_surface_residuals(z), self._compute_edge_residuals(z)]
        return np.concatenate([z, *of_rig, *of_axes, self._compute_site_residuals(z)])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Derivative of `residuals` by finite differences.

        Parameters
        ----------
        z
            Whitened parameters, shape (M,).

        Returns
        -------
        jacobian
            Derivative, shape (M + R, M) [1]; only the parameters of the rig move the matches.
        """
        parts = [np.eye(self.size), differentiate(self._compute_pair_residuals, z, self._rig_size)]
        if self._matches.has_shared:
            parts.append(differentiate_centrally(self._compute_shared_residuals, z, self._rig_size))
        moving = self._rig_size + self._axes.size
        if self._face.has_matches:
            parts.append(differentiate_centrally(self._compute_surface_residuals, z, moving))
        if self._edges.size:
            parts.append(differentiate(self._compute_edge_residuals, z, moving, step=_EDGE_STEP))
        parts.append(self._differentiate_site(z, moving))
        return np.concatenate([np.pad(part, ((0, 0), (0, self.size - part.shape[1]))) for part in parts])

    def quantities(self, z: FloatArray) -> list[AdjustedValue]:
        """Quantities for the report at these parameters.

        Parameters
        ----------
        z
            Whitened parameters, shape (M,).

        Returns
        -------
        quantities
            Intrinsics, distances, lengths and level readings that were free to change.
        """
        rig = self.rig(z)
        values = list(list_intrinsics(self._start, rig))
        if rig.metric or self._site.baseline is not None:
            values += list_distances(self._start, rig)
        values += list_measured(self._state(z), self._site, self._readings)
        axes = self._axes_values(z)
        values += self._axes.square_angles(axes, self._edges.axes)
        named = self._axes.named(axes)
        return values + [AdjustedValue(name, unit, prior, std, now, True) for _, name, unit, prior, std, now in named]

    def claims(self, count: int) -> list[Claim]:
        """Everything that was stated and may be wrong, and how an error of it would change the residuals.

        Parameters
        ----------
        count
            Number R of all residuals.

        Returns
        -------
        claims
            Focal lengths of each view and of all together, priors of the site, and every reading.
        """
        start = np.zeros(self.size)
        found = list_focal_claims(self._start, self._lenses_and_poses.factor, count)
        eye = np.eye(count)
        for index, name, unit, stated, std, _ in self._axes.named(self._axes_values(start)):
            found.append(Claim(name, unit, stated, std, eye[:, [self._rig_size + index]]))
        for name, unit, stated, std, moved, advice in self._axes.edge_claims(self._edges.axes):
            rows = sum(share * eye[:, [self._rig_size + index]] for index, share in moved.items())
            found.append(Claim(name, unit, stated, std, np.asarray(rows), advice=advice))
        measured = list_measured(self._state(start), self._site, self._readings)
        first = count - len(measured) - len(self._face.names)
        for number, one in enumerate(measured, start=first):
            found.append(Claim(one.name, one.units, one.prior, one.prior_std, eye[:, [number]]))
        found += [self._claim_of_point(name, eye, first + len(measured)) for name in self._points.names]
        return found

    def sources(self) -> dict[str, list[int]]:
        """Numbers of all residuals by what they are of: every statement and kind of observation."""
        start = np.zeros(self.size)
        pixels = (self._compute_pair_residuals(start), self._compute_shared_residuals(start))
        names = ["matches"] * sum(map(len, pixels))
        names += [OFF_FACE] * len(self._compute_surface_residuals(start))
        names += ["edges"] * len(self._compute_edge_residuals(start))
        names += [one.name for one in list_measured(self._state(start), self._site, self._readings)]
        names += [OFF_FACE] * len(self._face.names)
        found = self._lenses_and_poses.sources()
        named = [*self._axes.sources, *["places of the points"] * self._points.size, *names]
        for index, name in enumerate(named, start=self._rig_size):
            found.setdefault(name, []).append(index)
        return found

    def _claim_of_point(self, name: str, eye: FloatArray, first: int) -> Claim:
        """A named point: where each view sees it, and that it lies on the face."""
        per_point = self._points.per_point
        begin = self._rig_size + self._axes.size + per_point * self._points.names.index(name)
        values = list(range(begin, begin + per_point))
        if name in self._face.names:
            values.append(first + self._face.names.index(name))
        return Claim(f"point {name!r}", "", float("nan"), float("nan"), eye[:, values])

    def epipolar_rms(self, z: FloatArray) -> float:
        """Root mean square epipolar error of the matches.

        Parameters
        ----------
        z
            Whitened parameters, shape (M,).

        Returns
        -------
        rms
            Error [px]; NaN without matches.
        """
        return self._matches.epipolar_rms(self.rig(z))

    def weigh_matches(self, z: FloatArray) -> None:
        """Gives matches and edges the standard deviations that follow from a solution that fits them.

        Parameters
        ----------
        z
            Whitened parameters of a solution, shape (M,).
        """
        self._matches.weigh(self.rig(z))
        if self._edges.size:
            self._edges.weigh(self.rig(z), self._edge_directions(z))

    def weigh_relief(self, z: FloatArray) -> None:
        """Gives distances from the face, left out until then, the standard deviations that follow from a solution.

        Parameters
        ----------
        z
            Whitened parameters of a solution, shape (M,).
        """
        self._face.weigh(self._face_place(z), self._triangulate_points(z) if self.has_axes else {})

    def log_spread(self) -> float:
        """Twice the logarithm of the standard deviations of relief, summed as its residuals are [1].

        Costs of solutions with their own standard deviations compare with this beside them.
        """
        return self._face.log_spread()

    def log_spread_of(self, point: str) -> float:
        """Part of `log_spread` that a named point has [1]; 0 where it is not on the face."""
        return self._face.log_spread_of(point)

    def _axes_values(self, z: FloatArray) -> AxesValues:
        return self._axes.values(z[self._rig_size : self._rig_size + self._axes.size])

    def _triangulate_points(self, z: FloatArray) -> dict[str, FloatArray]:
        """Named points in the reference camera's frame, shape (3,) each [m], with the pixel errors at ``z``."""
        return self._points.triangulate(z[self._rig_size + self._axes.size :], self.rig(z))

    def _face_place(self, z: FloatArray) -> FacePlace:
        values = self._axes_values(z)
        lateral = values.perpendicular_m + values.offset_m
        return FacePlace(self.rig(z), self.structure_rotation(z)[0], lateral, values.lean_m)

    def _state(self, z: FloatArray) -> SiteState:
        """What the parameters say of everything that is measured on site."""
        values = self._axes_values(z)
        axes = self.structure_rotation(z) if self.has_axes else None
        points = self._triangulate_points(z)
        return SiteState(self.rig(z), points, values.pitch_rad, values.roll_rad, values.perpendicular_m, axes)

    def _edge_directions(self, z: FloatArray) -> FloatArray:
        return self._axes.edge_directions(self._axes_values(z), self.structure_rotation(z))

    def _compute_edge_residuals(self, z: FloatArray) -> FloatArray:
        return self._edges.residuals(self.rig(z), self._edge_directions(z)) if self._edges.size else np.empty(0)

    def _describe_edges(self) -> str:
        """A sentence on the edges in use."""
        if not self._edges.axes:
            return "straight edges: too few along any axis of the structure, none used"
        counts = ", ".join(f"{self._edges.count(axis)} {AXES[axis]}" for axis in self._edges.axes)
        source = "; the axes come from them, for the two distances were not measured" if self._axes.of_edges else ""
        return f"straight edges used: {counts}{source}"

    def _compute_pair_residuals(self, z: FloatArray) -> FloatArray:
        return self._matches.residuals_of_pairs(self.rig(z))

    def _compute_shared_residuals(self, z: FloatArray) -> FloatArray:
        return self._matches.residuals_of_shared(self.rig(z))

    def _compute_surface_residuals(self, z: FloatArray) -> FloatArray:
        """Distances from the face of matches on it, as they show."""
        return self._face.residuals_of_matches(self._face_place(z), self.noise.own_px)

    def _compute_site_residuals(self, z: FloatArray) -> FloatArray:
        """Residuals of everything measured on site over their standard deviations, and of points on the face."""
        return self._compare_with_site(self._state(z), self._face_place(z))

    def _compare_with_site(self, state: SiteState, place: FacePlace) -> FloatArray:
        measured = [(q.value - q.prior) / q.prior_std for q in list_measured(state, self._site, self._readings)]
        on_face = self._face.residuals_of_points(place, state.points)
        return np.concatenate([np.asarray(measured, dtype=np.float64), on_face])

    def _differentiate_site(self, z: FloatArray, moving: int) -> FloatArray:
        """Derivative of `_compute_site_residuals`; pixels of points move the points alone, all at once."""
        parts = [differentiate(self._compute_site_residuals, z, moving)]
        if self._points.size:
            state, place = self._state(z), self._face_place(z)
            shifted = self._points.triangulate_shifted(z[moving:], place.rig, STEP)
            changed = [self._compare_with_site(replace(state, points=points), place) for points in shifted]
            parts.append((np.stack(changed[1:], axis=1) - changed[0][:, None]) / STEP)
        return np.concatenate(parts, axis=1)
