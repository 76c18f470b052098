"""Poses as arrays of shape (3, 4), and as rigid transforms that can be chained and turned round."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from vfm_sdm.core.arrays import FloatArray

__all__ = ["pose_array", "rigid_transform"]


def rigid_transform(b_from_a: FloatArray) -> RigidTransform:
    """The rigid transform of one pose, shape (3, 4), or of several, shape (P, 3, 4)."""
    return RigidTransform.from_components(b_from_a[..., 3], Rotation.from_matrix(b_from_a[..., :3]))


def pose_array(b_from_a: RigidTransform) -> FloatArray:
    """Rotation and translation side by side, shape (3, 4), or (P, 3, 4) of several transforms."""
    return np.asarray(b_from_a.as_matrix()[..., :3, :])
