"""Where a lost point may be, and whether what is found there may be something else that looks like it."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.stages.registration.peaks import AMBIGUITY_MARGIN, DISTINCT_PX

__all__ = ["MOST_LOOKS", "Disc", "LookAlikes", "Sighting", "Whereabouts", "judge_sighting"]

_FEWEST = 10
"""Samples from which on the motion that was seen says how far and how fast a point goes."""
_SPEED = 2.0
"""Times the longest step that was seen which the next one may have."""
_RANGE = 2.0
"""Times the range that was seen by which a point may leave its middle: a range from side to side is half of that."""
_SURE = 4.0
"""Standard deviations of a prediction from another point's motion."""
_FLOOR_PX = 0.5
"""Standard deviation of such a prediction at least: the points of a structure move alike, not equally [px]."""
_NEIGHBOURS = 8
_MOST = 256
"""Samples that are kept; beyond, every second one is dropped and half as many are taken."""
_LONG = 10**6
MOST_LOOKS = _MOST // 2
_NEARER = 0.8
"""Share of the way from what is expected at which one of two explanations, both unexpected, is taken to be right."""


class Sighting(Enum):
    """What was found after a loss."""

    POINT = auto()
    """The point itself."""
    OTHER = auto()
    """What looks like it: the point would have had to move as it cannot."""
    UNSURE = auto()
    """Either."""


@dataclass(frozen=True, eq=False)
class Disc:
    """Where a point may be.

    Parameters
    ----------
    center
        Shape (2,) [px].
    radius
        Infinite where nothing is known [px].
    """

    center: FloatArray
    radius: float


@dataclass(frozen=True, eq=False)
class LookAlikes:
    """Other places in the reference frame that look like a point's subset.

    Parameters
    ----------
    away
        Vectors from the point to them, shape (K, 2) [px].
    correlation
        Of the subset with each, shape (K,) [1].
    """

    away: FloatArray
    correlation: FloatArray

    def as_good_as(self, correlation: float) -> FloatArray:
        """Vectors to those that may be seen with this correlation, shape (K, 2) [px]."""
        return np.asarray(self.away[self.correlation >= correlation - AMBIGUITY_MARGIN])


def judge_sighting(place: FloatArray, alike: FloatArray, expected: Disc) -> Sighting:
    """Whether what was found is the point, by where the point would then be, and where it would be otherwise.

    Parameters
    ----------
    place
        Where something was found, shape (2,) [px].
    alike
        Vectors from the point to what looks like it, shape (K, 2) [px].
    expected
        Where the point may be.

    Notes
    -----
    If a look-alike was found, the point is as far from it as in the reference frame. Where neither explanation is
    expected, that one is taken which is clearly nearer to it.

    Examples
    --------
    >>> found, pitch = np.array([151.0, 0.0]), np.array([[150.0, 0.0], [-150.0, 0.0]])
    >>> judge_sighting(found, pitch, Disc(np.array([4.0, 0.0]), 10.0)).name
    'OTHER'
    >>> judge_sighting(found, pitch, Disc(np.array([140.0, 0.0]), 20.0)).name
    'POINT'
    >>> judge_sighting(found, pitch, Disc(np.array([80.0, 0.0]), 90.0)).name
    'UNSURE'
    """
    if not len(alike):
        return Sighting.POINT
    own = float(np.hypot(*(place - expected.center)))
    other = float(np.hypot(*(place - alike - expected.center).T).min())
    inside, instead = own <= expected.radius, other <= expected.radius
    if inside != instead:
        return Sighting.POINT if inside else Sighting.OTHER
    if not inside and min(own, other) <= _NEARER * max(own, other):
        return Sighting.POINT if own < other else Sighting.OTHER
    return Sighting.UNSURE


