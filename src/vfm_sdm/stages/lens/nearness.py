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

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.stages.lens.turning_camera import LensClip, TurningCamera

__all__ = ["PointSums", "PointsVolume", "information_on_shift", "taken_by_points", "volume_of_points"]


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


@dataclass(frozen=True, eq=False)
class PointsVolume:
    """What the deviations' volume takes from the logarithm of the likelihood, near the camera at which it was taken.

    Parameters
    ----------
    information
        Matrices Q there, shape (P, 3, 3).
    nearness_std
        Standard deviation of the deviations [1/m].
    begin, slope
        Values of `LENS` there and the derivative by them at a held lever, shape (10,).
    """

    information: FloatArray
    nearness_std: float
    begin: FloatArray
    slope: FloatArray

    def log(self, camera: TurningCamera) -> float:
        """The volume's part of the logarithm [1]: as it is in the lever, and a straight line in the other values."""
        return self._of_lever(camera.lever) + float(self.slope @ (camera.lens - self.begin))

    def lever_precision(self, camera: TurningCamera) -> FloatArray:
        """Precision of a zero lever that stands for the volume, shape (3, 3) [1/m2].

        Notes
        -----
        The logarithm is concave: the quadratic form that touches it at the present lever lies above it everywhere, so
        that steps with it never make the likelihood worse (majorisation).
        """
        share = self.nearness_std**2 / (1 + self._freedom(camera.lever))
        return np.asarray(np.einsum("p,pij->ij", share, self.information))

    def _of_lever(self, lever: FloatArray) -> float:
        return 0.5 * float(np.log1p(self._freedom(lever)).sum())

    def _freedom(self, lever: FloatArray) -> FloatArray:
        """The points' x, shape (P,) [1]."""
        return np.asarray(self.nearness_std**2 * np.einsum("i,pij,j->p", lever, self.information, lever))


def volume_of_points(
    camera: TurningCamera, clip: LensClip, weights: FloatArray, *, slope: FloatArray | None = None
) -> PointsVolume:
    """The volume near a camera.

    Parameters
    ----------
    camera
        Where it is taken.
    clip
        The sightings.
    weights
        Weight of each sighting, shape (N,) [1/px2].
    slope
        Its derivative by `LENS` at a held lever, shape (10,); none where left out.
    """
    information = information_on_shift(camera, clip, weights)
    lens = camera.lens
    return PointsVolume(information, clip.nearness_std, lens, np.zeros(len(lens)) if slope is None else slope)


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
