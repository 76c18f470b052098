"""The pose vector of PoseDiffusion, and cameras: translation, quaternion (w, x, y, z), two focal lengths.

Cameras of the vector have x to the left and y up, and multiply from the right; cameras that these functions yield have
x to the right and y down, and multiply from the left, as everywhere in this package.
"""

from typing import Final

import torch
from torch import Tensor

__all__ = ["FOCAL", "FOCAL_RANGE", "POSE_SIZE", "QUATERNION", "TRANSLATION", "decode_pose", "encode_pose"]

POSE_SIZE: Final = 9
TRANSLATION, QUATERNION, FOCAL = slice(0, 3), slice(3, 7), slice(7, 9)
FOCAL_RANGE: Final = (0.1, 20.0)
"""Shortest and longest focal length over half the shorter side of the picture [1]."""
_MEAN_LOG_FOCAL = 1.8
_FLIPPED = (-1.0, -1.0, 1.0)


def decode_pose(poses: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Cameras of pose vectors.

    Parameters
    ----------
    poses
        Pose vectors of N frames, shape (..., N, 9).

    Returns
    -------
    rotation
        Of ``cam_from_world``, shape (..., N, 3, 3); x right, y down, z forward. NaN where the quaternion has no length.
    translation
        Of ``cam_from_world``, shape (..., N, 3), in the network's unit.
    focal
        Focal lengths along x and y over half the picture's shorter side, shape (..., N, 2) [1]; within `FOCAL_RANGE`.

    Examples
    --------
    >>> pose = torch.tensor([[1.0, 2.0, 3.0, 2.0, 0.0, 0.0, 0.0, -1.8, -1.8]])
    >>> rotation, translation, focal = decode_pose(pose)
    >>> rotation[0].diag().tolist(), translation.tolist(), focal.tolist()
    ([-1.0, -1.0, 1.0], [[-1.0, -2.0, 3.0]], [[1.0, 1.0]])
    """
    w, x, y, z = poses[..., QUATERNION].unbind(-1)
    double = 2.0 / (w * w + x * x + y * y + z * z)
    # The matrix that the quaternion denotes multiplies row vectors: it is the transpose that is wanted.
    rows = [
        [1 - double * (y * y + z * z), double * (x * y + z * w), double * (x * z - y * w)],
        [double * (x * y - z * w), 1 - double * (x * x + z * z), double * (y * z + x * w)],
        [double * (x * z + y * w), double * (y * z - x * w), 1 - double * (x * x + y * y)],
    ]
    flip = poses.new_tensor(_FLIPPED)
    rotation = flip[:, None] * torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    focal = (poses[..., FOCAL] + _MEAN_LOG_FOCAL).exp().clamp(*FOCAL_RANGE)
    return rotation, poses[..., TRANSLATION] * flip, focal


def encode_pose(rotation: Tensor, translation: Tensor, focal: Tensor) -> Tensor:
    """Pose vectors of cameras, shape (..., N, 9): the inverse of `decode_pose`.

    Parameters
    ----------
    rotation, translation, focal
        As `decode_pose` yields them for N frames.

    Returns
    -------
    poses
        Shape (..., N, 9); the largest entry of a quaternion is positive.

    Examples
    --------
    >>> pose = encode_pose(torch.diag(torch.tensor([-1.0, -1.0, 1.0]))[None], torch.zeros(1, 3), torch.ones(1, 2))
    >>> pose[0, 3:7].abs().tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    flip = rotation.new_tensor(_FLIPPED)
    m = (flip[:, None] * rotation).mT
    a, b, c = m.diagonal(dim1=-2, dim2=-1).unbind(-1)
    squares = torch.stack([1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c], dim=-1).clamp(min=0)
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    ww, xx, yy, zz = squares.unbind(-1)
    # Each row is the quaternion times four of its entries: the row of the largest entry divides by no small number.
    rows = [[ww, wx, wy, wz], [wx, xx, xy, xz], [wy, xy, yy, yz], [wz, xz, yz, zz]]
    table = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    largest = squares.argmax(dim=-1)[..., None]
    row = table.gather(-2, largest[..., None].expand(*largest.shape, 4)).squeeze(-2)
    quaternion = row / (2 * squares.gather(-1, largest).sqrt())
    log_focal = focal.clamp(*FOCAL_RANGE).log() - _MEAN_LOG_FOCAL
    return torch.cat([translation * flip, quaternion, log_focal], dim=-1)
