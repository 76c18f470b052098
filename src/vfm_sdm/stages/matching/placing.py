"""Points of a structure found in another view together, by resemblance and by where cameras and face expect them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.stages.matching.consistency import ABSENT, GATE, ODDS, choose_consistent, condition
from vfm_sdm.stages.matching.correspondence import RETURN_PX, way_back
from vfm_sdm.stages.matching.expected import Expected
from vfm_sdm.stages.matching.points import NAMED_STD_PX
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

__all__ = ["Known", "Place", "place_points"]

_SIZES_PX = 41, 21
"""Sides of the squares that are compared, beside that of the session: smaller ones hold less of what lies behind."""
_WIDER_PX = 81
"""Side of the square that decides between places that look alike, before that of the session [px]: two usual ones, so
that a row ends in it that the point itself is part of."""
_AROUND_PX = 1.0
"""Standard deviation of what a wider square may shift a place by [px]."""
_SHARP_PX = 3.0
"""Standard deviation up to which a peak is a place that can be registered to a fraction of a pixel."""
_VALLEY = 3.0
_ROUNDS = 2
"""Times that points are looked for: with those that were found, others may be found too."""
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


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the places of points, by index of the point.

    Parameters
    ----------
    given
        Pixels that a user named, shape (2,) [px]: they are looked at closely and believed.
    places
        Places of points that were found before: they stay, and help to find the others.
    """

    given: Mapping[int, FloatArray] = field(default_factory=dict)
    places: Mapping[int, Place] = field(default_factory=dict)


