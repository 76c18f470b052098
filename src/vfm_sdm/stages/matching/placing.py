"""Points of a structure found in another view together, by resemblance and by where cameras and face expect them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.stages.matching.consistency import ABSENT, GATE, choose_consistent, condition
from vfm_sdm.stages.matching.correspondence import RETURN_PX, way_back
from vfm_sdm.stages.matching.expected import Expected
from vfm_sdm.stages.matching.resemblance import (
    LEAST_CORRELATION,
    Candidate,
    ResemblanceMap,
    best_candidates,
    lowest_between,
    map_resemblance,
    score,
    soften,
)
from vfm_sdm.stages.registration.records import Starts
from vfm_sdm.stages.registration.subsets import register_subset

__all__ = ["NAMED_STD_PX", "Place", "place_points"]

NAMED_STD_PX = 1.5
"""Standard deviation of a place that a user named, along each axis [px]: a click on a picture that is looked at whole."""
_SIZES_PX = 41, 21
"""Sides of the squares that are compared, beside that of the session: smaller ones hold less of what lies behind."""
_ODDS = 3.0
"""Difference of the values of two places, as the logarithm of odds of 20 to 1, that decides between them."""
_SHARP_PX = 3.0
"""Standard deviation up to which a peak is a place that can be registered to a fraction of a pixel."""
_VALLEY = 3.0
_REGISTERED = 3
"""Places, of those that resemble a point most, that are registered."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where a point lies in a view.

    Parameters
    ----------
    position
        Shape (2,) [px]; NaN where it was not found.
    covariance
        Shape (2, 2) [px2].
    correlation
        Normalised cross-correlation of the surroundings [1]; NaN where nothing was compared.
    status
        ``ok``, or why there is no position.
    """

    position: FloatArray
    covariance: FloatArray
    correlation: float
    status: str


def place_points(
    images: tuple[LumaArray, LumaArray],
    points2d: FloatArray,
    expected: Expected,
    *,
    subset_px: int,
    given: Mapping[int, FloatArray],
) -> list[Place]:
    """Places in the second view of P points of the first.

    Parameters
    ----------
    images
        The two views, shape (H, W) each.
    points2d
        Pixels in the first view, shape (P, 2) [px].
    expected
        Where they are expected in the second.
    subset_px
        Side of the session's square [px].
    given
        Pixels that a user named in the second view, shape (2,) [px], by index of the point.
    """
    search = _Search(images, points2d, expected, subset_px, given)
    named = [search.named(i) if i in given else None for i in range(len(points2d))]
    position, covariance = condition(expected.position, expected.covariance, named)
    candidates = [[] if i in given else search.candidates(i, *_of(position, covariance, i)) for i in range(len(points2d))]
    choice = choose_consistent(position, covariance, candidates)
    seen = [None if j is None else candidates[i][j] for i, j in enumerate(choice)]
    places = []
    for i in range(len(points2d)):
        # Where the others say that it is; of a point that a user named, where the user says.
        others = condition(position, covariance, [one if k != i else None for k, one in enumerate(seen)])
        around = (given[i], NAMED_STD_PX**2 * np.eye(2)) if i in given else _of(*others, i)
        places.append(search.settle(i, *around))
    return places


def _of(position: FloatArray, covariance: FloatArray, index: int) -> tuple[FloatArray, FloatArray]:
    """Mean (2,) and covariance (2, 2) of one of several points."""
    here = slice(2 * index, 2 * index + 2)
    return position[index], covariance[here, here]


class _Search:
    """Maps of all points, made once, and what is read from them."""

    def __init__(
        self,
        images: tuple[LumaArray, LumaArray],
        points2d: FloatArray,
        expected: Expected,
        subset_px: int,
        given: Mapping[int, FloatArray],
    ) -> None:
        self.images, self.points2d, self.given, self.subset_px = images, points2d, given, subset_px
        self.sizes = [subset_px, *(size for size in _SIZES_PX if size < subset_px)]
        soft = soften(images[0]), soften(images[1])
        self.maps: list[list[ResemblanceMap]] = []
        for i, point in enumerate(points2d):
            around = _of(expected.position, expected.covariance, i)
            if i in given:
                around = given[i], NAMED_STD_PX**2 * np.eye(2)
            known = bool(np.isfinite(np.concatenate([around[0], around[1].ravel()])).all())
            tried = [(affine, size) for affine in expected.maps[i] for size in self.sizes] if known else []
            made = [map_resemblance(soft, point, around, affine, size) for affine, size in tried]
            self.maps.append([one for one in made if one is not None])

    def named(self, index: int) -> Candidate:
        """What a user's word says of a point."""
        return Candidate(self.given[index], NAMED_STD_PX**2 * np.eye(2), 1.0, np.eye(2), self.subset_px)

    def candidates(self, index: int, mean: FloatArray, covariance: FloatArray) -> list[Candidate]:
        """Places that resemble a point and lie where it is expected, the best first."""
        found = best_candidates(self.maps[index], mean, covariance, gate=GATE) if self.maps[index] else []
        return [one for one in found if one.value >= ABSENT]

    def settle(self, index: int, mean: FloatArray, covariance: FloatArray) -> Place:
        """The place of one point, from where all the rest expects it and what resembles it there."""
        found = self.candidates(index, mean, covariance)
        if not found:
            if index in self.given:
                return Place(mean, covariance, np.nan, PointStatus.OK)
            return _nowhere(PointStatus.NOT_FOUND)
        values = [one.value for one in found]
        sure: list[tuple[FloatArray, FloatArray, float] | None] = [None] * len(found)
        close = [k for k, value in enumerate(values) if value > values[0] - _ODDS][:_REGISTERED]
        for k in close:
            if (at := self._register(index, found[k], mean, covariance)) is not None:
                # A map is coarse: what resembles the point best shows once each place is registered.
                sure[k], values[k] = at, values[k] + score(at[2]) - found[k].score
        first = int(np.argmax(values))
        best, registered = found[first], sure[first]
        rivals = [(one, value - values[first]) for one, value in zip(found, values, strict=True) if one is not best]
        rivals = [(one, value) for one, value in rivals if value > -_ODDS]
        if any(not self._is_same_place(index, best, rival) for rival, _ in rivals):
            return _nowhere(PointStatus.AMBIGUOUS, best.correlation)
        if registered is not None:
            place, sharp, correlation = registered
            return Place(place, sharp + _spread(best, rivals), correlation, PointStatus.OK)
        inner = best.covariance + _spread(best, rivals)
        gain = covariance @ np.linalg.inv(covariance + inner)
        place, left = mean + gain @ (best.position - mean), covariance - gain @ covariance
        if np.sqrt(np.linalg.eigvalsh(left)[-1]) > self.subset_px / 2:
            return _nowhere(PointStatus.AMBIGUOUS, best.correlation)
        return Place(place, left, best.correlation, PointStatus.OK)

    def _is_same_place(self, index: int, best: Candidate, rival: Candidate) -> bool:
        """Whether two candidates are within one subset or on one edge: then the standard deviation says what is open."""
        if np.linalg.norm(rival.position - best.position) <= self.subset_px / 2:
            return True
        return lowest_between(self.maps[index], best, rival) >= min(best.score, rival.score) - _VALLEY

    def _register(
        self, index: int, best: Candidate, mean: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray, float] | None:
        """Position (2,) [px], covariance (2, 2) [px2] and correlation to a fraction of a pixel, where they can be had."""
        if np.sqrt(np.linalg.eigvalsh(best.covariance)[-1]) > _SHARP_PX:
            return None
        point = self.points2d[index]
        for size in self.sizes[self.sizes.index(best.size) :]:
            found = register_subset(
                *self.images, point[None], Starts(best.position[None], best.affine[None]), subset_px=size
            )
            near = np.linalg.norm(found.position[0] - best.position) <= _SHARP_PX
            apart = found.position[0] - mean
            if not (found.converged[0] and near and found.correlation[0] >= LEAST_CORRELATION):
                continue
            if apart @ np.linalg.solve(covariance, apart) > GATE or way_back(self.images, point, found, size) > RETURN_PX:
                continue
            known = np.isfinite(found.covariance[0]).all()
            sharp = found.covariance[0] if known else best.covariance
            return found.position[0], sharp, float(found.correlation[0])
        return None


def _spread(best: Candidate, rivals: Sequence[tuple[Candidate, float]]) -> FloatArray:
    """Covariance (2, 2) [px2] that rivals, with their values over the best one's, add to that of the best place."""
    weights = np.exp([value for _, value in rivals])
    apart = np.array([rival.position - best.position for rival, _ in rivals]).reshape(-1, 2)
    return np.asarray(np.einsum("k,ki,kj->ij", weights / (1 + weights.sum()), apart, apart))


def _nowhere(status: PointStatus, correlation: float = np.nan) -> Place:
    """A place that is not known."""
    return Place(np.full(2, np.nan), np.full((2, 2), np.nan), correlation, status)
