"""Observation equations of the site adjustment: parameters, priors and residuals."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Readings, Site
from vfm_sdm.stages.cameras.culprits import Claim
from vfm_sdm.stages.cameras.match_cells import (
    MatchNoise,
    estimate_match_noise,
    group_matches,
    group_points,
    list_epipolar_errors,
)
from vfm_sdm.stages.cameras.relief import Relief, show_relief
from vfm_sdm.stages.cameras.shared_points import chain_matches
from vfm_sdm.stages.cameras.site_values import AdjustedValue, SitePoint, SiteState, list_measured
from vfm_sdm.stages.cameras.whitening import (
    OUTLIER,
    ROBUST_STD,
    RigParameters,
    bend,
    differentiate,
    differentiate_centrally,
)
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["ALL_FOCALS", "DISTANCE", "SiteProblem"]

ALL_FOCALS = "focal lengths of all views"
DISTANCE = "distance"
"""First word of the names of the distances from the reference camera to the third and further cameras."""
_UNSTATED_LEVEL_STD = np.radians(1.0)
"""Standard deviation of pitch and roll without a level reading: a tripod head set by eye [rad]."""


class SiteProblem:
    """Whitened parameters, each with a standard normal prior, and the residuals of everything that was measured.

    Parameters
    ----------
    rig, matches, site, points, readings
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
    of matches at the lower border of the image; and pixel errors of the named points in use.

    The residual of a match is its Sampson error over ``sqrt(n s^2 + o^2)``, with ``n`` the number of matches in its
    cell of a 6 x 6 grid over the image, ``s`` the standard deviation of what they share and ``o`` that of each one's
    own error, so that a cell weighs as one observation however many matches it holds, and one with few of them less.
    Points that three views or more see have the reprojection errors of all their pixels as residuals, over the same
    standard deviation: unlike epipolar lines, these determine the distances of cameras that stand in a row. With
    independent weights thousands of correlated errors would outweigh the lens prior: on the real pair
    ``multidic_cylinder`` that gave 73 % too much displacement with a residual of 0.2 px.

    Residuals of matches and shared points pass through the pseudo-Huber loss with a limit of three standard
    deviations. So do the distances from the face of matches that lie on it, over its standard deviation.
    """

    def __init__(
        self,
        rig: Rig,
        matches: Sequence[Matches],
        site: Site,
        points: Mapping[str, SitePoint],
        *,
        readings: Mapping[str, Readings],
    ) -> None:
        if rig.covariance is None:
            raise CameraError("site adjustment: expected a rig with a prior covariance, got none; state the priors")
        self._start = rig
        self._face_points: tuple[bytes, list[FloatArray]] = (b"", [])
        self._site = site
        self._readings = dict(readings)
        self._face = [name for name, point in points.items() if point.on_face]
        self.has_axes = site.perpendicular_distance is not None and site.longitudinal_distance is not None
        self._points = dict(points)
        for name, point in points.items():
            as_float_array(point.pixels, f"point {name!r}", (len(rig), 2))
        self._used = self._list_used_points()
        self._cells = [group_matches(m, rig.cameras[m.first].image_size) for m in matches if len(m.points_first)]
        pairs, shared = chain_matches(matches)
        self._pairs = [group_matches(m, rig.cameras[m.first].image_size) for m in pairs if len(m.points_first)]
        self._shared = [group_points(points, rig.cameras[points.views[0]].image_size) for points in shared]
        # Of the cells' few matches on the face; one cell is one place of it, as of the epipolar errors.
        self._on_face = [group for group in self._cells if group.matches.on_face.any()] if self.has_axes else []
        self._face_matches = [group.matches.chosen(group.matches.on_face) for group in self._on_face]
        self.noise = MatchNoise()
        self._lenses_and_poses = RigParameters(rig)
        self._rig_size = self._lenses_and_poses.size
        self._extra_prior, self._extra_std = self._read_extra_priors()
        self.size = self._rig_size + self._extra_std.size + 2 * len(rig) * len(self._used)
        self._relief: list[FloatArray] = []
        self.notes: list[str] = []
        if self.has_axes and site.reference_camera_level is None:
            self.notes.append("no level reading of the reference camera: pitch and roll taken as 0 +- 1 degree")

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
            Rotation matrix, shape (3, 3); the identity when the distances that give the axes were not measured.
        """
        pitch, roll, perpendicular, longitudinal, *_ = self._get_extra(z)
        if not self.has_axes:
            return np.eye(3)
        camera = self.rig(z).cameras[0]
        # The distances tell where the image centre looks, which differs from the optical axis by the principal point.
        centre = (camera.image_size[0] - 1) / 2
        aside = np.arctan((centre - camera.K[0, 2]) / camera.K[0, 0])
        sign = 1.0 if self._site.structure_side == "right" else -1.0
        # As `compute_view_angle`, but a step on the way to the solution may pass distances that nobody could measure.
        angle = float(np.arctan2(perpendicular, longitudinal)) - sign * aside
        return structure_from_cam1(angle, pitch_rad=pitch, roll_rad=roll, side=self._site.structure_side)

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
        matches = [self._compute_match_residuals(z), self._compute_shared_residuals(z)]
        return np.concatenate([z, *matches, self._compute_surface_residuals(z), self._compute_length_residuals(z)])

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
        matches = [differentiate(self._compute_match_residuals, z, self._rig_size)]
        if self._shared:
            matches.append(differentiate_centrally(self._compute_shared_residuals, z, self._rig_size))
        moving = self._rig_size
        if self._on_face:
            moving += self._extra_std.size
            matches = [np.pad(part, ((0, 0), (0, self._extra_std.size))) for part in matches]
            matches.append(differentiate_centrally(self._compute_surface_residuals, z, moving))
        padded = np.pad(np.concatenate(matches), ((0, 0), (0, self.size - moving)))
        return np.concatenate([np.eye(self.size), padded, differentiate(self._compute_length_residuals, z, self.size)])

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
        covariance = np.asarray(self._start.covariance)
        values = []
        for index, (name, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
            start = self._start.cameras[index]
            std = np.sqrt(np.diag(covariance))[len(CAMERA_PARAMETERS) * index :][:4]
            stretch = camera.focal_px / start.focal_px
            rows = (
                ("focal", "px", start.focal_px, std[0] * start.focal_px, camera.focal_px),
                ("principal point u", "px", start.K[0, 2], std[1], camera.K[0, 2]),
                ("principal point v", "px", start.K[1, 2], std[2], camera.K[1, 2]),
                ("distortion k1", "1", start.distortion[0], std[3] * stretch**2, camera.distortion[0]),
            )
            values += [AdjustedValue(f"{what} {name}", unit, p, s, v) for what, unit, p, s, v in rows if s > 0]
        values += self._list_distances(rig)
        values += list_measured(self._state(z), self._site, self._readings)
        extra = self._get_extra(z)
        for index, name in enumerate(("pitch reference camera", "roll reference camera")):
            prior, std = np.degrees([self._extra_prior[index], self._extra_std[index]])
            if self.has_axes:
                values.append(AdjustedValue(name, "deg", prior, std, float(np.degrees(extra[index])), True))
        for index, name in ((2, "perpendicular distance"), (3, "longitudinal distance")):
            if self.has_axes:
                prior, std = self._extra_prior[index], self._extra_std[index]
                values.append(AdjustedValue(name, "m", prior, std, float(extra[index]), True))
        return values

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
        factor = self._lenses_and_poses.factor
        inner = np.linalg.pinv(factor)
        names = self._start.names
        found, focal = [], []
        for index, (name, camera) in enumerate(zip(names, self._start.cameras, strict=True)):
            row = np.zeros(len(factor))
            row[len(CAMERA_PARAMETERS) * index] = std = float(np.linalg.norm(factor[len(row) // len(names) * index]))
            if std > 0:
                rows = np.pad(inner @ row, (0, count - self._rig_size))[:, None]
                focal.append(Claim(f"focal {name}", "px", camera.focal_px, std, rows, logarithmic=True))
        found += focal
        if len(focal) > 1:
            std = float(np.mean([one.std for one in focal]))
            rows = np.sum([std / one.std * one.rows for one in focal], axis=0)
            mean = float(np.exp(np.mean([np.log(one.stated) for one in focal])))
            found.append(Claim(ALL_FOCALS, "px", mean, std, rows, logarithmic=True))
        eye = np.eye(count)
        extra = ("pitch reference camera", "roll reference camera", "perpendicular distance", "longitudinal distance")
        for index, name in enumerate(extra if self.has_axes else ()):
            unit, scale = ("deg", np.degrees(1.0)) if index < 2 else ("m", 1.0)
            stated, std = scale * self._extra_prior[index], scale * self._extra_std[index]
            found.append(Claim(name, unit, float(stated), float(std), eye[:, [self._rig_size + index]]))
        measured = list_measured(self._state(np.zeros(self.size)), self._site, self._readings)
        on_face = self._face if self.has_axes else []
        first = count - len(measured) - len(on_face)
        for number, one in enumerate(measured, start=first):
            found.append(Claim(one.name, one.units, one.prior, one.prior_std, eye[:, [number]]))
        found += [self._claim_of_point(name, eye, first + len(measured)) for name in self._used]
        return found

    def _claim_of_point(self, name: str, eye: FloatArray, first: int) -> Claim:
        """A named point: where each view sees it, and that it lies on the face."""
        per_point = 2 * len(self._start)
        begin = self._rig_size + self._extra_std.size + per_point * self._used.index(name)
        values = list(range(begin, begin + per_point))
        if self.has_axes and name in self._face:
            values.append(first + self._face.index(name))
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
        errors = [one for _, one in list_epipolar_errors(self._cells, self.rig(z))]
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")

    def weigh_matches(self, z: FloatArray) -> None:
        """Gives matches the standard deviations that follow from a solution that fits them.

        Parameters
        ----------
        z
            Whitened parameters of a solution, shape (M,).
        """
        self.noise = estimate_match_noise(self._pairs, self._shared, self.rig(z))

    def weigh_relief(self, z: FloatArray) -> None:
        """Gives distances from the face, left out until then, the standard deviations that follow from a solution.

        Parameters
        ----------
        z
            Whitened parameters of a solution, shape (M,).
        """
        self._relief = self._scale_relief(z)

    def log_spread(self) -> float:
        """Twice the logarithm of the standard deviations of relief, summed as its residuals are [1].

        Costs of solutions with their own standard deviations compare with this beside them.
        """
        weights = [np.square(group.weight[group.matches.on_face]) for group in self._on_face]
        weights += [np.ones(len(self._face))] if self._has_face_points else []
        spread = sum(float(w @ np.log(one)) for w, one in zip(weights, self._relief, strict=True))
        return 2 * spread if np.isfinite(spread) else float("inf")

    def log_spread_of(self, point: str) -> float:
        """Part of `log_spread` that a named point has [1]; 0 where it is not on the face."""
        known = self._has_face_points and bool(self._relief) and point in self._face
        return 2 * float(np.log(self._relief[-1][self._face.index(point)])) if known else 0.0

    def _scale_relief(self, z: FloatArray) -> list[FloatArray]:
        """Pixels by which a metre out of the face shows, for the matches of each pair and for the named points."""
        shown = [one.per_metre for one in self._show_matches_on_face(z)]
        points = self._triangulate_points(z, self.rig(z)) if self.has_axes else {}
        return [*shown, self._show_points_on_face(z, points).per_metre] if self._has_face_points else shown

    def _list_distances(self, rig: Rig) -> list[AdjustedValue]:
        """Distances of the third and further cameras from the reference camera; that of the second is the baseline."""
        if not (rig.metric or self._site.baseline is not None):
            return []
        size, values = len(CAMERA_PARAMETERS), []
        for index in range(2, len(rig)):
            start = self._start.baseline(0, index)
            along = self._start.cameras[index].translation / start
            last = slice(size * index + 7, size * (index + 1))
            std = float(np.sqrt(along @ np.asarray(self._start.covariance)[last, last] @ along))
            if std > 0:
                name = f"{DISTANCE} {rig.names[0]} to {rig.names[index]}"
                values.append(AdjustedValue(name, "m", start, std, rig.baseline(0, index)))
        return values

    def _list_used_points(self) -> list[str]:
        """Names of the points whose position the measurements on site refer to."""
        wanted = [r.point for r in self._site.range]
        for length in self._site.length:
            wanted += list(length.points)
        missing = sorted({name for name in wanted if name not in self._points})
        if missing:
            raise CameraError(
                f"site: expected pixels in every view for points {missing}, got none; check that they were found"
            )
        if self.has_axes:
            wanted += self._face
        return sorted(set(wanted))

    def _read_extra_priors(self) -> tuple[FloatArray, FloatArray]:
        """Prior values and standard deviations of pitch, roll, perpendicular, longitudinal, face offset and lean."""
        level = self._site.reference_camera_level
        pitch, roll, std = (0.0, 0.0, _UNSTATED_LEVEL_STD)
        if level is not None:
            pitch, roll, std = np.radians([level.pitch, level.roll, level.std_deg])
        across, along = self._site.perpendicular_distance, self._site.longitudinal_distance
        if across is None or along is None:
            return np.array([pitch, roll, 1.0, 1.0, 0.0, 0.0]), np.array([std, std, 0.0, 0.0, 0.0, 0.0])
        return (
            np.array([pitch, roll, across.value, along.value, 0.0, 0.0]),
            np.array([std, std, across.std, along.std, self._site.face_offset_std, self._site.face_offset_std]),
        )

    def _get_extra(self, z: FloatArray) -> FloatArray:
        """Pitch, roll, perpendicular, longitudinal, face offset and lean at ``z``, shape (6,) [rad, m]."""
        part = z[self._rig_size : self._rig_size + self._extra_std.size]
        return np.asarray(self._extra_prior + self._extra_std * part)

    def _triangulate_points(self, z: FloatArray, rig: Rig) -> dict[str, FloatArray]:
        """Named points in the reference camera's frame, shape (3,) each [m], with the pixel errors at ``z``."""
        if not self._used:
            return {}
        used = [self._points[name] for name in self._used]
        errors = z[self._rig_size + self._extra_std.size :].reshape(len(used), len(rig), 2)
        pixels = np.stack([one.pixels for one in used]) + np.stack([one.std_px for one in used]) * errors
        return dict(zip(self._used, triangulate(pixels.swapaxes(0, 1), rig), strict=True))

    def _state(self, z: FloatArray) -> SiteState:
        """What the parameters say of everything that is measured on site."""
        rig = self.rig(z)
        pitch, roll, perpendicular, *_ = self._get_extra(z)
        axes = self.structure_rotation(z) if self.has_axes else None
        return SiteState(rig, self._triangulate_points(z, rig), pitch, roll, perpendicular, axes)

    def _compute_length_residuals(self, z: FloatArray) -> FloatArray:
        """Residuals of everything measured on site over their standard deviations."""
        state = self._state(z)
        measured = [(q.value - q.prior) / q.prior_std for q in list_measured(state, self._site, self._readings)]
        return np.concatenate([np.asarray(measured, dtype=np.float64), self._compute_face_residuals(z, state.points)])

    @property
    def _has_face_points(self) -> bool:
        return self.has_axes and bool(self._face)

    def _compute_face_residuals(self, z: FloatArray, points: Mapping[str, FloatArray]) -> FloatArray:
        """Distances of the named points from the face, as they show, over the standard deviation."""
        if not self._has_face_points:
            return np.empty(0)
        if not self._relief:
            return np.zeros(len(self._face))
        relief = self._show_points_on_face(z, points)
        away = relief.scaled(self._site.face_offset_std, self._relief[-1])
        # At a trial step the face may lie behind a camera.
        return np.where(np.isfinite(away), away, OUTLIER)

    def _show_points_on_face(self, z: FloatArray, points: Mapping[str, FloatArray]) -> Relief:
        """Distances of the named points from the face."""
        _, _, perpendicular, _, offset, _ = self._get_extra(z)
        places = np.array([points[name] for name in self._face])
        return show_relief(places, self.rig(z), self.structure_rotation(z)[0], perpendicular + offset)

    def _compute_surface_residuals(self, z: FloatArray) -> FloatArray:
        """Robust, weighted distances from the face of matches on it, as they show."""
        if not self._relief:
            return np.zeros(sum(map(len, self._face_matches)))
        std, own_px, parts = self._site.face_offset_std, self.noise.own_px, [np.empty(0)]
        shown = zip(self._on_face, self._show_matches_on_face(z), self._relief, strict=False)
        for group, relief, per_metre in shown:
            parts.append(bend(relief.scaled(std, per_metre, own_px)) * group.weight[group.matches.on_face])
        return np.concatenate(parts)

    def _show_matches_on_face(self, z: FloatArray) -> Iterator[Relief]:
        """Distances of the matches of each pair from the face."""
        rig, lateral_axis = self.rig(z), self.structure_rotation(z)[0]
        _, _, perpendicular, _, offset, lean = self._get_extra(z)
        for m, points3d in zip(self._face_matches, self._triangulate_face(z, rig), strict=True):
            # What lies on a face is stepped along its height: an edge beam above, a girder behind it below.
            height = rig.cameras[m.first].image_size[1] / 2
            shift = offset + lean * (m.points_first[:, 1] / height - 1)
            yield show_relief(points3d, self._pair(rig, m), lateral_axis, perpendicular + shift)

    @staticmethod
    def _pair(rig: Rig, matches: Matches) -> Rig:
        return Rig(("first", "second"), (rig.cameras[matches.first], rig.cameras[matches.second]))

    def _triangulate_face(self, z: FloatArray, rig: Rig) -> list[FloatArray]:
        """Points of the matches on the face, shape (N, 3) each; they move with the parameters of the rig alone."""
        key = z[: self._rig_size].tobytes()
        if self._face_points[0] != key:
            found = [
                triangulate(np.stack([m.points_first, m.points_second]), self._pair(rig, m)) for m in self._face_matches
            ]
            self._face_points = (key, found)
        return self._face_points[1]

    def _compute_match_residuals(self, z: FloatArray) -> FloatArray:
        """Robust, weighted residuals of the matches of pairs of views."""
        parts = [np.empty(0)]
        for group, errors in list_epipolar_errors(self._pairs, self.rig(z)):
            std_px, factor = self.noise.spread(group.weight, group.matches.std_px)
            parts.append(bend(errors / std_px) * factor)
        return np.concatenate(parts)

    def _compute_shared_residuals(self, z: FloatArray) -> FloatArray:
        """Robust, weighted residuals of the points that three views or more see."""
        rig = self.rig(z)
        parts = [np.empty(0)]
        for group in self._shared:
            std_px, factor = self.noise.spread(group.weight)
            scaled = group.points.errors(rig) / std_px
            # All errors of a point are made smaller together where one of them is gross.
            size = np.linalg.norm(scaled, axis=1, keepdims=True)
            reach = ROBUST_STD**2 * group.points.constraints
            bent = np.sqrt(2 * reach * (np.sqrt(1 + size**2 / reach) - 1))
            robust = np.where(size > 0, scaled * bent / np.where(size > 0, size, 1.0), 0.0)
            known = np.isfinite(robust).all(axis=1, keepdims=True)
            parts.append((np.where(known, robust, OUTLIER) * factor[:, None]).ravel())
        return np.concatenate(parts)
