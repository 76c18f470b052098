"""Pose of a camera a frame by exact perspective: rotation and translation of any size, from points that stand still."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.distortion import distort
from vfm_sdm.stages.camera_motion.estimation import jacobian_in_camera

__all__ = ["FEWEST_STATIC", "Poses", "StaticView", "find_poses", "look_from"]

FEWEST_STATIC = 3
"""Points whose pixels determine six numbers."""
_SPREAD = np.repeat([0.2, 1.0], 3)
"""Standard deviations of rotation [rad] and translation [m] before anything is seen: a prior that decides nothing where
points decide, and keeps what they leave open finite."""
_STEPS = 12
_RESTARTS = 6
_ENDED_PX = 1e-5
_LONGEST_STEP = 0.3
"""Longest rotation [rad] of a step; beyond, pixels say little of what a pose does to them."""


@dataclass(frozen=True, eq=False)
class StaticView:
    """What a camera sees of S static points in T frames.

    Parameters
    ----------
    camera
        Its lens; its pose does not count.
    X
        The points in the axes of the camera at rest, shape (S, 3) [m].
    position
        Their pixels, shape (T, S, 2) [px]; NaN where missing.
    weight
        Inverse covariance of these, shape (T, S, 2, 2) [1/px2]; any where missing.
    """

    camera: Camera
    X: FloatArray
    position: FloatArray
    weight: FloatArray

    @property
    def seen(self) -> BoolArray:
        """Which are seen, shape (T, S)."""
        return np.asarray(np.isfinite(self.position).all(axis=-1))

    def of(self, rows: IntArray | slice) -> "StaticView":
        """The same of some frames."""
        return replace(self, position=self.position[rows], weight=self.weight[rows])

    def without(self, point: int) -> "StaticView":
        """The same without one of the points."""
        kept = np.arange(len(self.X)) != point
        return StaticView(self.camera, self.X[kept], self.position[:, kept], self.weight[:, kept])


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a camera in T frames: what is at X in its axes at rest is at ``R X + s``.

    Parameters
    ----------
    rotation
        R, shape (T, 3, 3) [1].
    translation
        s, shape (T, 3) [m].
    covariance
        Of a small rotation after R, and of the translation then, shape (T, 6, 6) [rad2, rad m, m2].
    found
        Frames in which enough points are seen and the solution came to its end, shape (T,).
    """

    rotation: FloatArray
    translation: FloatArray
    covariance: FloatArray
    found: BoolArray

    @classmethod
    def at_rest(cls, frames: int) -> "Poses":
        """Poses of a camera that does not move, of which nothing was found."""
        nothing = np.zeros(frames, np.bool_)
        rotation, covariance = np.tile(np.eye(3), (frames, 1, 1)), np.tile(np.diag(_SPREAD**2), (frames, 1, 1))
        return cls(rotation, np.zeros((frames, 3)), covariance, nothing)

    def of(self, rows: IntArray | slice) -> "Poses":
        """Those of some frames."""
        return Poses(self.rotation[rows], self.translation[rows], self.covariance[rows], self.found[rows])

    @classmethod
    def joined(cls, parts: Sequence["Poses"]) -> "Poses":
        """Those of parts of a recording that follow each other."""
        return cls(
            np.concatenate([one.rotation for one in parts]),
            np.concatenate([one.translation for one in parts]),
            np.concatenate([one.covariance for one in parts]),
            np.concatenate([one.found for one in parts]),
        )

    def put(self, rows: IntArray, other: "Poses") -> "Poses":
        """With others in some frames."""
        order = np.arange(len(self.found))
        order[rows] = len(self.found) + np.arange(len(rows))
        return Poses.joined([self, other]).of(order)

    def moved(self, X: FloatArray) -> FloatArray:
        """Points (..., P, 3) [m] in the axes of the moved camera, shape (T, P, 3) [m]."""
        return np.asarray(np.einsum("tij,...pj->tpi", self.rotation, X) + self.translation[:, None])

    @property
    def rotation_vector(self) -> FloatArray:
        """Shape (T, 3) [rad]."""
        return np.asarray(Rotation.from_matrix(self.rotation).as_rotvec().reshape(-1, 3))


def look_from(camera: Camera, X: FloatArray) -> FloatArray:
    """Pixels of points in the camera's own axes.

    Parameters
    ----------
    camera
        Its lens; its pose does not count.
    X
        Shape (..., 3) [m].

    Returns
    -------
    points2d
        Shape (..., 2) [px]; NaN behind the camera.

    Examples
    --------
    >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
    >>> look_from(camera, np.array([0.1, 0.0, 2.0])).tolist()
    [370.0, 240.0]
    """
    depth = np.where(X[..., 2:] > 0, X[..., 2:], np.nan)
    return camera.pixels(distort(X[..., :2] / depth, camera.distortion))


