"""What stands out of the structure's face, as the pictures show it."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig

__all__ = ["Relief", "show_relief"]


@dataclass(frozen=True, eq=False)
class Relief:
    """What pictures show of the distances of N points from the structure's face.

    Parameters
    ----------
    shift
        Distance in all further views between a point and the place where the first view's ray to it meets the face,
        positive outwards, shape (N,) [px]; not finite where that ray does not meet it in front of the cameras.
        Distortion is left out.
    per_metre
        How much `shift` grows for each metre out of the face, shape (N,) [px/m].

    Notes
    -----
    Pictures tell a distance from the face by this shift, in proportions that depend on the cameras that are looked for:
    with longer focal lengths the same pictures show a flatter relief. Where relief is an error, least squares of it in
    metres prefers cameras that flatten it. Its standard deviation has to be that of an observation, in pixels, at
    cameras that stay fixed (generalised least squares with variances that depend on the mean, [1]_).

    References
    ----------
    .. [1] Carroll, R. J., Ruppert, D. (1988). Transformation and Weighting in Regression. Chapman and Hall, chapter 2.
    """

    shift: FloatArray
    per_metre: FloatArray

    def scaled(self, std: float, per_metre: FloatArray, own_px: float = 0.0) -> FloatArray:
        """Distances as they show, over their standard deviations at other cameras.

        Parameters
        ----------
        std
            Standard deviation of a distance [m].
        per_metre
            That of those cameras, shape (N,) [px/m].
        own_px
            Standard deviation of a pixel [px].
        """
        return np.asarray(self.shift / np.hypot(per_metre * std, own_px))


def show_relief(points3d: FloatArray, rig: Rig, lateral_axis: FloatArray, lateral: FloatArray | float) -> Relief:
    """Distances of points from the face, and how the further views see them.

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

    Examples
    --------
    >>> K = np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]])
    >>> beside = Camera(K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (Camera(K, (640, 480)), beside))
    >>> relief = show_relief(np.array([[0.0, 0.0, 10.1]]), rig, np.array([0.0, 0.0, 1.0]), 10.0)
    >>> [values.round(2).tolist() for values in (relief.shift, relief.per_metre)]
    [[1.98], [20.0]]
    """
    first = rig.cameras[0].center
    ray = points3d - first
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        step = ray / (ray @ lateral_axis)[:, None]
        on_face = first + np.broadcast_to(lateral - first @ lateral_axis, len(step))[:, None] * step
        ahead = _to_camera(on_face, rig.cameras[0])[:, 2] > 0
        apart, slope = [], []
        for camera in rig.cameras[1:]:
            # Rays that part meet behind the cameras, which is a little beyond infinity: the pixel is as good.
            seen, there = _to_camera(points3d, camera), _to_camera(on_face, camera)
            moved = step @ camera.rotation.T
            apart.append(camera.focal_px * (seen[:, :2] / seen[:, 2:] - there[:, :2] / there[:, 2:]))
            slope.append(camera.focal_px * (moved[:, :2] - there[:, :2] / there[:, 2:] * moved[:, 2:]) / there[:, 2:])
            ahead &= there[:, 2] > 0
        along = np.concatenate(slope, axis=1)
        per_metre = np.linalg.norm(along, axis=1)
        shift = np.sum(np.concatenate(apart, axis=1) * along, axis=1) / per_metre
    return Relief(np.where(ahead, shift, np.nan), per_metre)


def _to_camera(points3d: FloatArray, camera: Camera) -> FloatArray:
    """Points in a camera's frame, shape (N, 3) [m]."""
    return np.asarray((points3d - camera.center) @ camera.rotation.T)
