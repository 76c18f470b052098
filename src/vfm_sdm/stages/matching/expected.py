"""Where points are expected in a second view, from the cameras and the structure's face, with what is uncertain in it.

What all points share (cameras, face) and what each has of its own (how far it lies off the face) are kept apart: one
point that is found tells where the others are.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.stages.matching.epipolar import UNKNOWN_STD, camera_steps
from vfm_sdm.stages.matching.face import Face
from vfm_sdm.stages.matching.starts import TILTS

__all__ = ["FAR_OUTSIDE_PX", "Expected", "expect_anywhere", "expect_on_face"]

_MODEL_STD_PX = 1.0
"""What lens model and affine maps leave out, for each point by itself [px]."""
_MIDDLE_DEPTH = 6.0
"""Depth, in baselines, for which small planes are mapped where nothing else is known: angles of some ten degrees."""
_LEAST_AREA = 0.1
"""Area of a subset in the second view, over that in the first, below which they cannot be compared."""
FAR_OUTSIDE_PX = -1e6
"""Where a point is expected that the second camera cannot see [px]."""
_STEPS = np.zeros(2), np.array([1.0, 0.0])
_DEPTHS = 0.7, 2.0
"""Depths of a point that need not lie on the face, over the depth of the face on its viewing ray."""


@dataclass(frozen=True, eq=False)
class Expected:
    """Gaussian expectation of P points in a second view, before anything was looked for.

    Parameters
    ----------
    position
        Expected pixels, shape (P, 2) [px].
    shared
        Their change with K shared quantities of unit variance, shape (P, 2, K) [px].
    own
        Covariance of what each point has of its own, shape (P, 2, 2) [px2].
    maps
        Maps of offsets around each point to offsets in the second view, shape (W, 2, 2) each [1].
    relief
        Change of the position for a detail that stands off the face by as much as a pixel of the first view shows
        there, shape (P, 2) [1].
    """

    position: FloatArray
    shared: FloatArray
    own: FloatArray
    maps: tuple[FloatArray, ...]
    relief: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance of all positions together, shape (2 P, 2 P) [px2]."""
        rows = (
            self.shared.reshape(2 * len(self.position), -1)
            if self.shared.size
            else np.zeros((2 * len(self.position), 0))
        )
        return np.asarray(rows @ rows.T + block_diag(*self.own))


def expect_anywhere(points2d: FloatArray, rig: Rig, views: tuple[int, int]) -> Expected:
    """Maps of offsets around points of which nothing but the cameras is known; they are expected nowhere.

    Parameters
    ----------
    points2d
        Pixels in the first view, shape (P, 2) [px].
    rig
        Cameras; the scale does not matter.
    views
        Indices of the two views in the rig.
    """
    first, second = (rig.cameras[v] for v in views)
    count, depth = len(points2d), _MIDDLE_DEPTH * rig.baseline(*views)
    maps = []
    for point in points2d:
        place = (np.append(first.normalize(point), 1.0) * depth - first.translation) @ first.rotation
        normals = TILTS @ first.rotation
        made = [_map_of_plane(point, first, second, normal, normal @ place) for normal in normals]
        maps.append(np.stack([one for one in made if np.isfinite(one).all() and _is_map(one)] or [np.eye(2)]))
    nowhere = np.tile(np.nan * np.eye(2), (count, 1, 1))
    return Expected(
        np.full((count, 2), np.nan), np.zeros((count, 2, 0)), nowhere, tuple(maps), relief=np.zeros((count, 2))
    )


def expect_on_face(
    points2d: FloatArray, rig: Rig, views: tuple[int, int], face: Face, *, on_face: BoolArray
) -> Expected:
    """Where points of one view are expected in another.

    Parameters
    ----------
    points2d
        Pixels in the first view, shape (P, 2) [px].
    rig
        Cameras; without a covariance the expectation is wide in every direction.
    views
        Indices of the two views in the rig.
    face
        The structure's face.
    on_face
        Which points lie on it, shape (P,); the others lie anywhere near it on their viewing rays.

    Notes
    -----
    The derivatives are differences over the standard deviations of the parameters themselves, so that they hold over
    the range that matters.
    """
    first, second = (rig.cameras[v] for v in views)
    depth = face.distance_m * np.ones(len(points2d))
    position = _through_plane(points2d, first, second, face.frame.rotation[0], depth)
    shared = _shared_changes(points2d, rig, views, face)
    along = [
        (_through_plane(points2d, first, second, face.frame.rotation[0], depth + sign * face.offset_std_m))
        for sign in (-1, 1)
    ]
    half = np.where(on_face[:, None], (along[1] - along[0]) / 2, 0.0)
    relief = half / face.offset_std_m * _pixel_size(points2d, first, face)[:, None]
    for number in np.flatnonzero(~on_face):
        position[number], half[number] = _line_part(points2d[number], first, second, face)
    # What the second camera cannot see is expected where its picture is not.
    seen = np.isfinite(position).all(axis=1) & np.isfinite(half).all(axis=1) & np.isfinite(shared).all(axis=(1, 2))
    position[~seen], half[~seen], shared[~seen], relief[~seen] = FAR_OUTSIDE_PX, 0.0, 0.0, 0.0
    own = np.einsum("pi,pj->pij", half, half) + _MODEL_STD_PX**2 * np.eye(2)
    maps = tuple(
        _plane_maps(point, first, second, face, normals=1 if flat else 2)
        for point, flat in zip(points2d, on_face, strict=True)
    )
    return Expected(position, shared, own, maps, relief)


