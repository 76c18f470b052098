"""A rig made of some views of another one, with another view as the reference."""

from collections.abc import Sequence

import numpy as np

from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig

__all__ = ["select_views"]


def select_views(rig: Rig, names: Sequence[str]) -> Rig:
    """The named views of a rig, the first of them the reference view, with the covariance carried over.

    Parameters
    ----------
    rig
        V cameras; their poses may be given in any frame.
    names
        Views to keep, in the new order.

    Returns
    -------
    rig
        The W named cameras; its covariance has the shape (10 W, 10 W) and the units of
        `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, lengths in those of ``rig``.

    Raises
    ------
    CameraError
        No view of the rig has one of the names, or a name repeats.

    Notes
    -----
    With the new reference f, ``R' = R Rf^T`` and ``t' = t - R' tf``. The covariance goes through the derivative of
    these at zero rotation vectors; the new reference has no uncertainty of pose.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
    >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> swapped = select_views(Rig(("left", "right"), (left, right)), ["right", "left"])
    >>> swapped.names, swapped.cameras[1].center.tolist()
    (('right', 'left'), [-2.0, 0.0, 0.0])
    """
    moved = Rig.from_world(names, [rig.camera(name) for name in names], metric=rig.metric)
    if rig.covariance is None:
        return moved
    size = len(CAMERA_PARAMETERS)
    old = [rig.names.index(name) for name in names]
    reference = rig.cameras[old[0]]
    J = np.zeros((len(names), size, len(rig), size))
    for new, index in enumerate(old):
        J[new, :4, index, :4] = np.eye(4)
        if new == 0:
            continue
        R = moved.cameras[new].rotation
        arm = np.cross(np.eye(3), R @ reference.translation)  # arm @ w is the cross product of this vector and w
        J[new, 4:7, index, 4:7] = np.eye(3)
        J[new, 4:7, old[0], 4:7] = -R
        J[new, 7:, index, 4:7] = arm
        J[new, 7:, index, 7:] = np.eye(3)
        J[new, 7:, old[0], 4:7] = -arm @ R
        J[new, 7:, old[0], 7:] = -R
    flat = J.reshape(size * len(names), size * len(rig))
    return Rig(moved.names, moved.cameras, moved.metric, flat @ rig.covariance @ flat.T)
