"""Poses as arrays of shape (3, 4), and as rigid transforms that can be chained and turned round."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from vfm_sdm.core.arrays import FloatArray

__all__ = ["pose_array", "rigid_transform"]


def rigid_transform(b_from_a: FloatArray) -> RigidTransform:
    """The rigid transform of one pose or of several.

    Parameters
    ----------
    b_from_a
        Rotation [1] and translation [m or another length] side by side, shape (3, 4) or (P, 3, 4).

    Examples
    --------
    >>> pose = np.column_stack([np.eye(3), [1.0, 2.0, 3.0]])
    >>> pose_array(rigid_transform(pose).inv())[:, 3].tolist()
    [-1.0, -2.0, -3.0]
    """
    return RigidTransform.from_components(b_from_a[..., 3], Rotation.from_matrix(b_from_a[..., :3]))


def pose_array(b_from_a: RigidTransform) -> FloatArray:
    """Rotation [1] and translation [m or another length] side by side, shape (3, 4) or (P, 3, 4).

    Parameters
    ----------
    b_from_a
        One transform or several.
    """
    return np.asarray(b_from_a.as_matrix()[..., :3, :])
