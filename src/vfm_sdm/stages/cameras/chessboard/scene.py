"""A flat board in front of fixed cameras: predicted corner pixels and their derivatives."""

from dataclasses import dataclass

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["CAMERA_SIZE", "INTRINSICS", "BoardScene", "linearize"]

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Intrinsic parameters of one camera in the order of `BoardScene.intrinsics`."""

CAMERA_SIZE = len(INTRINSICS) + 6
"""Unknowns of one camera: its intrinsics, and the six of its pose."""


@dataclass(frozen=True, eq=False)
class BoardScene:
    """Cameras, and the pose of the board in each picture; V cameras, P poses, N corners.

    Parameters
    ----------
    intrinsics
        Intrinsic parameters of each camera, shape (V, 9), in the order of `INTRINSICS` [px, 1].
    cam_from_first
        Pose of each camera in the first one's frame, shape (V, 3, 4) [1, m]; the identity for the first camera.
    first_from_board
        Pose of the board in the first camera's frame, shape (P, 3, 4) [1, m], one for each picture.
    board
        Corners in the board's frame, shape (N, 3) [m].
    """

    intrinsics: FloatArray
    cam_from_first: FloatArray
    first_from_board: FloatArray
    board: FloatArray


def linearize(scene: BoardScene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predicted corners and their derivatives.

    Parameters
    ----------
    scene
        Cameras and board at which the projection is linearised; V cameras, P poses, N corners.

    Returns
    -------
    predicted
        Pixels of the corners, shape (P, V, N, 2) [px]; NaN behind a camera.
    by_camera
        Derivatives of the pixels by the view's own camera, shape (P, V, N, 2, 15): by its intrinsics [px/px, px], by a
        rotation vector in the camera's frame [px/rad] and by its translation [px/m].
    by_board
        Derivatives of the pixels by the board's pose, shape (P, V, N, 2, 6): by a rotation vector [px/rad] and by the
        translation of the board [px/m], both in the first camera's frame.

    Notes
    -----
    A small rotation vector w turns a point X to X + w x X, so that the derivative of a pixel by w is X x g, with g the
    derivative of that pixel by the point.

    Examples
    --------
    >>> intrinsics = np.array([[1000.0, 1000.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    >>> pose = np.eye(3, 4)
    >>> pose[2, 3] = 2.0
    >>> scene = BoardScene(intrinsics, np.eye(3, 4)[None], pose[None], np.array([[0.1, 0.0, 0.0]]))
    >>> predicted, by_camera, by_board = linearize(scene)
    >>> predicted[0, 0].round(6)
    array([[370., 240.]])
    >>> by_camera.shape, by_board.shape
    ((1, 1, 1, 2, 15), (1, 1, 1, 2, 6))
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
    """Predicted pixels of one view and their derivatives, as in `linearize` without the axis of views."""
    R, t = cam_from_first[:, :3], cam_from_first[:, 3]
    rotated = in_first @ R.T
    fx, fy, cx, cy = intrinsics[:4]
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    # OpenCV differentiates by the rotation vector that it is given. As the points come turned, that one is zero, and a
    # small change of it turns them further in the camera's frame.
    projected, derivative = cv2.projectPoints(rotated.reshape(-1, 3), np.zeros(3), t, K, intrinsics[4:])
    behind = rotated[..., 2] + t[2] <= 0
    predicted = np.where(behind[..., None], np.nan, projected.reshape(*behind.shape, 2))
    # OpenCV's columns: rotation, translation, focal lengths, principal point, distortion.
    by_rotation, by_point, by_intrinsics = np.split(derivative.reshape(*behind.shape, 2, -1), [3, 6], axis=-1)
    by_camera = np.concatenate([by_intrinsics, by_rotation, by_point], axis=-1)
    by_first = by_point @ R
    # exp(w) X = X + w x X, so that a row a . (w x X) of the derivative is (X x a) . w.
    by_board = np.concatenate([np.cross(turned[..., None, :], by_first), by_first], axis=-1)
    return predicted, by_camera, by_board
