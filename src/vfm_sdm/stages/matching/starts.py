"""Places in another view at which a point's registration starts: by neighbouring matches, along its viewing ray."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import in_front_of_all, triangulate
from vfm_sdm.stages.matching.matches import Matches

__all__ = [
    "Starts",
    "Surface",
    "find_depth_range",
    "join_starts",
    "keep_inside",
    "propose_by_depths",
    "propose_by_matches",
]

_NEIGHBOURS = 24
_MAX_EPIPOLAR_STEP_PX = 4.0
"""Distance between tried depths along the epipolar line: inside the reach of the sub-pixel registration."""
_MAX_STARTS = 400
_SURFACE_STD = 3.0
"""Standard deviations that a point may lie off a known surface."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A plane that points lie on: ``normal . X = distance`` in the rig's world frame.

    Parameters
    ----------
    normal
        Unit vector, shape (3,).
    distance
        From the origin, in the rig's unit of length.
    std
        Standard deviation of how far points lie off it, same unit.
    """

    normal: FloatArray
    distance: float
    std: float

    def depths(self, ray: FloatArray, camera: Camera) -> tuple[float, float]:
        """Nearest and farthest depth in a camera at which a ray (3,) meets it, three standard deviations each way."""
        inwards, offset = self.in_camera(camera)
        reach = np.array([-_SURFACE_STD, _SURFACE_STD]) * self.std
        near, far = sorted((offset + reach) / (inwards @ ray))
        return float(near), float(far)

    def in_camera(self, camera: Camera) -> tuple[FloatArray, float]:
        """Normal and distance in a camera's frame."""
        inwards = camera.rotation @ self.normal
        return inwards, float(self.distance + inwards @ camera.translation)


@dataclass(frozen=True, eq=False)
class Starts:
    """Places to start from in the second view.

    Parameters
    ----------
    position
        Where the point may be, shape (H, 2) [px].
    affine
        Map of offsets about the point in the first view to those in the second, shape (H, 2, 2) [1].
    """

    position: FloatArray
    affine: FloatArray


def propose_by_matches(point: FloatArray, matches: Matches) -> Starts:
    """Starts by affine maps fitted to the nearest matches, one for each of a few sizes of the neighbourhood.

    Parameters
    ----------
    point
        The point in the first view, shape (2,) [px].
    matches
        Feature matches between the two views; none give no starts.
    """
    count = len(matches.points_first)
    positions, affines = [], []
    if count >= 4:
        order = cKDTree(matches.points_first).query(point, k=min(count, _NEIGHBOURS))[1]
        for size in (4, 8, 16, _NEIGHBOURS):
            chosen = np.atleast_1d(order)[:size]
            if chosen.size < min(size, 4):
                continue
            offsets = matches.points_first[chosen] - point
            design = np.column_stack([np.ones(chosen.size), offsets])
            if np.linalg.matrix_rank(design, tol=1e-3) < 3:
                continue
            # Median-like weights in three rounds: one wrong match among the neighbours must not carry the map away.
            weight = np.ones(chosen.size)
            for _ in range(3):
                solution = np.linalg.lstsq(
                    design * weight[:, None], matches.points_second[chosen] * weight[:, None], rcond=None
                )[0]
                residual = np.linalg.norm(design @ solution - matches.points_second[chosen], axis=1)
                weight = 1 / np.sqrt(1 + (residual / (np.median(residual) + 0.5)) ** 2)
            positions.append(solution[0])
            affines.append(solution[1:].T)
    return Starts(np.array(positions).reshape(-1, 2), np.array(affines).reshape(-1, 2, 2))


