"""A flat board in front of fixed cameras: predicted corner pixels and their derivatives."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.distortion import distort, distort_derivative

__all__ = ["CAMERA_SIZE", "INTRINSICS", "BoardScene", "linearize"]

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Intrinsic parameters of one camera in the order of `BoardScene.intrinsics`."""

CAMERA_SIZE = len(INTRINSICS) + 6
"""Unknowns of one camera: its intrinsics, and the six of its pose."""


@dataclass(frozen=True, eq=False)
class BoardScene:
    """Cameras, and the board's position in each picture.

    Parameters
    ----------
    intrinsics
        Shape (V, 9), in the order of `INTRINSICS` [px, 1].
    cam_from_first
        Shape (V, 3, 4); the identity for the first camera.
    first_from_board
        Shape (P, 3, 4), one for each pose of the board.
    board
        Corners on the board, shape (N, 3) [m].
    """

    intrinsics: FloatArray
    cam_from_first: FloatArray
    first_from_board: FloatArray
    board: FloatArray


def linearize(scene: BoardScene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predicted corners and their derivatives.

    Returns
    -------
    predicted
        Shape (P, V, N, 2) [px]; NaN behind a camera.
    by_camera
        Shape (P, V, N, 2, 15): by the intrinsics, a rotation vector in the camera's frame [rad] and the translation
        of the view's own camera.
    by_board
        Shape (P, V, N, 2, 6): by a rotation vector [rad] and the translation of the board, first camera's frame.
    """
    turned = np.einsum("pij,nj->pni", scene.first_from_board[:, :, :3], scene.board)
    in_first = turned + scene.first_from_board[:, None, :, 3]
    parts = [
        _linearize_view(intrinsics, pose, in_first, turned)
        for intrinsics, pose in zip(scene.intrinsics, scene.cam_from_first, strict=True)
    ]
    predicted, by_camera, by_board = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
    return predicted, by_camera, by_board


def _linearize_view(
    intrinsics: FloatArray, cam_from_first: FloatArray, in_first: FloatArray, turned: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    focal, center, coefficients = intrinsics[:2], intrinsics[2:4], intrinsics[4:]
    R, t = cam_from_first[:, :3], cam_from_first[:, 3]
    rotated = in_first @ R.T
    X = rotated + t
    depth = np.where(X[..., 2] > 0, X[..., 2], np.nan)
    normalized = X[..., :2] / depth[..., None]
    distorted = distort(normalized, coefficients)
    predicted = distorted * focal + center

    # d(pixel)/d(X): through the perspective division, the distortion and the focal lengths.
    perspective = np.zeros((*X.shape[:-1], 2, 3))
    perspective[..., 0, 0] = perspective[..., 1, 1] = 1 / depth
    perspective[..., :, 2] = -normalized / depth[..., None]
    by_point = focal[:, None] * (distort_derivative(normalized, coefficients) @ perspective)

    x, y = normalized[..., 0], normalized[..., 1]
    r2 = x * x + y * y
    by_coefficient = np.stack(  # k1, k2, p1, p2, k3
        [
            normalized * r2[..., None],
            normalized * r2[..., None] ** 2,
            np.stack([2 * x * y, r2 + 2 * y * y], axis=-1),
            np.stack([r2 + 2 * x * x, 2 * x * y], axis=-1),
            normalized * r2[..., None] ** 3,
        ],
        axis=-1,
    )
    by_focal = distorted[..., :, None] * np.eye(2)
    by_center = np.broadcast_to(np.eye(2), by_focal.shape)
    # exp(w) X = X + w x X, so that a row a . (w x X) of the derivative is (X x a) . w.
    by_rotation = np.cross(rotated[..., None, :], by_point)
    by_camera = np.concatenate([by_focal, by_center, by_coefficient * focal[:, None], by_rotation, by_point], axis=-1)
    by_first = by_point @ R
    by_board = np.concatenate([np.cross(turned[..., None, :], by_first), by_first], axis=-1)
    return predicted, by_camera, by_board
