"""The distances of single scene points, which nobody knows, and what they take from the rest of the adjustment.

A point's deviation from the mean nearness moves it by that deviation times the lever. With a few sightings a point
these deviations fit noise, and a longer lever fits more of it: the most probable lever and deviations together are no
estimate of the lever. What counts is the likelihood of the lens with the deviations integrated out, which differs by
the volume that the data leave them: half the logarithm of ``1 + x`` a point, with

    x = s^2 l' Q l

where s is the deviations' standard deviation, l the lever, and Q what the point's sightings tell of a shift against the
lever, after its direction and its growth have taken their parts.

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

__all__ = ["PointSums", "information_on_shift", "lever_precision", "log_volume", "taken_by_points"]


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
    own = np.concatenate([by_ray @ camera.tangents_seen(clip.seen), -by_ray[:, :, 2:]], axis=2)
    heavy = (by_ray * weights[:, None, None]).swapaxes(1, 2)
    both = sums(heavy @ own)
    known = sums((own * weights[:, None, None]).swapaxes(1, 2) @ own)
    known[:, 2, 2] += 1 / clip.growth_std**2
    return np.asarray(sums(heavy @ by_ray) - both @ np.linalg.solve(known, both.swapaxes(1, 2)))


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


def taken_by_points(camera: TurningCamera, clip: LensClip, weights: FloatArray) -> FloatArray:
    """Number of values, 2 to 4, that each point takes from its residuals, shape (P,).

    Parameters
    ----------
    camera
        Where the sightings are predicted from.
    clip
        The sightings.
    weights
        Weight of each sighting, shape (N,) [1/px2].

    Notes
    -----
    The trace of ``(A + P)^-1 A``, with the information A of the sightings and P of the prior.
    """
    by_point = camera.derivatives(clip.seen)[2]
    sums = PointSums(clip.seen.point)
    told = sums((by_point * weights[:, None, None]).swapaxes(1, 2) @ by_point)
    prior = np.diag([0.0, 0.0, clip.nearness_std**-2, clip.growth_std**-2])
    return np.asarray(np.trace(np.linalg.solve(told + prior, told), axis1=1, axis2=2))


def log_volume(camera: TurningCamera, clip: LensClip, weights: FloatArray) -> float:
    """What the deviations' volume takes from the logarithm of the likelihood [1]."""
    return 0.5 * float(np.log1p(_volumes(camera, clip, information_on_shift(camera, clip, weights))).sum())
