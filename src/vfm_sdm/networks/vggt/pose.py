"""The pose vector of VGGT, and cameras: translation, quaternion (x, y, z, w), vertical and horizontal field of view."""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray

__all__ = ["FOV", "POSE_SIZE", "decode_pose", "encode_pose"]

POSE_SIZE: Final = 9
TRANSLATION, QUATERNION, FOV = slice(0, 3), slice(3, 7), slice(7, 9)


def decode_pose(poses: FloatArray, image_size: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Cameras of pose vectors.

    Parameters
    ----------
    poses
        Pose vectors of S frames, shape (S, 9): translation [1], quaternion of any length [1], fields of view [rad].
    image_size
        Width and height of the network's image [px].

    Returns
    -------
    cam_from_world
        Shape (S, 3, 4); x right, y down, z forward. NaN where the quaternion has no length.
    intrinsics
        Shape (S, 3, 3) [px], **the image's corner at (0, 0)**, so that the principal point is half the size. The focal
        length is NaN where the field of view is not between 0 and pi.

    Examples
    --------
    >>> pose = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, np.pi / 2, np.pi / 2]])
    >>> cam_from_world, intrinsics = decode_pose(pose, (518, 518))
    >>> cam_from_world[0].tolist(), round(float(intrinsics[0, 0, 0]), 6)
    ([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], 259.0)
    """
    poses = np.asarray(poses, dtype=np.float64)
    width, height = image_size
    fov = poses[:, FOV]
    # The network cuts negative fields of view to zero: an infinite focal length is no camera.
    known = np.where((fov > 0) & (fov < np.pi), fov, np.nan)
    focal = np.array([height, width]) / 2 / np.tan(known / 2)
    intrinsics = np.zeros((len(poses), 3, 3))
    intrinsics[:, 0, 0], intrinsics[:, 1, 1] = focal[:, 1], focal[:, 0]
    intrinsics[:, :, 2] = [width / 2, height / 2, 1.0]
    length = np.linalg.norm(poses[:, QUATERNION], axis=1)
    turned = np.isfinite(length) & (length > 0)
    rotation = np.full((len(poses), 3, 3), np.nan)
    rotation[turned] = Rotation.from_quat(poses[turned, QUATERNION]).as_matrix()
    return np.concatenate([rotation, poses[:, TRANSLATION, None]], axis=2), intrinsics


def encode_pose(cam_from_world: FloatArray, intrinsics: FloatArray, image_size: tuple[int, int]) -> FloatArray:
    """Pose vectors of cameras: the inverse of `decode_pose`.

    Parameters
    ----------
    cam_from_world
        Shape (S, 3, 4); x right, y down, z forward.
    intrinsics
        Shape (S, 3, 3) [px], the image's corner at (0, 0).
    image_size
        Width and height of the network's image [px].

    Returns
    -------
    poses
        Shape (S, 9), fields of view in radians; the quaternion's w is not negative.

    Examples
    --------
    >>> K = np.array([[[259.0, 0.0, 259.0], [0.0, 259.0, 259.0], [0.0, 0.0, 1.0]]])
    >>> encode_pose(np.eye(3, 4)[None], K, (518, 518)).round(4).tolist()
    [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.5708, 1.5708]]
    """
    width, height = image_size
    quaternion = Rotation.from_matrix(cam_from_world[:, :, :3]).as_quat(canonical=True)
    focal = np.stack([intrinsics[:, 1, 1], intrinsics[:, 0, 0]], axis=1)
    fov = 2 * np.arctan(np.array([height, width]) / 2 / focal)
    return np.concatenate([cam_from_world[:, :, 3], quaternion, fov], axis=1)
