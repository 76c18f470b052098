"""What stands out of the structure's face, as the pictures show it."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig

__all__ = ["show_relief"]


def show_relief(
    points3d: FloatArray, rig: Rig, lateral_axis: FloatArray, lateral: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far from where they would lie on the face the further views see points of the first view.

    Parameters
    ----------
    points3d
        Points, shape (N, 3) [m], in the rig's frame.
    rig
        Cameras.
    lateral_axis
        Unit vector across the face in the rig's frame, shape (3,) [1].
    lateral
        Lateral coordinate of the face at each point, shape (N,) or scalar [m].

    Returns
    -------
    shift
        Distance in all further views between a point and the place where the first view's ray to it meets the face,
        positive outwards, shape (N,) [px]; not finite where that ray does not meet it in front of the cameras.
        Distortion is left out.
    per_metre
        How much it grows for each metre out of the face, shape (N,) [px/m].

    Notes
    -----
    Pictures tell a distance from the face by this shift, in proportions that depend on the cameras that are looked for:
    with longer focal lengths the same pictures show a flatter relief. Where relief is an error, least squares of it in
    metres would prefer cameras that flatten it. Its standard deviation has to be that of an observation, in pixels, at
    cameras that stay fixed (generalised least squares with variances that depend on the mean, [1]_).

    References
    ----------
    .. [1] Carroll, R. J., Ruppert, D. (1988). Transformation and Weighting in Regression. Chapman and Hall, chapter 2.

    Examples
    --------
    >>> K = np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]])
    >>> beside = Camera(K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (Camera(K, (640, 480)), beside))
    >>> shift, per_metre = show_relief(np.array([[0.0, 0.0, 10.1]]), rig, np.array([0.0, 0.0, 1.0]), 10.0)
    >>> shift.round(2).tolist(), per_metre.round(2).tolist()
    ([1.98], [20.0])
    """
    first = rig.cameras[0].center
    ray = points3d - first
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        step = ray / (ray @ lateral_axis)[:, None]
        reach = lateral - first @ lateral_axis
        on_face = first + np.broadcast_to(reach, len(step))[:, None] * step
        apart, slope = [], []
        for camera in rig.cameras[1:]:
            seen, there = _to_camera(points3d, camera), _to_camera(on_face, camera)
            moved = step @ camera.rotation.T
            apart.append(camera.focal_px * (seen[:, :2] / seen[:, 2:] - there[:, :2] / there[:, 2:]))
            slope.append(camera.focal_px * (moved[:, :2] - there[:, :2] / there[:, 2:] * moved[:, 2:]) / there[:, 2:])
        along = np.concatenate(slope, axis=1)
        per_metre = np.linalg.norm(along, axis=1)
        shift = np.sum(np.concatenate(apart, axis=1) * along, axis=1) / per_metre
    ahead = ((on_face - first) * ray).sum(axis=1) > 0
    return np.where(ahead, shift, np.nan), per_metre


def _to_camera(points3d: FloatArray, camera: Camera) -> FloatArray:
    """Points in a camera's frame, shape (N, 3) [m]; NaN behind it."""
    inside = (points3d - camera.center) @ camera.rotation.T
    return np.where(inside[:, 2:] > 0, inside, np.nan)
