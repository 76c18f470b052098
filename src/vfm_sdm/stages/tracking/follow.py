"""Points of one view followed from frame to frame: prediction, registration, and search where that fails."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.registration.kernels import FAILED
from vfm_sdm.stages.registration.peaks import AMBIGUITY_MARGIN, DISTINCT_PX, correlation_peaks, has_rival
from vfm_sdm.stages.registration.subsets import RawRegistration, SubsetBank
from vfm_sdm.stages.tracking.templates import WarpedTemplates
from vfm_sdm.stages.tracking.whereabouts import MOST_LOOKS, Disc, LookAlikes, Sighting, Whereabouts, judge_sighting

__all__ = ["LOOK_ALIKE", "FollowSettings", "FollowState", "Follower"]

LOOK_ALIKE = 0.9
"""Correlation of another place in the reference frame from which on a subset counts as repeated."""

_BORDER_PX = 5.0  # a subset that vanishes further from the border, and was not moving there, has not left the image
_SAFE_PX = DISTINCT_PX / 2
_PEAKS = 4  # places that a search tries: the best, and rivals that would make it ambiguous
_PEAKS_IN_REFERENCE = 12  # more, because the nearest look-alike counts there, not the best
_FAR, _PEAKS_FAR = 8, 64
"""How many search radii around a point that was lost look-alikes are known of, and how many of them."""


@dataclass(frozen=True)
class FollowSettings:
    """Limits that decide between following, searching and giving up; see `vfm_sdm.stages.tracking.icgn.IcgnTracker`.

    Parameters
    ----------
    search_radius_px
        Where following fails, how far from the last good position to search [px]: the largest jump.
    max_iterations
        Gauss-Newton steps after which a registration has failed.
    minimum_correlation
        Below this ZNCC a point is lost.
    reliable_correlation
        Below this ZNCC, after a search found nothing better, a point is unreliable.
    predict
        Whether each frame starts from the last motion continued, or from the last position.
    """

    search_radius_px: int = 40
    max_iterations: int = 50
    minimum_correlation: float = 0.6
    reliable_correlation: float = 0.8
    predict: bool = True


@dataclass(frozen=True, eq=False)
class FollowState:
    """Where points are as a follower begins.

    Parameters
    ----------
    warps
        Where each was found last: position of the subset's centre [px] and affine map [1], shape (P, 6).
    seen, outside, unsure
        Whether it was found in the last frame, left the image, or may be another one that looks like it, shape (P,).
    looks
        Where the points were in single frames far apart, each of shape (P, 2) [px]; NaN where that is not known.
    """

    warps: FloatArray
    seen: BoolArray
    outside: BoolArray
    unsure: BoolArray
    looks: tuple[FloatArray, ...] = ()

    def of(self, rows: IntArray) -> "FollowState":
        """The state of some points.

        Parameters
        ----------
        rows
            Which, shape (N,).
        """
        looks = tuple(places[rows] for places in self.looks)
        return FollowState(self.warps[rows], self.seen[rows], self.outside[rows], self.unsure[rows], looks)

    @classmethod
    def joined(cls, parts: Sequence[tuple[IntArray, "FollowState"]]) -> "FollowState":
        """The state of all points, of those of some each.

        Parameters
        ----------
        parts
            Rows and states of some points each, all after as many looks.
        """
        order = np.argsort(np.concatenate([rows for rows, _ in parts]))
        states = [state for _, state in parts]
        warps, seen, outside, unsure = (
            np.concatenate([getattr(state, name) for state in states])[order]
            for name in ("warps", "seen", "outside", "unsure")
        )
        looks = [np.concatenate(places)[order] for places in zip(*(state.looks for state in states), strict=True)]
        return cls(warps, seen, outside, unsure, tuple(looks))


class Follower:
    """Follows the subsets of a bank; every frame is registered to the reference frame, so that errors do not add up.

    Parameters
    ----------
    bank
        The subsets.
    reference
        The frame they come from, shape (H, W).
    settings
        Limits.
    executor
        Threads that share the work.
    start
        Where the points are; as in the reference frame when left out.
    """

    def __init__(
        self,
        bank: SubsetBank,
        reference: LumaArray,
        settings: FollowSettings,
        executor: Executor,
        start: FollowState | None = None,
    ) -> None:
        self._bank, self._settings, self._executor = bank, settings, executor
        self._half = bank.subset_px // 2
        start = start or _at_home(bank)
        self._last = start.warps.copy()  # where each was found last
        self._step = np.zeros((len(bank), 2))  # motion over the last two frames, where both were found
        self._seen, self._outside = start.seen.copy(), start.outside.copy()
        self._reference = reference.copy()
        self._templates = WarpedTemplates(self._reference, bank)
        self._reach = np.full(len(bank), np.nan)  # filled in for a point when it first takes a step that matters
        self._alike: dict[int, LookAlikes] = {}  # filled in for a point when it is first found again
        self._unsure, self._looks = start.unsure.copy(), start.looks
        self._whereabouts = Whereabouts(bank.centers.astype(float), settings.search_radius_px, start.looks)

    def return_home(self) -> None:
        """Puts the points where they are in the reference frame, because that is the frame to come."""
        home = _at_home(self._bank)
        self._last, self._seen = home.warps.copy(), home.seen.copy()
        self._step[:], self._unsure[:], self._outside = 0.0, False, home.outside.copy()

    def look(self, luma: LumaArray) -> FollowState:
        """Where the points are in a single frame, long after the last one.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        """
        self._step[:] = 0.0
        self.advance(luma)
        places = np.where((self._seen & ~self._unsure)[:, None], self._last[:, :2], np.nan)
        self._looks = (*self._looks, places)[-MOST_LOOKS:]
        return FollowState(self._last.copy(), self._seen.copy(), self._outside.copy(), self._unsure.copy(), self._looks)

    def advance(self, luma: LumaArray, expected: FloatArray | None = None) -> tuple[RawRegistration, IntArray]:
        """Registrations in the next frame, and their status: ok, lost, outside or unreliable, shape (P,).

        Unreliable is a point that was lost, where what was found may be another one that looks like it.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        expected
            Where the points should be, shape (P, 2) [px]; where NaN, and without it, the last motion is continued.
        """
        start = self._last.copy()
        if self._settings.predict:
            start[:, :2] += self._step
        if expected is not None:
            shown = np.isfinite(expected).all(axis=1)
            start[shown, :2] = self._bank.hold_along_edges(np.arange(len(self._bank)), expected - self._bank.offset)[
                shown
            ]
        raw = self._register(luma, np.arange(len(self._bank)), start)
        continuous = raw.converged & self._within_reach(np.hypot(*(raw.warps[:, :2] - start[:, :2]).T))
        found = continuous & (raw.correlation >= self._settings.reliable_correlation)
        left = raw.outside & (self._clearance(start, luma) <= np.hypot(*self._step.T) + _BORDER_PX)
        followed = found.copy()
        now = np.where((found & self._seen & ~self._unsure)[:, None], raw.warps[:, :2], np.nan)
        doubtful = np.flatnonzero(~found & self._bank.usable)
        if doubtful.size:
            self._search(luma, doubtful, raw, continuous=continuous, found=found, now=now)
            self._finish(luma, start, raw, found)
        self._judge_sightings(np.flatnonzero(found & (~followed | ~self._seen | self._unsure)), raw, found, now)
        raw.outcome[~found, 0], raw.outcome[~found, 2] = FAILED, np.nan
        # A jump that the search bridged says nothing about the next step.
        steady = found & self._seen & followed
        self._step = np.where(steady[:, None], raw.warps[:, :2] - self._last[:, :2], 0.0)
        self._last[found] = raw.warps[found]
        self._seen, self._outside = found, ~found & (left | self._outside)
        self._whereabouts.add(np.where((found & ~self._unsure)[:, None], raw.warps[:, :2], np.nan))
        missing = np.where(self._outside, Status.OUTSIDE, Status.LOST)
        return raw, np.where(found, np.where(self._unsure, Status.UNRELIABLE, Status.OK), missing)

    def _judge_sightings(self, rows: IntArray, raw: RawRegistration, found: BoolArray, now: FloatArray) -> None:
        """Takes what cannot be the point out of what was ``found`` (P,), and keeps in mind what may be another.

        ``now`` are the places of the points that were followed without a break, shape (P, 2) [px].
        """
        self._unsure &= found
        for p in rows.tolist():
            expected = self._whereabouts.expect(p, now)
            sighting = self._judge(p, raw.warps[p, :2], float(raw.correlation[p]), expected)
            self._unsure[p] = sighting == Sighting.UNSURE
            if sighting == Sighting.OTHER:
                found[p] = False
                # The next search begins where the point itself may be.
                self._last[p, :2] = expected.center

    def _judge(self, p: int, place: FloatArray, correlation: float, expected: Disc) -> Sighting:
        """Whether what was found at a place (2,) [px], with a correlation, is a point that was lost."""
        if p not in self._alike:
            radius_px = _FAR * self._settings.search_radius_px
            _, away, alike = self._find_alike(np.array([p]), radius_px, _PEAKS_FAR)
            self._alike[p] = LookAlikes(away, alike)
        return judge_sighting(place, self._alike[p].as_good_as(correlation), expected)

    def _clearance(self, warps: FloatArray, luma: LumaArray) -> FloatArray:
        """Smallest distance between the subsets at these places and the border of the image, shape (P,) [px]."""
        limit = np.array(luma.shape[::-1]) - 1
        return np.asarray(np.minimum(warps[:, :2], limit - warps[:, :2]).min(axis=1) - self._half)

    def _register(self, luma: LumaArray, rows: IntArray, warps: FloatArray) -> RawRegistration:
        return self._bank.run(luma, rows, warps, max_iterations=self._settings.max_iterations, executor=self._executor)

    def _peaks(
        self, luma: LumaArray, rows: IntArray, warps: FloatArray, radius_px: int, count: int
    ) -> tuple[IntArray, FloatArray]:
        """Subset and centre (K, 2) of the correlation peaks around warps (P, 6), for some of the P subsets."""

        def search(p: int) -> FloatArray:
            template, design = self._templates.cut(p, warps[p, 2:])
            return correlation_peaks(template, luma, warps[p, :2], radius_px=radius_px, count=count, design=design)

        centers = list(self._executor.map(search, rows.tolist()))
        owners = np.repeat(rows, [len(c) for c in centers])
        return owners, self._bank.hold_along_edges(owners, np.concatenate([np.empty((0, 2)), *centers]))

    def _search(
        self,
        luma: LumaArray,
        doubtful: IntArray,
        raw: RawRegistration,
        *,
        continuous: BoolArray,
        found: BoolArray,
        now: FloatArray,
    ) -> None:
        """Looks for subsets around where they may be; enters what is found into ``raw`` and ``found``."""
        around, expected = self._last.copy(), {}
        for p in doubtful[~self._seen[doubtful]].tolist():
            expected[p] = self._whereabouts.expect(p, now)
            if expected[p].radius <= self._settings.search_radius_px:
                around[p, :2] = expected[p].center
        owners, centers = self._peaks(luma, doubtful, around, self._settings.search_radius_px, _PEAKS)
        tried = self._register(luma, owners, np.concatenate([centers, self._last[owners, 2:]], axis=1))
        scores = np.where(tried.converged, tried.correlation, -np.inf)
        own_scores = np.where(continuous, raw.correlation, -np.inf)
        for k, p in enumerate(owners.tolist()):
            if p in expected and scores[k] >= self._settings.minimum_correlation:
                other = self._judge(p, tried.warps[k, :2], float(scores[k]), expected[p]) == Sighting.OTHER
                scores[k] = -np.inf if other else scores[k]
        for p in doubtful:
            mine = np.flatnonzero(owners == p)
            score = scores[mine]
            best = max(own_scores[p], score.max(initial=-np.inf))
            if best < self._settings.minimum_correlation:
                continue
            if own_scores[p] >= best - AMBIGUITY_MARGIN:  # among equals the continuous one
                found[p] = True
                continue
            winner = mine[score.argmax()]
            if not has_rival(score, tried.warps[mine, :2], int(score.argmax())):
                found[p] = True
                raw.warps[p], raw.outcome[p] = tried.warps[winner], tried.outcome[winner]

    def _finish(self, luma: LumaArray, start: FloatArray, raw: RawRegistration, found: BoolArray) -> None:
        """Registers from their starts (P, 6) again, with more care, what is there and came to no end; enters it."""
        rows = np.flatnonzero(~found & ~raw.converged & (raw.correlation >= self._settings.reliable_correlation))
        if not rows.size:
            return
        most = self._settings.max_iterations
        again = self._bank.run(luma, rows, start[rows], max_iterations=most, exact=True, executor=self._executor)
        moved = np.full(len(found), np.nan)
        moved[rows] = np.hypot(*(again.warps[:, :2] - start[rows, :2]).T)
        ok = again.converged & (again.correlation >= self._settings.reliable_correlation)
        ok &= self._within_reach(moved)[rows]
        found[rows[ok]] = True
        raw.warps[rows[ok]], raw.outcome[rows[ok]] = again.warps[ok], again.outcome[ok]

    def _within_reach(self, moved: FloatArray) -> BoolArray:
        """Whether steps from the predicted place (P,) [px] are too short to end at a look-alike by mistake.

        Limits are half the way to the nearest place of the reference frame that looks the same, or the search radius.
        Those places lie further apart than twice `_SAFE_PX`, so that shorter steps need no look at the reference.
        """
        unknown = np.flatnonzero((moved > _SAFE_PX) & np.isnan(self._reach) & self._bank.usable)
        if unknown.size:
            radius_px = self._settings.search_radius_px
            owners, away, correlation = self._find_alike(unknown, radius_px, _PEAKS_IN_REFERENCE)
            alike = correlation >= LOOK_ALIKE
            self._reach[unknown] = radius_px
            np.minimum.at(self._reach, owners[alike], np.hypot(*away[alike].T) / 2)
        return (moved <= _SAFE_PX) | (moved <= self._reach)

    def _find_alike(self, rows: IntArray, radius_px: int, count: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Subset, vector (K, 2) [px] and correlation (K,) of places in the reference frame that resemble a subset."""
        home = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], (len(self._bank), 1))
        home[:, :2] = self._bank.centers
        owners, centers = self._peaks(self._reference, rows, home, radius_px, count)
        starts = np.concatenate([centers, home[owners, 2:]], axis=1)
        tried = self._register(self._reference, owners, starts)
        away = tried.warps[:, :2] - home[owners, :2]
        apart = tried.converged & (np.hypot(*away.T) > DISTINCT_PX)
        return owners[apart], away[apart], tried.correlation[apart]


def _at_home(bank: SubsetBank) -> FollowState:
    """Subsets where they are in the reference frame."""
    count = len(bank)
    warps = np.concatenate([bank.centers, np.tile([1.0, 0.0, 0.0, 1.0], (count, 1))], axis=1)
    return FollowState(warps, bank.usable, ~bank.inside, np.zeros(count, np.bool_))
