"""Observation equations of the site adjustment: parameters, priors and residuals."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky

from vfm_sdm.core.arrays import FloatArray, IntArray, as_float_array
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.structure_frame import compute_view_angle, structure_from_cam1
from vfm_sdm.geometry.triangulation import sampson_error, triangulate
from vfm_sdm.inputs.session import Site
from vfm_sdm.stages.cameras.shared_points import SharedPoints, chain_matches
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["DISTANCE", "MATCH_STD_PX", "AdjustedValue", "SiteProblem"]

DISTANCE = "distance"
"""First word of the quantities that say how far third and further cameras stand from the reference."""
MATCH_STD_PX = 0.25
"""Least standard deviation of what a cell of matches says about the epipolar geometry [px]: feature localisation plus
what the camera model leaves out, which neighbours share. Larger when the residuals say so."""
_CELLS = 6
"""Cells a side of the grid over an image; matches of one cell count together as one observation."""
_MATCHES_PER_CELL = 12
_POSE_PARAMETERS = 7
"""What a pair of views is described by at most, by its epipolar geometry."""
_RIGS_KEPT = 64
_ROBUST_STD = 3.0
_OUTLIER = 1e3
_POINT_STD_PX = 0.5
_UNSTATED_LEVEL_STD = np.radians(1.0)
"""Pitch and roll where nothing was said about a spirit level: a tripod head set by eye."""


@dataclass(frozen=True)
class AdjustedValue:
    """A quantity at some parameters, with its prior or measured value."""

    name: str
    units: str
    prior: float
    prior_std: float
    value: float
    measured: bool = False


@dataclass(frozen=True, eq=False)
class _CellMatches:
    """Matches, the weight of each, and the cell of the image that it lies in, shape (N,) each."""

    matches: Matches
    weight: FloatArray
    cell: IntArray


@dataclass(frozen=True, eq=False)
class _CellPoints:
    """Points of several views, the weight of each, and the cell of the first image that it lies in, shape (N,) each."""

    points: SharedPoints
    weight: FloatArray
    cell: IntArray


class SiteProblem:
    """Whitened parameters, each with a standard normal prior, and the residuals of everything that was measured.

    Parameters
    ----------
    rig, matches, site, points, face_points, levels
        As in `vfm_sdm.stages.cameras.site.adjust_to_site`.

    Notes
    -----
    Parameters: the rig's (reference pose fixed); pitch and roll of the reference camera; perpendicular and
    longitudinal distance; the common offset of points from the face; pixel errors of the named points in use.

    Matches: the residual of match ``i`` is its Sampson error over ``match_std_px * sqrt(n)``, with ``n`` the matches
    in its cell of a 6 x 6 grid over the image, so a cell weighs as one observation however many matches it holds.
    Points that three views or more see have the reprojection errors of all their pixels as residuals, over the same
    standard deviation: beside what their epipolar lines say, they hold the distances of cameras that stand in a row.
    Independent weights would let thousands of correlated errors overrule the lens prior: on the real pair
    ``multidic_cylinder`` that gave 73 % too much displacement with a residual of 0.2 px.
    """

    def __init__(
        self,
        rig: Rig,
        matches: Sequence[Matches],
        site: Site,
        points: Mapping[str, FloatArray],
        *,
        face_points: Iterable[str] = (),
        levels: Mapping[str, tuple[float, float, float]],
    ) -> None:
        if rig.covariance is None:
            raise CameraError("site adjustment: expected a rig with a prior covariance, got none; state the priors")
        self._start = rig
        self._rigs: dict[bytes, Rig] = {}
        self._site = site
        self._levels = dict(levels)
        self._face = [name for name in face_points if name in points]
        self.has_axes = site.perpendicular_distance is not None and site.longitudinal_distance is not None
        self._points = {name: as_float_array(points[name], f"point {name!r}", (len(rig), 2)) for name in points}
        self._used = self._points_in_use()
        self._cells = [_group_by_cell(m, rig.cameras[m.first].image_size) for m in matches if len(m.points_first)]
        pairs, shared = chain_matches(matches)
        self._pairs = [_group_by_cell(m, rig.cameras[m.first].image_size) for m in pairs if len(m.points_first)]
        self._shared = [_group_points_by_cell(points, rig.cameras[points.views[0]].image_size) for points in shared]
        self.match_std_px = MATCH_STD_PX
        self._factor = _prior_factor(rig.covariance)
        self._rig_size = self._factor.shape[1]
        self._extra_prior, self._extra_std = self._extra_parameters()
        self.size = self._rig_size + self._extra_std.size + 2 * len(rig) * len(self._used)
        self.notes: list[str] = []
        if self.has_axes and site.reference_camera_level is None:
            self.notes.append("no level reading of the reference camera: pitch and roll taken as 0 +- 1 degree")

    def rig(self, z: FloatArray) -> Rig:
        """The rig at whitened parameters ``z``."""
        # Making one costs as much as all residuals, and derivatives ask for the same ones again and again.
        inner = z[: self._rig_size]
        key = inner.tobytes()
        if key not in self._rigs:
            if len(self._rigs) >= _RIGS_KEPT:
                self._rigs.clear()
            self._rigs[key] = self._start.perturbed(self._factor @ inner)
        return self._rigs[key]

    def structure_rotation(self, z: FloatArray) -> FloatArray:
        """``structure_from_cam1`` at ``z``, shape (3, 3); the level frame of the camera when no axes are asked for."""
        pitch, roll, perpendicular, longitudinal, _ = self._extra(z)
        if not self.has_axes:
            return np.eye(3)
        camera = self.rig(z).cameras[0]
        # The distances tell where the image centre looks, which differs from the optical axis by the principal point.
        centre = (camera.image_size[0] - 1) / 2
        aside = np.arctan((centre - camera.K[0, 2]) / camera.K[0, 0])
        sign = 1.0 if self._site.structure_side == "right" else -1.0
        angle = compute_view_angle(perpendicular, longitudinal) - sign * aside
        return structure_from_cam1(angle, pitch_rad=pitch, roll_rad=roll, side=self._site.structure_side)

    def residuals(self, z: FloatArray) -> FloatArray:
        """All whitened residuals: priors, matches, lengths."""
        matches = [self._match_residuals(z), self._shared_residuals(z)]
        return np.concatenate([z, *matches, self._length_residuals(z)])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Derivative of `residuals` by differences; only the rig's parameters move the matches."""
        matches = [_difference(self._match_residuals, z, self._rig_size)]
        if self._shared:
            matches.append(_central_difference(self._shared_residuals, z, self._rig_size))
        padded = np.pad(np.concatenate(matches), ((0, 0), (0, self.size - self._rig_size)))
        return np.concatenate([np.eye(self.size), padded, _difference(self._length_residuals, z, self.size)])

    def quantities(self, z: FloatArray) -> list[AdjustedValue]:
        """What a user wants to see adjusted, at ``z``."""
        rig = self.rig(z)
        covariance = np.asarray(self._start.covariance)
        values = []
        for index, (name, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
            start = self._start.cameras[index]
            std = np.sqrt(np.diag(covariance))[len(CAMERA_PARAMETERS) * index :][:4]
            rows = (
                ("focal", "px", start.focal_px, std[0] * start.focal_px, camera.focal_px),
                ("principal point u", "px", start.K[0, 2], std[1], camera.K[0, 2]),
                ("principal point v", "px", start.K[1, 2], std[2], camera.K[1, 2]),
                ("distortion k1", "1", start.distortion[0], std[3], camera.distortion[0]),
            )
            values += [AdjustedValue(f"{what} {name}", unit, p, s, v) for what, unit, p, s, v in rows if s > 0]
        values += self._further_distances(rig)
        values += self._measured(z, rig, self._points3d(z, rig))
        extra = self._extra(z)
        for index, name in enumerate(("pitch reference camera", "roll reference camera")):
            prior, std = np.degrees([self._extra_prior[index], self._extra_std[index]])
            if self.has_axes:
                values.append(AdjustedValue(name, "deg", prior, std, float(np.degrees(extra[index])), True))
        for index, name in ((2, "perpendicular distance"), (3, "longitudinal distance")):
            if self.has_axes:
                prior, std = self._extra_prior[index], self._extra_std[index]
                values.append(AdjustedValue(name, "m", prior, std, float(extra[index]), True))
        return values

    def epipolar_rms(self, z: FloatArray) -> float:
        """Root mean square epipolar error of the matches [px]; NaN without matches."""
        rig = self.rig(z)
        errors = [_epipolar_error(group.matches, rig) for group in self._cells]
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")

    def cell_rms(self, z: FloatArray) -> float:
        """Root mean square over the cells of each cell's mean epipolar error [px]: the errors that neighbours share.

        Corrected for the parameters that were fitted; NaN with hardly more cells than those.
        """
        rig = self.rig(z)
        squares, free = 0.0, -_POSE_PARAMETERS * (len(rig) - 1)
        for group in self._pairs:
            error = _epipolar_error(group.matches, rig)
            means = [float(np.median(error[group.cell == cell])) for cell in np.unique(group.cell)]
            squares, free = squares + float(np.sum(np.square(means))), free + len(means)
        for shared in self._shared:
            errors = shared.points.errors(rig)
            shifts = [np.nanmedian(errors[shared.cell == cell], axis=0) for cell in np.unique(shared.cell)]
            squares += float(np.sum(np.square(shifts)))
            free += shared.points.constraints * len(shifts)
        return float(np.sqrt(squares / free)) if free > _POSE_PARAMETERS else float("nan")

    def _further_distances(self, rig: Rig) -> list[AdjustedValue]:
        """Distances of the third and further cameras from the reference; that of the second is the baseline."""
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

    def _points_in_use(self) -> list[str]:
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

    def _extra_parameters(self) -> tuple[FloatArray, FloatArray]:
        """Prior values and standard deviations of pitch, roll, perpendicular, longitudinal, face offset."""
        level = self._site.reference_camera_level
        pitch, roll, std = (0.0, 0.0, _UNSTATED_LEVEL_STD)
        if level is not None:
            pitch, roll, std = np.radians([level.pitch, level.roll, level.std_deg])
        across, along = self._site.perpendicular_distance, self._site.longitudinal_distance
        if across is None or along is None:
            return np.array([pitch, roll, 1.0, 1.0, 0.0]), np.array([std, std, 0.0, 0.0, 0.0])
        return (
            np.array([pitch, roll, across.value, along.value, 0.0]),
            np.array([std, std, across.std, along.std, self._site.face_offset_std]),
        )

    def _extra(self, z: FloatArray) -> FloatArray:
        part = z[self._rig_size : self._rig_size + self._extra_std.size]
        return np.asarray(self._extra_prior + self._extra_std * part)

    def _points3d(self, z: FloatArray, rig: Rig) -> dict[str, FloatArray]:
        """The named points in the reference camera's frame, their pixels moved by their error parameters."""
        if not self._used:
            return {}
        shift = _POINT_STD_PX * z[self._rig_size + self._extra_std.size :].reshape(len(self._used), len(rig), 2)
        pixels = np.stack([self._points[name] for name in self._used]) + shift
        return dict(zip(self._used, triangulate(pixels.swapaxes(0, 1), rig), strict=True))

    def _measured(self, z: FloatArray, rig: Rig, points: Mapping[str, FloatArray]) -> list[AdjustedValue]:
        """Baseline, ranges, lengths and level readings beside what the parameters say."""
        values = []
        if self._site.baseline is not None:
            b = self._site.baseline
            values.append(AdjustedValue("baseline", "m", b.value, b.std, rig.baseline(), True))
        for r in self._site.range:
            view = r.view or rig.names[0]
            distance = np.linalg.norm(points[r.point] - rig.camera(view).center)
            values.append(AdjustedValue(f"range {view} to {r.point}", "m", r.value, r.std, float(distance), True))
        for s in self._site.length:
            first, second = (points[name] for name in s.points)
            name = f"length {s.points[0]} to {s.points[1]}"
            values.append(AdjustedValue(name, "m", s.value, s.std, float(np.linalg.norm(first - second)), True))
        pitch, roll = self._extra(z)[:2]
        level_from_cam1 = structure_from_cam1(0.0, pitch_rad=pitch, roll_rad=roll)
        for view, (view_pitch, view_roll, std) in self._levels.items():
            axes = level_from_cam1 @ rig.camera(view).rotation.T
            tilt = -np.arcsin(axes[1, 2]) - view_pitch
            turn = np.arctan2(axes[1, 0], axes[1, 1]) - view_roll
            for name, prior, off in (("pitch", view_pitch, tilt), ("roll", view_roll, turn)):
                prior_deg, std_deg, off_deg = np.degrees([prior, std, off])
                values.append(AdjustedValue(f"{name} {view}", "deg", prior_deg, std_deg, prior_deg + off_deg, True))
        return values

    def _length_residuals(self, z: FloatArray) -> FloatArray:
        rig = self.rig(z)
        points = self._points3d(z, rig)
        measured = [(q.value - q.prior) / q.prior_std for q in self._measured(z, rig, points)]
        return np.concatenate([np.asarray(measured, dtype=np.float64), self._face_residuals(z, points)])

    def _face_residuals(self, z: FloatArray, points: Mapping[str, FloatArray]) -> FloatArray:
        """Lateral coordinate of points on the face against the perpendicular distance."""
        if not (self.has_axes and self._face):
            return np.empty(0)
        lateral_axis = self.structure_rotation(z)[0]
        _, _, perpendicular, _, offset = self._extra(z)
        lateral = np.array([points[name] @ lateral_axis for name in self._face])
        return np.asarray((lateral - perpendicular - offset) / self._site.face_offset_std)

    def _match_residuals(self, z: FloatArray) -> FloatArray:
        rig = self.rig(z)
        parts = [np.empty(0)]
        for group in self._pairs:
            error = _epipolar_error(group.matches, rig)
            # Pseudo-Huber: quadratic near zero, linear beyond three standard deviations, smooth in between.
            # A trial step may bend the lens so far that a pixel has no ray: as bad as a gross outlier.
            scaled = np.where(np.isfinite(error), error / self.match_std_px, _OUTLIER)
            reach = _ROBUST_STD**2
            parts.append(np.sign(scaled) * np.sqrt(2 * reach * (np.sqrt(1 + scaled**2 / reach) - 1)) * group.weight)
        return np.concatenate(parts)

    def _shared_residuals(self, z: FloatArray) -> FloatArray:
        rig = self.rig(z)
        parts = [np.empty(0)]
        for group in self._shared:
            scaled = group.points.errors(rig) / self.match_std_px
            # All errors of a point are made smaller together where one of them is gross.
            size = np.linalg.norm(scaled, axis=1, keepdims=True)
            reach = _ROBUST_STD**2 * group.points.constraints
            bent = np.sqrt(2 * reach * (np.sqrt(1 + size**2 / reach) - 1))
            robust = np.where(size > 0, scaled * bent / np.where(size > 0, size, 1.0), 0.0)
            known = np.isfinite(robust).all(axis=1, keepdims=True)
            parts.append((np.where(known, robust, _OUTLIER) * group.weight[:, None]).ravel())
        return np.concatenate(parts)


def _difference(function: Callable[[FloatArray], FloatArray], z: FloatArray, count: int) -> FloatArray:
    """Derivative with respect to the first ``count`` parameters, shape (residuals, count).

    Forward differences. The step is small, because priors of the pose are wide: at a millionth of them the curvature
    of the residuals ends the iterations too early.
    """
    step = 1e-8
    base = function(z)
    columns = [np.empty((base.size, 0))]
    for index in range(count):
        shift = np.zeros_like(z)
        shift[index] = step
        columns.append((function(z + shift) - base)[:, None] / step)
    return np.concatenate(columns, axis=1)


def _central_difference(function: Callable[[FloatArray], FloatArray], z: FloatArray, count: int) -> FloatArray:
    """The same of residuals that go through a triangulation, whose rounding asks for a longer step."""
    step = 1e-6
    return np.stack(
        [(function(z + shift) - function(z - shift)) / (2 * step) for shift in step * np.eye(z.size)[:count]], axis=1
    )


def _prior_factor(covariance: FloatArray) -> FloatArray:
    """Factor L with ``covariance = L L^T``, without the columns of parameters that are held fixed."""
    free = np.flatnonzero(np.diag(covariance) > 0)
    factor = np.zeros((covariance.shape[0], free.size))
    if free.size:
        scale = np.sqrt(np.diag(covariance)[free])
        correlation = covariance[np.ix_(free, free)] / np.outer(scale, scale)
        # A prior that comes from an earlier adjustment may be singular to rounding.
        lower = cholesky(correlation + 1e-12 * np.eye(free.size), lower=True)
        factor[free] = scale[:, None] * lower
    return factor


def _epipolar_error(m: Matches, rig: Rig) -> FloatArray:
    return sampson_error(m.points_first, m.points_second, rig, first=m.first, second=m.second)


def _group_by_cell(matches: Matches, image_size: tuple[int, int]) -> _CellMatches:
    """A thinned set of matches in which every cell of the first image counts as one observation."""
    chosen, weight, cell = _thin_by_cell(matches.points_first, image_size)
    thinned = Matches(matches.first, matches.second, matches.points_first[chosen], matches.points_second[chosen])
    return _CellMatches(thinned, weight, cell)


def _group_points_by_cell(points: SharedPoints, image_size: tuple[int, int]) -> _CellPoints:
    """The same of points that several views see."""
    chosen, weight, cell = _thin_by_cell(points.pixels[0], image_size)
    return _CellPoints(points.thinned(chosen), weight, cell)


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