def place_points(
    images: tuple[LumaArray, LumaArray],
    points2d: FloatArray,
    expected: Expected,
    *,
    subset_px: int,
    known: Known,
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
    known
        What is known of some of their places.

    Notes
    -----
    Every point's surroundings are compared with all places where it may be, through the plane of the face, with squares
    of several sizes. Of the places that resemble it, one is taken for each point so that all of them together fit what
    cameras and face may have wrong. Each is then looked at again from where the others say that it is: what resembles
    it as well elsewhere makes it ambiguous, what does so close by or along an edge makes it wide; the rest is
    registered to a fraction of a pixel where it can be.
    """
    count = len(points2d)
    search = _Search(images, points2d, expected, subset_px, known)
    settled = {**known.places, **{i: search.settle(i, *_as_named(pixel)) for i, pixel in known.given.items()}}
    free = [i for i in range(count) if i not in settled]
    if free:
        # A place that a user named is taken as it was named: what was found near it may be something else.
        sure = [*known.places, *known.given]
        named = [search.named(i) if i in sure else None for i in range(count)]
        position, covariance = condition(expected.position, expected.covariance, named)
        candidates = [search.candidates(i, *_of(position, covariance, i)) if i in free else [] for i in range(count)]
        choice = choose_consistent(position, covariance, candidates)
        seen = [None if j is None else candidates[i][j] for i, j in enumerate(choice)]
        for _ in range(_ROUNDS):
            for i in [i for i in free if i not in settled or settled[i].status != PointStatus.OK]:
                others = [one if k != i else None for k, one in enumerate(seen)]
                settled[i] = search.settle(i, *_of(*condition(position, covariance, others), i))
            seen = [_as_candidate(settled[i]) if i in free else None for i in range(count)]
    return [settled[i] for i in range(count)]


def _as_named(pixel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where a point is expected that a user named, (2,) and (2, 2)."""
    return pixel, NAMED_STD_PX**2 * np.eye(2)


def _as_candidate(place: Place) -> Candidate | None:
    """A place that was found, as what is seen of a point."""
    if place.status != PointStatus.OK:
        return None
    return Candidate(place.position, place.covariance, 1.0, np.eye(2), 0)


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
        known: Known,
    ) -> None:
        self.images, self.points2d, self.known, self.subset_px = images, points2d, known, subset_px
        self.sizes = [subset_px, *(size for size in _SIZES_PX if size < subset_px)]
        self.relief = expected.relief
        self.soft = soft = soften(images[0]), soften(images[1])
        self.maps: list[list[ResemblanceMap]] = []
        for i, point in enumerate(points2d):
            around = _of(expected.position, expected.covariance, i)
            if i in known.given:
                around = known.given[i], NAMED_STD_PX**2 * np.eye(2)
            there = i not in known.places and np.isfinite(around[0]).all() and np.isfinite(around[1]).all()
            tried = [(affine, size) for affine in expected.maps[i] for size in self.sizes] if there else []
            made = [map_resemblance(soft, point, around, affine, size) for affine, size in tried]
            self.maps.append([one for one in made if one is not None])

    def named(self, index: int) -> Candidate | None:
        """What is known of a point beforehand, as if it had been found."""
        if index in self.known.places:
            return _as_candidate(self.known.places[index])
        return Candidate(*_as_named(self.known.given[index]), 1.0, np.eye(2), 0)

    def candidates(self, index: int, mean: FloatArray, covariance: FloatArray) -> list[Candidate]:
        """Places that resemble a point and lie where it is expected, the best first."""
        found = best_candidates(self.maps[index], mean, covariance, gate=GATE) if self.maps[index] else []
        return [one for one in found if one.value >= ABSENT]

    def settle(self, index: int, mean: FloatArray, covariance: FloatArray) -> Place:
        """The place of one point, from where all the rest expects it and what resembles it there."""
        place = self._look_closely(index, mean, covariance)
        if index in self.known.given and place.status != PointStatus.OK:
            # Nothing there tells the place better than whoever named it.
            return Place(mean, covariance, place.correlation, PointStatus.OK)
        return place

    def _look_closely(self, index: int, mean: FloatArray, covariance: FloatArray) -> Place:
        """The place of one point, if what resembles it there is one place."""
        found = self.candidates(index, mean, covariance)
        if not found:
            return _nowhere(PointStatus.NOT_FOUND)
        found, values = self._compare(index, found)
        sure: list[tuple[FloatArray, FloatArray, float] | None] = [None] * len(found)
        close = [k for k, value in enumerate(values) if value > values[0] - ODDS][:_REGISTERED]
        for k in close:
            if (at := self._register(index, found[k], mean, covariance)) is not None:
                # A map is coarse: what resembles the point best shows once each place is registered.
                sure[k], values[k] = at, values[k] + float(score(at[2])) - found[k].score
        first = int(np.argmax(values))
        best, registered = found[first], sure[first]
        rivals = [(one, value - values[first]) for one, value in zip(found, values, strict=True) if one is not best]
        rivals = [(one, value) for one, value in rivals if value > -ODDS]
        if any(not self._is_same_place(index, best, rival) for rival, _ in rivals):
            return _nowhere(PointStatus.AMBIGUOUS, best.correlation)
        if registered is not None:
            place, sharp, correlation = registered
            return Place(place, sharp + _spread(best, rivals), correlation, PointStatus.OK)
        off = self._stand_off(index, best)
        inner = best.covariance + _spread(best, rivals) + np.outer(off, off)
        gain = covariance @ np.linalg.inv(covariance + inner)
        place, left = mean + gain @ (best.position - mean), covariance - gain @ covariance
        if np.sqrt(np.linalg.eigvalsh(left)[-1]) > self.subset_px / 2:
            return _nowhere(PointStatus.AMBIGUOUS, best.correlation)
        return Place(place, left, best.correlation, PointStatus.OK)

    def _stand_off(self, index: int, place: Candidate) -> FloatArray:
        """Standard deviation by which details that stand off the face move a place, shape (2,) [px].

        Bolts, ribs and rails stand off about as far as they are wide. They do the more of the resemblance, the less of
        it a plane explains: all of it where it is just seen.
        """
        cells = next(m.cells for m in self.maps[index] if m.affine is place.affine and m.size == place.size)
        unexplained = (1 - place.correlation**2) / (1 - LEAST_CORRELATION**2)
        return np.asarray(place.size / np.sqrt(cells) * np.sqrt(max(unexplained, 0.0)) * self.relief[index])

    def _compare(self, index: int, found: list[Candidate]) -> tuple[list[Candidate], list[float]]:
        """Places, the best first, and their values: of the widest square that is seen, where smaller ones look alike.

        Each bolt of a row, post of a railing or stone of a wall looks like the next one; the row's end does not. Beyond
        the point's own plane a wider square sees something else, so that it counts only where it resembles one place.
        """
        values = [one.value for one in found]
        rivals = [one for one in found[1:] if one.value > values[0] - ODDS]
        if all(self._is_same_place(index, found[0], rival) for rival in rivals):
            return found, values
        for size in (_WIDER_PX, self.subset_px):
            seen = [self._correlate(index, one, size) for one in found]
            if max(seen) >= LEAST_CORRELATION:
                wider = [one.value - one.score + float(score(s)) for one, s in zip(found, seen, strict=True)]
                order = np.argsort([-value for value in wider], kind="stable")
                return [found[k] for k in order], [wider[k] for k in order]
        return found, values

    def _correlate(self, index: int, place: Candidate, size: int) -> float:
        """Highest correlation of a square of this side at a place [1]; 0 where it has no room.

        Nothing speaks against a place that only another depth or tilt makes resemble the point, so the square may warp.
        """
        point, around = self.points2d[index], (place.position, _AROUND_PX**2 * np.eye(2))
        found = map_resemblance(self.soft, point, around, place.affine, size)
        if found is None:
            return 0.0
        row, column = np.unravel_index(int(found.correlation.argmax()), found.correlation.shape)
        start = Starts((found.origin + found.affine @ [column, row])[None], place.affine[None])
        warped = register_subset(*self.images, point[None], start, subset_px=size)
        near = np.linalg.norm(warped.position[0] - place.position) <= 2 * _SHARP_PX
        best = float(found.correlation[row, column])
        return max(best, float(warped.correlation[0]) if warped.converged[0] and near else 0.0)

    def _is_same_place(self, index: int, best: Candidate, rival: Candidate) -> bool:
        """Whether two candidates are within one subset or on one edge: how far apart is then an uncertainty."""
        if np.linalg.norm(rival.position - best.position) <= self.subset_px / 2:
            return True
        return lowest_between(self.maps[index], best, rival) >= min(best.score, rival.score) - _VALLEY

    def _register(
        self, index: int, best: Candidate, mean: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray, float] | None:
        """Position (2,) [px], covariance (2, 2) [px2] and correlation to a fraction of a pixel, where it converges."""
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
            if apart @ np.linalg.solve(covariance, apart) > GATE:
                continue
            if way_back(self.images, point, found, size) > RETURN_PX:
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
