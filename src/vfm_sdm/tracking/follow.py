"""Points of one view followed from frame to frame: prediction, registration, and search where that fails."""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from vfm_sdm.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.datasets import Status
from vfm_sdm.tracking.coarse import correlation_peaks, cut_subset
from vfm_sdm.tracking.icgn_kernels import FAILED
from vfm_sdm.tracking.subsets import RawRegistration, SubsetBank

__all__ = ["AMBIGUITY_MARGIN", "LOOK_ALIKE", "FollowSettings", "Follower"]

AMBIGUITY_MARGIN = 0.05
"""Two places are as good as one another when their correlations differ by less."""
LOOK_ALIKE = 0.9
"""Correlation of another place in the reference frame from which on a subset counts as repeated."""

_BORDER_PX = 5.0  # a subset that vanishes further from the border, and was not moving there, has not left the image
_DISTINCT_PX = 2.0  # registrations that end closer to each other found the same place
_PEAKS = 4  # places that a search tries: the best, and rivals that would make it ambiguous
_PEAKS_IN_REFERENCE = 12  # more, because the nearest look-alike counts there, not the best


@dataclass(frozen=True)
class FollowSettings:
    """What decides between following, searching and giving up; explained in `vfm_sdm.tracking.icgn.IcgnTracker`."""

    search_radius_px: int
    max_iterations: int
    minimum_correlation: float
    reliable_correlation: float
    predict: bool


class Follower:
    """Follows the subsets of a bank; every frame is registered to the reference, so that errors do not add up.

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
    """

    def __init__(self, bank: SubsetBank, reference: LumaArray, settings: FollowSettings, executor: Executor) -> None:
        self._bank, self._settings, self._executor = bank, settings, executor
        half = bank.subset_px // 2
        self._cuts = {int(p): cut_subset(reference, bank.centers[p], half) for p in np.flatnonzero(bank.inside)}
        identity = np.tile([1.0, 0.0, 0.0, 1.0], (len(bank), 1))
        self._last = np.concatenate([bank.centers, identity], axis=1)  # warps where each was found last
        self._step = np.zeros((len(bank), 2))  # motion over the last two frames, where both were found
        self._seen = bank.usable.copy()
        self._outside = ~bank.inside
        self._reach = self._reach_without_mistake(reference)

    def advance(self, luma: LumaArray) -> tuple[RawRegistration, IntArray]:
        """Registrations in the next frame, and their status: ok, lost or outside, shape (P,)."""
        start = self._last.copy()
        if self._settings.predict:
            start[:, :2] += self._step
        raw = self._register(luma, np.arange(len(self._bank)), start)
        near = np.hypot(*(raw.warps[:, :2] - start[:, :2]).T) <= self._reach
        continuous = raw.converged & near
        found = continuous & (raw.correlation >= self._settings.reliable_correlation)
        left = raw.outside & (self._clearance(start, luma) <= np.hypot(*self._step.T) + _BORDER_PX)
        followed = found.copy()
        doubtful = np.flatnonzero(~found & self._bank.usable)
        if doubtful.size:
            self._search(luma, doubtful, raw, continuous=continuous, found=found)
        raw.outcome[~found, 0], raw.outcome[~found, 2] = FAILED, np.nan
        # A jump that the search bridged says nothing about the next step.
        steady = found & self._seen & followed
        self._step = np.where(steady[:, None], raw.warps[:, :2] - self._last[:, :2], 0.0)
        self._last[found] = raw.warps[found]
        self._seen, self._outside = found, ~found & (left | self._outside)
        return raw, np.where(found, Status.OK, np.where(self._outside, Status.OUTSIDE, Status.LOST))

    def _clearance(self, warps: FloatArray, luma: LumaArray) -> FloatArray:
        """Smallest distance between the subsets at these places and the border of the image, shape (P,) [px]."""
        half = self._bank.subset_px // 2
        limit = np.array(luma.shape[::-1]) - 1
        return np.asarray(np.minimum(warps[:, :2], limit - warps[:, :2]).min(axis=1) - half)

    def _register(self, luma: LumaArray, rows: IntArray, warps: FloatArray) -> RawRegistration:
        return self._bank.run(luma, rows, warps, max_iterations=self._settings.max_iterations, executor=self._executor)

    def _peaks(self, luma: LumaArray, rows: IntArray, count: int) -> tuple[IntArray, FloatArray]:
        """Subset and centre (K, 2) of the correlation peaks around where each subset was found last."""

        def search(p: int) -> FloatArray:
            place, radius_px = self._last[p, :2], self._settings.search_radius_px
            return correlation_peaks(self._cuts[p], luma, place, radius_px=radius_px, count=count)

        centers = list(self._executor.map(search, rows.tolist()))
        owners = np.repeat(rows, [len(c) for c in centers])
        return owners, np.concatenate([np.empty((0, 2)), *centers])

    def _search(
        self, luma: LumaArray, doubtful: IntArray, raw: RawRegistration, *, continuous: BoolArray, found: BoolArray
    ) -> None:
        """Looks for subsets around where they were last; enters what is found into ``raw`` and ``found``."""
        owners, centers = self._peaks(luma, doubtful, _PEAKS)
        tried = self._register(luma, owners, np.concatenate([centers, self._last[owners, 2:]], axis=1))
        scores = np.where(tried.converged, tried.correlation, -np.inf)
        own_scores = np.where(continuous, raw.correlation, -np.inf)
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
            apart = np.hypot(*(tried.warps[mine, :2] - tried.warps[winner, :2]).T) > _DISTINCT_PX
            if not (apart & (score >= best - AMBIGUITY_MARGIN)).any():
                found[p] = True
                raw.warps[p], raw.outcome[p] = tried.warps[winner], tried.outcome[winner]

    def _reach_without_mistake(self, reference: LumaArray) -> FloatArray:
        """Largest step between frames after which a subset cannot be mistaken for a look-alike, shape (P,) [px].

        Half the way to the nearest place of the reference frame that looks the same; the search radius if there is
        none.
        """
        reach = np.full(len(self._bank), float(self._settings.search_radius_px))
        owners, centers = self._peaks(reference, np.flatnonzero(self._bank.usable), _PEAKS_IN_REFERENCE)
        tried = self._register(reference, owners, np.concatenate([centers, self._last[owners, 2:]], axis=1))
        away = np.hypot(*(tried.warps[:, :2] - self._bank.centers[owners]).T)
        alike = tried.converged & (tried.correlation >= LOOK_ALIKE) & (away > _DISTINCT_PX)
        np.minimum.at(reach, owners[alike], away[alike] / 2)
        return reach
