"""Places where a point may be in a second view: from the matches around it, and from the depths on its viewing ray."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import in_front_of_all, triangulate
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.registration.records import Starts

__all__ = [
    "TILTS",
    "Hypotheses",
    "find_depth_range",
    "join",
    "keep_inside",
    "starts_from_depths",
    "starts_from_matches",
]

_NEIGHBOURS = 24
_MAX_EPIPOLAR_STEP_PX = 4.0
"""Distance between tried depths along the epipolar line: inside the reach of the sub-pixel registration."""
_MAX_HYPOTHESES = 400
TILTS = np.array([[np.sin(t), 0.0, np.cos(t)] for t in np.radians([0.0, -50.0, 50.0, -70.0, 70.0])])
"""Normals of the small planes that are tried, in the first camera's frame: turned about its vertical."""


@dataclass(frozen=True, eq=False)
class Hypotheses(Starts):
    """Places to try in the second view.

    Parameters
    ----------
    position
        Positions, shape (H, 2) [px].
    affine
        Maps from offsets in the first view to offsets in the second one, shape (H, 2, 2) [1].
    """

    position: FloatArray
    affine: FloatArray


def starts_from_matches(point: FloatArray, matches: Matches) -> Hypotheses:
    """Affine maps fitted to the nearest matches, for a few sizes of the neighbourhood.

    Parameters
    ----------
    point
        Place in the first view, shape (2,) [px].
    matches
        Feature matches between the two views [px].
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
    return Hypotheses(np.array(positions).reshape(-1, 2), np.array(affines).reshape(-1, 2, 2))


def find_depth_range(rig: Rig, matches: Matches) -> tuple[float, float]:
    """Nearest and farthest depth to try: what the matches span, widened; else what the rig sees.

    Parameters
    ----------
    rig
        Approximate cameras.
    matches
        Feature matches between two of its views [px].

    Returns
    -------
    near, far
        Depths in the first of the two cameras, in the rig's unit of length.
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


def starts_from_depths(
    point: FloatArray, first: Camera, second: Camera, depths: tuple[float, float], normals: FloatArray
) -> Hypotheses:
    """Points on the viewing ray, equally spaced along the epipolar line, each as small planes.

    Parameters
    ----------
    point
        Place in the first view, shape (2,) [px].
    first, second
        Cameras of the two views.
    depths
        Nearest and farthest depth in the first camera, in the rig's unit of length.
    normals
        Normals of the planes in the first camera's frame, shape (N, 3).
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
        return Hypotheses(np.empty((0, 2)), np.empty((0, 2, 2)))
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = int(np.clip(np.ceil(travelled[-1] / _MAX_EPIPOLAR_STEP_PX), 2, _MAX_HYPOTHESES))
    tried = 1 / np.interp(np.linspace(0, travelled[-1], count), travelled, inverse)
    positions = pixel(tried)
    everything = [Hypotheses(positions, _plane_maps(point, first, second, tried, n)) for n in normals]
    return join(*everything)


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


def join(*parts: Hypotheses) -> Hypotheses:
    """Several sets of places as one."""
    return Hypotheses(np.concatenate([p.position for p in parts]), np.concatenate([p.affine for p in parts]))


def keep_inside(hypotheses: Hypotheses, image: LumaArray, subset_px: int) -> Hypotheses:
    """Those hypotheses whose subset lies inside the image and is neither squeezed flat nor blown up.

    Parameters
    ----------
    hypotheses
        Places to try.
    image
        The second view, shape (H, W).
    subset_px
        Side of the subset [px].
    """
    height, width = image.shape
    margin = subset_px // 2 + 2
    position = hypotheses.position
    inside = ((position >= margin) & (position <= [width - 1 - margin, height - 1 - margin])).all(axis=1)
    # Planes tilted out of a camera's sight have no map at all.
    defined = np.asarray(np.isfinite(hypotheses.affine).all(axis=(1, 2)))
    area = np.abs(np.linalg.det(np.where(defined[:, None, None], hypotheses.affine, 0.0)))
    kept = inside & (area > 0.1) & (area < 10)
    return Hypotheses(position[kept], hypotheses.affine[kept])
