"""What a straight edge says of a camera: its chord leads to a vanishing point, and its chain does not bow."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera

__all__ = ["EdgeErrors", "StraightenedEdges", "edge_errors", "straighten"]


class EdgeErrors(NamedTuple):
    """Errors of N edges.

    Parameters
    ----------
    slope_px, bow_px
        How far an end of the chord lies beside the line from its middle to the vanishing point, and the middle of the
        chain beside the chord, shape (N,) [px] as it was seen; NaN where a pixel has no ray.
    away
        Distance of the vanishing point from the middle of the chord, over half its length, shape (N,) [1].
    foreshortening
        Sine of the angle at which each is seen, shape (N,) [1]: what a member is out of line by shows as much larger.
    """

    slope_px: FloatArray
    bow_px: FloatArray
    away: FloatArray
    foreshortening: FloatArray


def edge_errors(places: FloatArray, camera: Camera, directions: FloatArray) -> EdgeErrors:
    """How far edges are from leading to their vanishing points, and from being straight.

    Parameters
    ----------
    places
        Start, middle and end of N edges, shape (N, 3, 2) [px].
    camera
        Camera that sees them; its distortion straightens them.
    directions
        Direction of each in space, in the frame of the rig, shape (N, 3) or (3,) [1]; its sign and length do not count.

    Returns
    -------
    errors
        Errors of each.

    Notes
    -----
    The image of a direction d is ``v = K R d``, where all lines of that direction meet [1]_. The first error is zero
    where the plane through the optical centre and the chord holds d.

    References
    ----------
    .. [1] Hartley, R., Zisserman, A. (2004). Multiple View Geometry in Computer Vision, 2nd edition, section 8.6.

    Examples
    --------
    >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
    >>> edge = camera.project(np.array([[1.0, -1.0, 10.0], [1.0, 0.0, 10.0], [1.0, 1.0, 10.0]]))
    >>> [error.round(9).tolist() for error in edge_errors(edge[None], camera, np.array([0.0, 1.0, 0.0]))[:2]]
    [[0.0], [0.0]]
    """
    return straighten(places, camera).errors(camera, directions)


@dataclass(frozen=True, eq=False)
class StraightenedEdges:
    """Edges as a camera without distortion would see them.

    Parameters
    ----------
    half_px
        Half the length of each chord as it was seen, shape (N,) [px].
    places
        Start, middle and end without distortion, shape (N, 3, 2) [px].
    rays
        Directions to the middles in the camera's axes, shape (N, 3) [1].
    """

    half_px: FloatArray
    places: FloatArray
    rays: FloatArray

    def errors(self, camera: Camera, directions: FloatArray) -> EdgeErrors:
        """As of `edge_errors`, with the camera that straightened them.

        Parameters
        ----------
        camera, directions
            As of `edge_errors`.
        """
        vanishing = directions @ (camera.K @ camera.rotation).T
        first, last = self.places[:, 0], self.places[:, 2]
        middle, half = (first + last) / 2, (last - first) / 2
        to_vanishing = vanishing[..., :2] - vanishing[..., 2:] * middle
        length = np.linalg.norm(half, axis=1)
        reach = np.linalg.norm(to_vanishing, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            # As angles, times the length as it was seen: a lens that shrinks the picture must not shrink errors.
            slope = _cross(to_vanishing, half) / reach / length * self.half_px
            away = reach / np.abs(np.broadcast_to(vanishing[..., 2], reach.shape)) / length
            bow = _cross(half, self.places[:, 1] - middle) / length**2 * self.half_px
        along = np.broadcast_to(directions @ camera.rotation.T, self.rays.shape)
        seen = np.linalg.norm(np.cross(self.rays, along), axis=1)
        seen = seen / (np.linalg.norm(self.rays, axis=1) * np.linalg.norm(along, axis=1))
        return EdgeErrors(slope, bow, away, seen)


def straighten(places: FloatArray, camera: Camera) -> StraightenedEdges:
    """Edges without distortion.

    Parameters
    ----------
    places, camera
        As of `edge_errors`.

    Examples
    --------
    >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
    >>> straighten(np.array([[[10.0, 5.0], [20.0, 5.0], [30.0, 5.0]]]), camera).half_px.tolist()
    [10.0]
    """
    normalized = camera.normalize(places)
    rays = np.concatenate([normalized[:, 1], np.ones((len(places), 1))], axis=1)
    half = np.linalg.norm(places[:, 2] - places[:, 0], axis=1) / 2
    return StraightenedEdges(half, camera.pixels(normalized), rays)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
