"""Views that see each sample of a point, their weights, and the disagreement between them that is taken off.

A sample needs two views. With more, one of them may lose a point for a while; the cameras disagree a little, so
positions from other views would differ, and a point would seem to step when a view comes or goes. The mean
disagreement is known from the samples that these views share, and is taken off their pixels.
"""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, mean_of_known
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate

__all__ = ["Disagreement", "Sightings", "Visibility", "see_points", "typical_std"]

_RESOLUTION_PX = 1e-3
"""Least standard deviation of a view's weight: no tracker resolves less."""
_FEWEST_FOR_SCATTER = 10
"""Number of samples from which on the scatter of a mean disagreement is estimated from them."""


@dataclass(frozen=True, eq=False)
class Visibility:
    """The sets of views that see samples, K of them, each with two views or more.

    Parameters
    ----------
    views
        Members of each set, shape (K, V).
    of_sample
        Index of the set that sees a sample, shape (T, P); -1 where fewer than two views do.
    """

    views: BoolArray
    of_sample: IntArray

    def most_frequent(self) -> IntArray:
        """Index of the set that sees most samples of each point, shape (P,); 0 where none sees any."""
        counts = np.stack([(self.of_sample == k).sum(axis=0) for k in range(len(self.views))])
        # Among equals, the one with more views.
        return np.asarray((counts + 0.5 * self.views.mean(axis=1)[:, None]).argmax(axis=0))


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Mean disagreement of V views on P points.

    Parameters
    ----------
    shift
        By how much a view sees a point beside where the others do, shape (V, P, 2) [px].
    covariance
        Its covariance, shape (V, P, 2, 2) [px2].
    linked
        Views whose disagreement is known, shape (V, P); samples of others are not continuous with the rest.
    """

    shift: FloatArray
    covariance: FloatArray
    linked: BoolArray

    @classmethod
    def none(cls, views: int, points: int) -> "Disagreement":
        """Views that agree.

        Parameters
        ----------
        views, points
            Numbers V and P.
        """
        linked = np.ones((views, points), dtype=np.bool_)
        return cls(np.zeros((views, points, 2)), np.zeros((views, points, 2, 2)), linked)

    def of(self, point: int) -> "Disagreement":
        """That on one point, a view of the same arrays.

        Parameters
        ----------
        point
            Its number.
        """
        return Disagreement(self.shift[:, point], self.covariance[:, point], self.linked[:, point])


@dataclass(frozen=True, eq=False)
class Sightings:
    """Pixels of P points in T frames of V views, ready to be triangulated.

    Parameters
    ----------
    pixels
        Pixels less the mean disagreement of the views, shape (V, T, P, 2) [px]; NaN where a view is not used.
    weights
        Factors of each view's equations, shape (V, P) [1]; ``None`` for two views, which need none.
    visibility
        Views that are used.
    disagreement
        What was taken off.
    """

    pixels: FloatArray
    weights: FloatArray | None
    visibility: Visibility
    disagreement: Disagreement

    @property
    def used(self) -> BoolArray:
        """Whether a view is used in a sample, shape (V, T, P)."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1))

    def triangulate(self, rig: Rig) -> FloatArray:
        """Positions of all samples in the frame of the rig's first camera, shape (T, P, 3) [length unit of the rig].

        Parameters
        ----------
        rig
            The V cameras.
        """
        return triangulate(self.pixels, rig, weights=None if self.weights is None else self.weights[:, None])

    def anchor(self, valid: BoolArray) -> FloatArray:
        """A pixel of each point in every view that ever sees it, of its first valid sample where there is one.

        Parameters
        ----------
        valid
            Samples that are triangulated, shape (T, P).

        Returns
        -------
        pixels
            Shape (V, P, 2) [px]; NaN for a point that a view never sees, or that has no valid sample.
        """
        points = np.arange(valid.shape[1])
        some: BoolArray = np.asarray(valid.any(axis=0))
        chosen = self.pixels[:, valid.argmax(axis=0), points]
        if len(self.pixels) > 2:
            seen = self.used & valid
            for view, pixels in enumerate(self.pixels):
                own = pixels[seen[view].argmax(axis=0), points]
                chosen[view] = np.where(np.isfinite(chosen[view]), chosen[view], own)
        return np.asarray(np.where(some[:, None], chosen, np.nan))


def see_points(
    pixels: FloatArray, covariance: FloatArray, trusted: BoolArray, rig: Rig, known: Disagreement | None = None
) -> Sightings:
    """Pixels and weights of the views that are used for each sample, from the tracks of all views.

    Parameters
    ----------
    pixels, covariance, trusted
        Synchronised tracks of V views: positions, shape (V, T, P, 2) [px], NaN where missing, their covariances, shape
        (V, T, P, 2, 2) [px2], and whether the tracker trusts them, shape (V, T, P).
    rig
        V cameras.
    known
        Disagreement that earlier parts of the recording told, of no view where there were none: positions go on from
        there. ``None`` of a recording that is looked at as a whole.

    Notes
    -----
    Two views are both taken as they are. With more views, those of each point are weighted by the inverse of their
    standard deviation (the median over the frames that state one) and of their depth, which makes the linear method's
    residuals those of pixels over their noise; a sample that a view does not trust is left to the others where two of
    them trust theirs.
    """
    found = np.asarray(np.isfinite(pixels).all(axis=-1))
    views, points = len(pixels), pixels.shape[2]
    none = Disagreement.none(views, points)
    if views < 3:
        both = Visibility(np.ones((1, views), dtype=np.bool_), np.where(found.all(axis=0) & (views > 1), 0, -1))
        return Sightings(pixels, None, both, none)
    used = np.where((trusted & found).sum(axis=0) >= 2, trusted & found, found)
    used &= used.sum(axis=0) >= 2
    chosen = np.where(used[..., None], pixels, np.nan)
    weights = _weigh_views(chosen, covariance, rig)
    visibility = _sets_of_views(used)
    apart, told = none, None if known is None else known.linked
    base = visibility.views[visibility.most_frequent()]
    for point, of_point in enumerate(visibility.of_sample.T):
        before = np.zeros(views, dtype=np.bool_) if told is None else told[:, point]
        sets = np.unique(of_point[of_point >= 0])
        if len(sets) < (2 if known is None else 1) and not before.any():
            continue  # all its samples come from the same views, now and ever
        one = _Point(chosen[:, :, point], covariance[:, :, point], weights[:, point], rig)
        if known is not None and before.any():
            apart.shift[:, point], apart.covariance[:, point] = known.shift[:, point], known.covariance[:, point]
            apart.linked[:, point] = before
        else:
            one.compare(base[point], apart.of(point))
        one.link(apart.of(point))
    return Sightings(chosen - apart.shift[:, None], weights, visibility, apart)