def find_depth_range(rig: Rig, matches: Matches) -> tuple[float, float]:
    """Nearest and farthest depth to try: what the matches span, widened; else what the rig sees.

    Parameters
    ----------
    rig
        Approximate cameras.
    matches
        Feature matches between two of its views.

    Returns
    -------
    near, far
        Depths in the first camera of the matches, in the rig's unit of length.
    """
    baseline = float(np.linalg.norm(rig.cameras[matches.first].center - rig.cameras[matches.second].center))
    pair = Rig(("a", "b"), (rig.cameras[matches.first], rig.cameras[matches.second]))
    points3d = triangulate(np.stack([matches.points_first, matches.points_second]), pair)
    camera = pair.cameras[0]
    depth = (points3d @ camera.rotation.T + camera.translation)[in_front_of_all(points3d, pair), 2]
    if depth.size < 8:
        return baseline, 50 * baseline
    near, far = np.percentile(depth, [2, 98])
    return 0.7 * float(near), 1.5 * float(far)


def propose_by_depths(
    point: FloatArray, first: Camera, second: Camera, depths: tuple[float, float], normals: FloatArray
) -> Starts:
    """Starts at points on the viewing ray, equally spaced along the epipolar line, each as small planes.

    Parameters
    ----------
    point
        The point in the first view, shape (2,) [px].
    first, second
        Cameras of the two views.
    depths
        Nearest and farthest depth in the first camera, in the rig's unit of length.
    normals
        Normals of the planes in the first camera's frame, shape (N, 3) [1].
    """
    ray = np.append(first.normalize(point), 1.0)

    def pixel(depth: FloatArray) -> FloatArray:
        world = (depth[:, None] * ray - first.translation) @ first.rotation
        return second.project(world)

    inverse = np.linspace(1 / depths[0], 1 / depths[1], 2000)
    line = pixel(1 / inverse)
    visible = np.isfinite(line).all(axis=1)
    inverse, line = inverse[visible], line[visible]
    if len(line) < 2:
        return Starts(np.empty((0, 2)), np.empty((0, 2, 2)))
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = int(np.clip(np.ceil(travelled[-1] / _MAX_EPIPOLAR_STEP_PX), 2, _MAX_STARTS))
    tried = 1 / np.interp(np.linspace(0, travelled[-1], count), travelled, inverse)
    positions = pixel(tried)
    everything = [Starts(positions, _plane_maps(point, first, second, tried, n)) for n in normals]
    return join_starts(*everything)


def _plane_maps(point: FloatArray, first: Camera, second: Camera, depths: FloatArray, normal: FloatArray) -> FloatArray:
    """Affine maps of offsets from the first to the second image through planes at depths on the point's ray."""
    ray = np.append(first.normalize(point), 1.0)
    columns = []
    for axis in range(2):
        moved = []
        for sign in (1.0, -1.0):
            beside = np.append(first.normalize(point + sign * np.eye(2)[axis]), 1.0)
            depth = depths * (ray @ normal) / (beside @ normal)
            moved.append(second.project((depth[:, None] * beside - first.translation) @ first.rotation))
        columns.append((moved[0] - moved[1]) / 2)
    return np.stack(columns, axis=-1)


def join_starts(*parts: Starts) -> Starts:
    """All starts of several, one after the other."""
    return Starts(np.concatenate([p.position for p in parts]), np.concatenate([p.affine for p in parts]))


def keep_inside(starts: Starts, image: LumaArray, subset_px: int) -> Starts:
    """Those starts whose subset lies inside the image and is neither squeezed flat nor blown up.

    Parameters
    ----------
    starts
        Starts in the second view.
    image
        Frame of the second view, shape (H, W).
    subset_px
        Side of the subset in the first view [px].
    """
    height, width = image.shape
    margin = subset_px // 2 + 2
    position = starts.position
    inside = ((position >= margin) & (position <= [width - 1 - margin, height - 1 - margin])).all(axis=1)
    # Planes tilted out of a camera's sight have no map at all.
    defined = np.asarray(np.isfinite(starts.affine).all(axis=(1, 2)))
    area = np.abs(np.linalg.det(np.where(defined[:, None, None], starts.affine, 0.0)))
    kept = inside & (area > 0.1) & (area < 10)
    return Starts(position[kept], starts.affine[kept])