class Whereabouts:
    """What the points of a view did so far, and where it leads one that is lost.

    Parameters
    ----------
    home
        Places in the reference frame, shape (P, 2) [px].
    reach_px
        Longest step from one frame to the next, as long as the motion has not shown how fast it is [px].
    looks
        Where the points were in single frames far apart, before those that are taken, each of shape (P, 2) [px].
    """

    def __init__(self, home: FloatArray, reach_px: float, looks: Sequence[FloatArray] = ()) -> None:
        self._home, self._reach_px = home, reach_px
        self._history = [home.copy(), *looks][-MOST_LOOKS:]
        self._last = home.copy()
        for places in self._history:
            self._last = np.where(np.isfinite(places), places, self._last)
        self._before = self._history[-1]
        # Of a point that the last look did not find, nobody knows for how long it went on from where it was.
        self._missing = np.where(np.isfinite(self._before[:, 0]), 0, _LONG)
        self._longest, self._steps = 0.0, 0
        self._taken, self._every = 0, 1

    def add(self, places: FloatArray) -> None:
        """Takes the next frame.

        Parameters
        ----------
        places
            Where the points are for certain, shape (P, 2) [px]; NaN where that is not known.
        """
        known = np.isfinite(places[:, 0])
        steps = np.hypot(*(places - self._before).T)[known & np.isfinite(self._before[:, 0])]
        if steps.size:
            self._longest, self._steps = max(self._longest, float(steps.max())), self._steps + 1
        self._before = places
        self._last[known] = places[known]
        self._missing = np.where(known, 0, self._missing + 1)
        self._taken += 1
        if self._taken % self._every == 0:
            self._history.append(places)
        if len(self._history) == _MOST:
            self._every *= 2
            self._history = self._history[::2]

    def expect(self, point: int, now: FloatArray) -> Disc:
        """Where a point may be in the frame that follows those taken.

        Parameters
        ----------
        point
            Number of the point.
        now
            Where others are in that frame for certain, shape (P, 2) [px]; NaN where that is not known.

        Notes
        -----
        Three sources, of which the most certain counts: how fast the points went at most, for as long as the point was
        not seen; the range in which it moved; and the motion of other points, by which it is predicted as their own
        motion before the loss taught it.
        """
        frames = int(self._missing[point]) + 1
        step = max(_SPEED * self._longest, DISTINCT_PX) if self._steps >= _FEWEST else self._reach_px
        sources = [Disc(self._last[point], frames * step)]
        own = np.array([places[point] for places in self._history])
        seen = np.isfinite(own[:, 0])
        if seen.sum() >= _FEWEST:
            low, high = own[seen].min(axis=0), own[seen].max(axis=0)
            sources.append(Disc((low + high) / 2, max(_RANGE * float(np.hypot(*(high - low))), DISTINCT_PX)))
        others = np.flatnonzero(np.isfinite(now[:, 0]) & (np.arange(len(now)) != point))
        if len(others):
            near = others[np.argsort(np.hypot(*(self._home[others] - self._home[point]).T))[:_NEIGHBOURS]]
            sources += [self._predict(point, own, seen, int(other), now[other]) for other in near]
        return min(sources, key=lambda disc: disc.radius)

    def _predict(self, point: int, own: FloatArray, seen: BoolArray, other: int, now: FloatArray) -> Disc:
        """Where another point's motion leads a point (Bayesian linear regression, from motion that is the same)."""
        theirs = np.array([places[other] for places in self._history])
        both = seen & np.isfinite(theirs[:, 0])
        x, y = theirs[both] - self._home[other], own[both] - self._home[point]
        step = now - self._home[other]
        variance, precision = _FLOOR_PX**2, np.eye(2)
        weights = np.eye(2)
        for _ in range(2):
            precision = np.eye(2) + x.T @ x / variance
            weights = np.linalg.solve(precision, np.eye(2) + x.T @ y / variance)
            left = y - x @ weights
            variance = max(float((left**2).sum(axis=1).mean()) if len(left) else 0.0, _FLOOR_PX**2)
        spread = variance + float(step @ np.linalg.solve(precision, step))
        return Disc(self._home[point] + step @ weights, _SURE * float(np.sqrt(spread)))