def typical_std(variance: FloatArray) -> FloatArray:
    """Standard deviation of the median variance over the frames that state one.

    Parameters
    ----------
    variance
        Stated variances, shape (V, T, P) [px2]; a tracker's reference frame states zero, because the point is there by
        definition.

    Returns
    -------
    std
        Shape (V, P) [px]; NaN where no frame states a variance.

    Examples
    --------
    >>> typical_std(np.array([0.0, 0.04, 0.09, 0.04]).reshape(1, 4, 1)).round(6).tolist()
    [[0.2]]
    """
    stated = np.sort(np.where(variance > 0, variance, np.nan), axis=1)  # NaN last
    count = np.isfinite(stated).sum(axis=1, keepdims=True)
    middle = [np.take_along_axis(stated, np.maximum(index, 0), axis=1) for index in ((count - 1) // 2, count // 2)]
    return np.asarray(np.sqrt((middle[0] + middle[1]) / 2)[:, 0])


def _sets_of_views(used: BoolArray) -> Visibility:
    """The sets of two views or more that see samples, from (V, T, P); all views where no sample is seen."""
    bits = 1 << np.arange(len(used))
    codes = np.where(used.sum(axis=0) >= 2, np.tensordot(bits, used, axes=1), 0)
    found = np.unique(codes[codes > 0])
    of_sample = np.where(codes > 0, np.searchsorted(found, codes), -1)
    return Visibility((found[:, None] & bits) > 0 if found.size else np.ones((1, len(used)), np.bool_), of_sample)


def _weigh_views(pixels: FloatArray, covariance: FloatArray, rig: Rig) -> FloatArray:
    """Inverse of noise and depth of each point in each view, shape (V, P), the largest of a point 1."""
    used = np.asarray(np.isfinite(pixels).all(axis=-1))
    std = typical_std(np.where(used, np.einsum("vtpii->vtp", covariance) / 2, np.nan))
    # Noise that one of the views does not state cannot be compared.
    std[:, (used.any(axis=1) & np.isnan(std)).any(axis=0)] = 1.0
    weights = 1 / np.maximum(np.where(np.isfinite(std), std, np.inf), _RESOLUTION_PX)
    places = mean_of_known(triangulate(pixels, rig))
    for view, camera in enumerate(rig.cameras):
        depth = places @ camera.rotation[2] + camera.translation[2]
        weights[view] /= np.where(depth > 0, depth, np.inf)
    largest = weights.max(axis=0)
    return np.asarray(np.where(largest > 0, weights / np.where(largest > 0, largest, 1.0), 1.0))


@dataclass(frozen=True, eq=False)
class _Point:
    """One point: pixels (V, T, 2) [px], covariances (V, T, 2, 2) [px2], weights of the views (V,), the cameras."""

    pixels: FloatArray
    covariance: FloatArray
    weights: FloatArray
    rig: Rig

    def compare(self, base: BoolArray, apart: Disagreement) -> None:
        """Enters the disagreement of the views of the base (V,) with the position that they give together."""
        together: BoolArray = np.asarray(np.isfinite(self.pixels[base]).all(axis=(0, 2)))
        places = self._places(np.where(base[:, None, None] & together[:, None], self.pixels, np.nan))
        apart.linked[:] = base
        for view in np.flatnonzero(base).tolist():
            apart.shift[view], apart.covariance[view] = self._mean_apart(view, places)

    def link(self, apart: Disagreement) -> None:
        """Enters that of further views with the position of those before, over the samples that they share."""
        while not apart.linked.all():
            linked = apart.linked
            places = self._places(np.where(linked[:, None, None], self.pixels - apart.shift[:, None], np.nan))
            known = np.isfinite(places).all(axis=1)
            shared = np.where(linked, 0, (np.isfinite(self.pixels).all(axis=2) & known).sum(axis=1))
            best = int(shared.argmax())
            if shared[best] == 0:
                break
            apart.shift[best], apart.covariance[best] = self._mean_apart(best, places)
            apart.linked[best] = True

    def _places(self, pixels: FloatArray) -> FloatArray:
        return triangulate(pixels, self.rig, weights=self.weights[:, None])

    def _mean_apart(self, view: int, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean of seen less expected pixels, and its covariance: from the scatter of many, of few as stated."""
        apart = self.pixels[view] - self.rig.cameras[view].project(places)
        known = np.isfinite(apart).all(axis=1)
        count = max(int(known.sum()), 1)
        if count >= _FEWEST_FOR_SCATTER:
            return apart[known].mean(axis=0), np.cov(apart[known].T) / count
        return mean_of_known(apart), 2 * mean_of_known(self.covariance[view, known]) / count