def _pixel_size(points2d: FloatArray, camera: Camera, face: Face) -> FloatArray:
    """What a pixel of a camera shows of something on the face that faces it, shape (P,) [unit of length a pixel]."""
    normal = face.frame.rotation[0]
    ones = np.ones((len(points2d), 1))
    beside = [np.concatenate([camera.normalize(points2d + step), ones], axis=1) for step in _STEPS]
    reach = (face.distance_m - normal @ camera.center) / (beside[0] @ camera.rotation @ normal)
    return np.asarray(np.abs(reach) * np.linalg.norm(beside[1] - beside[0], axis=1))


def _through_plane(
    points2d: FloatArray, first: Camera, second: Camera, normal: FloatArray, distance: FloatArray
) -> FloatArray:
    """Pixels (P, 2) in the second view of what the first sees on planes ``normal . X = distance``."""
    rays = np.concatenate([first.normalize(points2d), np.ones((len(points2d), 1))], axis=1) @ first.rotation
    reach = (distance - normal @ first.center) / (rays @ normal)
    ahead = np.where(reach > 0, reach, np.nan)
    return second.project(first.center + ahead[:, None] * rays)


def _shared_changes(points2d: FloatArray, rig: Rig, views: tuple[int, int], face: Face) -> FloatArray:
    """Change of the expected pixels with every shared quantity of unit variance, (P, 2, K) [px]."""
    size = len(CAMERA_PARAMETERS)
    both = Rig(tuple(rig.names[v] for v in views), tuple(rig.cameras[v] for v in views))
    steps = [(np.concatenate([step, np.zeros(4)]), length) for step, length in camera_steps(rig, views)]
    variances, axes = np.linalg.eigh(face.frame.covariance)
    for variance, axis in zip(variances, axes.T, strict=True):
        if variance > 0:
            steps.append((np.concatenate([np.zeros(2 * size), np.sqrt(variance) * axis, [0.0]]), 1.0))
    steps.append((np.append(np.zeros(2 * size + 3), face.distance_std_m), 1.0))

    def moved(step: FloatArray) -> FloatArray:
        one, other = both.perturbed(step[: 2 * size]).cameras
        turned = Rotation.from_rotvec(step[2 * size : 2 * size + 3]).as_matrix() @ face.frame.rotation
        return _through_plane(points2d, one, other, turned[0], np.full(len(points2d), face.distance_m + step[-1]))

    changes = [(moved(step) - moved(-step)) / (2 * length) for step, length in steps]
    if rig.covariance is None:
        spread = UNKNOWN_STD * rig.cameras[views[1]].image_size[0]
        changes += [np.tile(spread * axis, (len(points2d), 1)) for axis in np.eye(2)]
    return np.stack(changes, axis=-1) if changes else np.zeros((len(points2d), 2, 0))


def _line_part(point: FloatArray, first: Camera, second: Camera, face: Face) -> tuple[FloatArray, FloatArray]:
    """Middle of the epipolar line (2,) between the depths in question, and half its length as a vector (2,) [px]."""
    normal = face.frame.rotation[0]
    ray = np.append(first.normalize(point), 1.0) @ first.rotation
    reach = (face.distance_m - normal @ first.center) / (ray @ normal)
    ends = second.project(first.center + reach * np.array(_DEPTHS)[:, None] * ray)
    return ends.mean(axis=0), (ends[1] - ends[0]) / 2


def _plane_maps(point: FloatArray, first: Camera, second: Camera, face: Face, *, normals: int) -> FloatArray:
    """Maps of offsets through planes across the lateral axis and, where asked for, the longitudinal one, (W, 2, 2)."""
    axes = face.frame.rotation[[0, 2][:normals]]
    ray = np.append(first.normalize(point), 1.0) @ first.rotation
    reach = (face.distance_m - face.frame.rotation[0] @ first.center) / (ray @ face.frame.rotation[0])
    place = first.center + reach * ray
    made = [_map_of_plane(point, first, second, axis, axis @ place) for axis in axes]
    return np.stack([one for one in made if np.isfinite(one).all() and _is_map(one)] or [np.eye(2)])


def _map_of_plane(point: FloatArray, first: Camera, second: Camera, normal: FloatArray, distance: float) -> FloatArray:
    beside = point + np.concatenate([np.eye(2), -np.eye(2)])
    seen = _through_plane(beside, first, second, normal, np.full(4, distance))
    return np.asarray((seen[:2] - seen[2:]).T / 2)


def _is_map(affine: FloatArray) -> bool:
    """Whether a map of offsets neither squeezes a subset flat nor blows it up."""
    return bool(_LEAST_AREA < abs(np.linalg.det(affine)) < 1 / _LEAST_AREA)