def find_poses(view: StaticView, start: Poses | None = None) -> Poses:
    """Poses that explain the pixels of static points, frame by frame, by non-linear least squares.

    Parameters
    ----------
    view
        The static points.
    start
        Poses to start from; at rest when left out.

    Notes
    -----
    Gauss-Newton on the exact perspective: rotation vectors of any size, and the lens with its distortion. All frames
    start together; those that come to no end start again from the nearest frame that did, so that a camera may wander
    far from where it began. Rotations and translations have a weak prior about the rest (11 degrees, 1 m): where points
    leave a direction of the pose open, the covariance says so.

    Examples
    --------
    >>> camera = Camera(np.array([[3000.0, 0.0, 640.0], [0.0, 3000.0, 360.0], [0.0, 0.0, 1.0]]), (1280, 720))
    >>> X = np.array([[-3.0, -1.0, 20.0], [3.0, -1.0, 25.0], [0.0, 1.5, 16.0], [2.0, 1.0, 19.0]])
    >>> true = Poses.at_rest(1)
    >>> true.rotation[0] = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
    >>> true.translation[0] = [0.4, -0.1, 0.2]
    >>> weight = np.tile(1e4 * np.eye(2), (1, 4, 1, 1))
    >>> found = find_poses(StaticView(camera, X, look_from(camera, true.moved(X)), weight))
    >>> found.translation.round(3).tolist(), found.rotation_vector.round(4).tolist()
    ([[0.4, -0.1, 0.2]], [[0.02, -0.03, 0.01]])
    """
    frames = len(view.position)
    enough = view.seen.sum(axis=1) >= FEWEST_STATIC
    poses = Poses.at_rest(frames) if start is None else replace(start, found=np.zeros(frames, np.bool_))
    rows = np.flatnonzero(enough)
    for _ in range(_RESTARTS):
        if not rows.size:
            break
        poses = poses.put(rows, _descend(view.of(rows), poses.of(rows)))
        left = np.flatnonzero(enough & ~poses.found)
        known = np.flatnonzero(poses.found)
        if not left.size or not known.size:
            break
        after = np.clip(np.searchsorted(known, left), 1, len(known) - 1) if len(known) > 1 else np.zeros_like(left)
        before = np.maximum(after - 1, 0)
        nearest = np.where(left - known[before] <= known[after] - left, known[before], known[after])
        poses, rows = poses.put(left, replace(poses.of(nearest), found=np.zeros(len(left), np.bool_))), left
    return poses


def _descend(view: StaticView, poses: Poses) -> Poses:
    """Gauss-Newton steps from poses, all frames together."""
    R, s = poses.rotation, poses.translation
    prior = np.diag(1 / _SPREAD**2)
    ended = np.zeros(len(s), np.bool_)
    normal = np.tile(prior, (len(s), 1, 1))
    for _ in range(_STEPS):
        X = np.einsum("tij,pj->tpi", R, view.X) + s[:, None]
        residual = view.position - look_from(view.camera, X)
        used = np.asarray(np.isfinite(residual).all(axis=-1))
        jacobian = np.where(used[..., None, None], jacobian_in_camera(view.camera, X), 0.0)
        residual = np.where(used[..., None], residual, 0.0)
        weighted = np.einsum("tpia,tpij->tpaj", jacobian, np.where(used[..., None, None], view.weight, 0.0))
        normal = np.einsum("tpaj,tpjb->tab", weighted, jacobian) + prior
        state = np.concatenate([Rotation.from_matrix(R).as_rotvec().reshape(-1, 3), s], axis=1)
        right = np.einsum("tpaj,tpj->ta", weighted, residual) - state @ prior
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        turn = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(turn, 1e-12))
        shift = np.abs(np.einsum("tpia,ta->tpi", jacobian, step)).max(axis=(1, 2))
        ended = np.asarray(shift < _ENDED_PX) & (used.sum(axis=1) >= FEWEST_STATIC)
        by = np.asarray(Rotation.from_rotvec(step[:, :3]).as_matrix())
        R, s = by @ R, np.einsum("tij,tj->ti", by, s) + step[:, 3:]
        if ended.all():
            break
    return Poses(R, s, np.asarray(np.linalg.inv(normal)), ended)
