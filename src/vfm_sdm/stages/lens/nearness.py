"""The distances of single scene points, which nobody knows, and what they take from the rest of the adjustment.

A point's deviation from the mean nearness moves it by that deviation times the lever. With a few sightings a point
these deviations fit noise, and a longer lever fits more of it: the most probable lever and deviations together are no
estimate of the lever. What counts is the likelihood of the lens with the deviations integrated out, which differs by
the volume that the data leave them: half the logarithm of ``1 + x`` a point, with

    x = s^2 l' Q l

where s is the deviations' standard deviation, l the lever, and Q what the point's sightings tell of a shift against the
lever, after its direction has taken its part.

References
----------
.. [1] Neyman, J., Scott, E. L. (1948). Consistent estimates based on partially consistent observations. Econometrica
   16(1).
.. [2] Cox, D. R., Reid, N. (1987). Parameter orthogonality and approximate conditional inference. Journal of the Royal
   Statistical Society B 49(1).
"""

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.stages.lens.turning_camera import LensClip, TurningCamera

__all__ = ["PointSums", "information_on_shift", "lever_precision", "log_volume", "taken_by_nearness"]


class PointSums:
    """Sums over the sightings of each point.

    Parameters
    ----------
    point
        Number of each sighting's point, shape (N,), ascending, each from 0 on at least once.
    """

    def __init__(self, point: IntArray) -> None:
        self._starts = np.flatnonzero(np.diff(point, prepend=-1))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Sums over the first axis of ``values`` (N, ...), shape (P, ...)."""
        return np.asarray(np.add.reduceat(values, self._starts))


def information_on_shift(camera: TurningCamera, clip: LensClip, weights: FloatArray) -> FloatArray:
    """Matrices Q of the points, shape (P, 3, 3).

    Parameters
    ----------
    camera
        Where the sightings are predicted from.
    clip
        The sightings.
    weights
        Weight of each sighting, shape (N,) [1/px2].
    """
    sums = PointSums(clip.seen.point)
    by_ray = camera.derivative_by_ray(clip.seen)
    by_direction = by_ray @ camera.tangents_seen(clip.seen)
    heavy = (by_ray * weights[:, None, None]).swapaxes(1, 2)
    both = sums(heavy @ by_direction)
    direction = sums((by_direction * weights[:, None, None]).swapaxes(1, 2) @ by_direction)
    return np.asarray(sums(heavy @ by_ray) - both @ np.linalg.solve(direction, both.swapaxes(1, 2)))


def _volumes(camera: TurningCamera, clip: LensClip, information: FloatArray) -> FloatArray:
    """The points' x, shape (P,) [1]."""
    lever = camera.lever
    return np.asarray(clip.nearness_std**2 * np.einsum("i,pij,j->p", lever, information, lever))


def lever_precision(camera: TurningCamera, clip: LensClip, weights: FloatArray) -> FloatArray:
    """Precision of a zero lever that stands for the deviations' volume, shape (3, 3) [1/m2].

    Notes
    -----
    The logarithm is concave: the quadratic form that touches it at the present lever lies above it everywhere, so that
    steps with it never make the likelihood worse (majorisation).
    """
    information = information_on_shift(camera, clip, weights)
    share = clip.nearness_std**2 / (1 + _volumes(camera, clip, information))
    return np.asarray(np.einsum("p,pij->ij", share, information))


def taken_by_nearness(camera: TurningCamera, clip: LensClip, weights: FloatArray) -> FloatArray:
    """Number of values, 0 to 1, that each point's deviation takes from its residuals, shape (P,)."""
    volumes = _volumes(camera, clip, information_on_shift(camera, clip, weights))
    return np.asarray(volumes / (1 + volumes))


def log_volume(camera: TurningCamera, clip: LensClip, weights: FloatArray) -> float:
    """What the deviations' volume takes from the logarithm of the likelihood [1]."""
    return 0.5 * float(np.log1p(_volumes(camera, clip, information_on_shift(camera, clip, weights))).sum())
