"""Epipolar lines of some width: where the cameras, as well as they are known, allow a point to be."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig

__all__ = ["UNKNOWN_STD", "EpipolarBand", "camera_steps", "epipolar_band"]

UNKNOWN_STD = 0.01
"""Standard deviation of pixels that a rig without covariance predicts, as a share of the image width: 1 % stands for
some mrad of rotation at the fields of view in use."""
_MODEL_STD_PX = 1.0
"""What a lens model leaves out [px]."""
_LARGEST_STEP = 0.05, 50.0, 50.0, 0.05, 0.02, 0.02, 0.02
"""Changes of log focal length, principal point [px], k1 and rotation [rad] over which pixels are nearly linear."""
_LARGEST_SHIFT = 0.05
"""The same of a camera's place, in baselines."""
_DEVIATIONS = 4.0
_BEYOND = 2.0
"""Factor by which the line goes on beyond the depths that were asked for."""
_SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class EpipolarBand:
    """Part of an epipolar line with its width.

    Parameters
    ----------
    line
        Pixels along it, shape (N, 2) [px]; empty where the second camera sees nothing of it.
    half_width
        Distance up to which a place agrees with it [px].
    """

    line: FloatArray
    half_width: float

    def holds(self, places: FloatArray) -> BoolArray:
        """Whether places lie in it.

        Parameters
        ----------
        places
            Shape (N, 2) [px].

        Examples
        --------
        >>> band = EpipolarBand(np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0]]), 2.0)
        >>> band.holds(np.array([[1.2, 6.0], [1.2, 9.0]])).tolist()
        [True, False]
        """
        if not len(self.line):
            return np.zeros(len(places), dtype=bool)
        nearest = np.linalg.norm(places[:, None] - self.line[None], axis=2).argmin(axis=1)
        along = np.gradient(self.line, axis=0)[nearest]
        spacing = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
        apart = places - self.line[nearest]
        across = np.abs(along[:, 0] * apart[:, 1] - along[:, 1] * apart[:, 0]) / spacing
        # Between two samples only the distance across counts, past an end all of it.
        beyond = np.maximum(np.abs(np.einsum("ni,ni->n", along, apart)) / spacing - spacing, 0.0)
        return np.asarray(np.hypot(across, beyond) <= self.half_width)


def camera_steps(rig: Rig, views: tuple[int, int]) -> list[tuple[FloatArray, float]]:
    """Independent steps of the parameters of two cameras, and how many standard deviations each is long.

    Parameters
    ----------
    rig
        Cameras of all views; none of its parameters moves where it has no covariance.
    views
        Indices of the two views.

    Returns
    -------
    steps
        Changes of the parameters of both cameras, shape (20,), in the units of `CAMERA_PARAMETERS`, and their length in
        standard deviations [1]: 1, or less where this would move a camera beyond what is linear.
    """
    if rig.covariance is None:
        return []
    size = len(CAMERA_PARAMETERS)
    places = np.concatenate([np.arange(size * v, size * (v + 1)) for v in views])
    variances, vectors = np.linalg.eigh(rig.covariance[np.ix_(places, places)])
    largest = np.tile([*_LARGEST_STEP, *[_LARGEST_SHIFT * rig.baseline(*views)] * 3], 2)
    found = []
    for variance, vector in zip(variances, vectors.T, strict=True):
        if variance > 0:
            step = np.sqrt(variance) * vector
            length = min(1.0, float((largest / np.maximum(np.abs(step), 1e-300)).min()))
            found.append((length * step, length))
    return found


def epipolar_band(point: FloatArray, rig: Rig, views: tuple[int, int], depths: tuple[float, float]) -> EpipolarBand:
    """Where a point of one view may lie in another.

    Parameters
    ----------
    point
        Pixel in the first view, shape (2,) [px].
    rig
        Cameras of all views.
    views
        Indices of the two views.
    depths
        Nearest and farthest depth in the first camera that is tried, in the rig's unit of length.

    Notes
    -----
    The width is that which the cameras' covariance gives the line in its middle, four standard deviations each way.
    """
    first, second = (rig.cameras[v] for v in views)
    inverse = np.linspace(_BEYOND / depths[0], 1 / (_BEYOND * depths[1]), _SAMPLES)
    line = _project_ray(point, first, second, 1 / inverse)
    line = line[np.isfinite(line).all(axis=1)]
    if len(line) < 2:
        return EpipolarBand(line[:0], 0.0)
    middle = np.array([2 / (1 / depths[0] + 1 / depths[1])])
    along = line[-1] - line[0]
    across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-12)
    variance = _MODEL_STD_PX**2
    if rig.covariance is None:
        variance += (UNKNOWN_STD * second.image_size[0]) ** 2
    size = len(CAMERA_PARAMETERS)
    for step, length in camera_steps(rig, views):
        one, other = (
            _project_ray(point, first.perturbed(sign * step[:size]), second.perturbed(sign * step[size:]), middle)[0]
            for sign in (1, -1)
        )
        change = float((one - other) @ across / (2 * length))
        variance += change**2 if np.isfinite(change) else np.inf
    return EpipolarBand(line, _DEVIATIONS * float(np.sqrt(variance)))


def _project_ray(point: FloatArray, first: Camera, second: Camera, depths: FloatArray) -> FloatArray:
    """Pixels (N, 2) in the second view of places at depths (N,) on a viewing ray of the first."""
    ray = np.append(first.normalize(point), 1.0)
    return second.project((depths[:, None] * ray - first.translation) @ first.rotation)
