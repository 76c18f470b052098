"""Reference frames of a long recording: renewed where light has changed, and taken up again where it comes back."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.core.covariances import measured_variance
from vfm_sdm.core.datasets import Status
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.registration.subsets import RawRegistration, SubsetBank
from vfm_sdm.stages.tracking.base import Targets
from vfm_sdm.stages.tracking.follow import Follower, FollowSettings, FollowState
from vfm_sdm.stages.tracking.looks import Look, take_look
from vfm_sdm.stages.tracking.standings import Standing
from vfm_sdm.stages.tracking.whereabouts import MOST_LOOKS

__all__ = ["References", "add_alike"]

_AGREE_PX = 1.0
"""Distance of two registrations of a point above which one of them found something else [px]."""
_FEWEST = 8
"""Frames that must show a point in both references."""


@dataclass(frozen=True, eq=False)
class _Reference:
    """A reference frame and where the P targets are in it, with what renewals added; NaN for targets without it."""

    number: int
    frame: Video | None
    luma: LumaArray
    points: FloatArray
    covariance: FloatArray

    @classmethod
    def without(cls, number: int, luma: LumaArray, count: int) -> "_Reference":
        """A frame that is no reference of any of so many targets."""
        return cls(number, None, luma.copy(), np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan))

    @property
    def rows(self) -> IntArray:
        """Targets that have it."""
        return np.flatnonzero(np.isfinite(self.points[:, 0]))

    def home(self, rows: IntArray) -> FloatArray:
        """Warps of targets in the frame itself, shape (N, 6)."""
        centers = np.floor(self.points[rows] + 0.5)
        return np.concatenate([centers, np.tile([1.0, 0.0, 0.0, 1.0], (len(rows), 1))], axis=1)

    def places(self, rows: IntArray, warps: FloatArray) -> FloatArray:
        """Where targets are under warps (N, 6) of their subsets, shape (N, 2) [px]."""
        return np.asarray(warps[:, :2] + self._offsets(rows, warps))

    def warps(self, rows: IntArray, places: FloatArray, turned: FloatArray) -> FloatArray:
        """Warps (N, 6) under which targets are at places (N, 2) [px], turned and strained as by others (N, 6)."""
        return np.concatenate([places - self._offsets(rows, turned), turned[:, 2:]], axis=1)

    def _offsets(self, rows: IntArray, warps: FloatArray) -> FloatArray:
        points = self.points[rows]
        offset = points - np.floor(points + 0.5)
        return np.asarray((warps[:, 2:].reshape(-1, 2, 2) @ offset[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class _Seen:
    """Registrations of P targets in F frames: place (F, P, 2) [px], covariance [px2], correlation [1]; else NaN."""

    place: FloatArray
    covariance: FloatArray
    correlation: FloatArray

    @classmethod
    def of(cls, bank: SubsetBank, raw: RawRegistration, ok: BoolArray, where: tuple[IntArray, int]) -> "_Seen":
        """Those of a frame, of the rows of a bank among so many targets."""
        found, (rows, count) = bank.interpret(raw), where
        seen = cls(np.full((1, count, 2), np.nan), np.full((1, count, 2, 2), np.nan), np.full((1, count), np.nan))
        seen.place[0, rows[ok]], seen.covariance[0, rows[ok]] = found.position[ok], found.covariance[ok]
        seen.correlation[0, rows[ok]] = found.correlation[ok]
        return seen

    @classmethod
    def joined(cls, frames: Sequence["_Seen"], count: int) -> "_Seen":
        """Those of several frames."""
        none = cls(np.empty((0, count, 2)), np.empty((0, count, 2, 2)), np.empty((0, count)))
        names = ("place", "covariance", "correlation")
        return cls(*(np.concatenate([getattr(none, name), *(getattr(f, name) for f in frames)]) for name in names))

    def usual(self) -> FloatArray:
        """Correlation in the middle of the frames, shape (P,) [1]; 0 where targets were never seen."""
        filled = np.where(np.isfinite(self.correlation), self.correlation, np.nan)
        known = np.isfinite(filled).any(axis=0)
        return np.where(known, np.nanmedian(np.where(known, filled, 0.0), axis=0), 0.0)


class References:
    """The reference frames of a view's targets, from look to look.

    Parameters
    ----------
    prepare
        Function that makes the bank of targets in a frame.
    settings
        Limits.
    luma
        The frame in which the targets are named, shape (H, W).
    targets
        What is followed.
    executor
        Threads that share the work.
    named
        Which frame that is; the recording's first one when left out.

    Notes
    -----
    **When.** A target's reference has sunk where less than half is left of the way from the highest correlation that
    any look saw, which noise decides, to that below which samples are unreliable: in the segment to come, correlation
    may sink further. A target that is unreliable in the best of cases keeps its first reference.

    **Which.** Of all references so far that have not sunk, the one of least accumulated variance: light that comes back
    ends a chain. Where all have sunk, the frame of the look is the new one.

    **Where.** Both, an old reference and the new one, are registered to frames that are spread over the segment; the
    mean difference is what the target is away from where the new one was cut. What the new reference's own noise
    does to its registrations is the same there and in all later segments, and cancels. What does not: the scatter of
    the mean, and the old reference's error in this light, which is common to all frames; it is as large as each of its
    registrations states, by what light leaves in its residuals. That error is slow and has one sign as light goes on in
    one direction, so that standard deviations are added along a chain, not variances (`add_alike`). Of the old
    references that can be registered, that one counts by which the sum is least.

    **Not.** A frame before which something passes is no reference: the new one must correlate with the frames of the
    segment better than what has sunk, and the old one must have sunk in these, too.
    """

    def __init__(
        self,
        prepare: Callable[[LumaArray, Targets, Executor], SubsetBank],
        settings: FollowSettings,
        luma: LumaArray,
        targets: Targets,
        executor: Executor,
        named: Standing | None = None,
    ) -> None:
        count = len(targets.points)
        home = named or Standing.of_first(targets.points)
        self._prepare, self._settings, self._targets, self._executor = prepare, settings, targets, executor
        self._known = [_Reference(home.number, home.frame, luma, targets.points, np.zeros((count, 2, 2)))]
        self._of = np.zeros(count, np.int64)
        self._state: FollowState | None = None
        self._best = np.full(count, -np.inf)
        self._banks: dict[tuple[int, ...], SubsetBank] = {}
        designs = targets.designs
        if designs is None:
            # Only of designed subsets is it measured how smooth the residuals are, which what light leaves is.
            sides = self._bank(self._known[0], np.arange(count)).subset_px.tolist()
            designs = [SubsetDesign(side) for side in sides]
        self._designed = replace(targets, designs=designs)
        unknown = np.full(2, np.nan)
        self._across = np.array([unknown if one is None else one.direction() for one in designs]).reshape(-1, 2)

    def look(self, look: Look) -> list[Standing]:
        """What the targets are compared with, and where they are, as the next segment begins.

        Parameters
        ----------
        look
            At the segment; where its first frame is damaged, all stays as it was.
        """
        luma = look.luma()
        if luma is not None:
            self._state = self._find(look, luma)
            self._choose(look, luma, self._state)
        return [
            Standing(one.number, one.frame, rows, one.points[rows], one.covariance[rows], self._state_of(rows))
            for one, rows in self._groups()
        ]

    def _groups(self) -> list[tuple[_Reference, IntArray]]:
        return [(self._known[k], np.flatnonzero(self._of == k)) for k in np.unique(self._of).tolist()]

    def _state_of(self, rows: IntArray) -> FollowState | None:
        return None if self._state is None else self._state.of(rows)

    def _bank(self, of: _Reference, rows: IntArray) -> SubsetBank:
        key = (of.number, *rows.tolist())
        bank = self._banks.get(key)
        if bank is None:
            bank = self._prepare(of.luma, self._targets.of(rows, of.points[rows]), self._executor)
            self._banks[key] = bank
        return bank

    def _follower(self, of: _Reference, rows: IntArray, state: FollowState | None, radius_px: int) -> Follower:
        settings = replace(self._settings, search_radius_px=radius_px)
        return Follower(self._bank(of, rows), of.luma, settings, self._executor, state)

    def _find(self, look: Look, luma: LumaArray) -> FollowState:
        """Where the targets are, each by its reference."""
        found, groups = [], self._groups()
        for of, rows in groups:
            make, last = partial(self._follower, of, rows), self._state_of(rows)
            state = take_look(look, luma, last, make, self._settings.search_radius_px)
            if len(groups) > 1 and last is not None:
                # Frames between two looks, which not all need, are no looks of all.
                state = replace(state, looks=(*last.looks, state.looks[-1])[-MOST_LOOKS:])
            found.append((rows, state))
        return FollowState.joined(found)

    def _choose(self, look: Look, luma: LumaArray, state: FollowState) -> None:
        """Takes the reference that each target is to have from here on."""
        correlation, warps = self._compare(luma, state)
        reliable = self._settings.reliable_correlation
        self._best = np.fmax(self._best, np.nan_to_num(correlation, nan=-np.inf).max(axis=0))
        enough = np.where(self._best > reliable, (self._best + reliable) / 2, -np.inf)
        variance = np.array([measured_variance(one.covariance, self._across) for one in self._known])
        kept = np.where(correlation >= enough, variance, np.inf)
        reliable_ones = np.where(correlation >= reliable, variance, np.inf)
        sinking = np.isinf(kept).all(axis=0) & (correlation >= self._settings.minimum_correlation)
        renewed = self._renew(look, luma, np.where(sinking[..., None], warps, np.nan), enough)
        if renewed.rows.size:
            self._known.append(renewed)
        for row in range(len(self._of)):
            of_row = kept[:, row]
            if np.isfinite(renewed.points[row, 0]):
                self._take(row, (len(self._known) - 1, renewed), renewed.home(np.array([row]))[0], state)
                continue
            if np.isinf(of_row).all() and not correlation[self._of[row], row] >= reliable:
                of_row = reliable_ones[:, row]
            best = int(of_row.argmin())
            if np.isfinite(of_row[best]) and best != self._of[row]:
                self._take(row, (best, self._known[best]), warps[best, row], state)
        live = {(one.number, *rows.tolist()) for one, rows in [*self._groups(), *((k, k.rows) for k in self._known)]}
        self._banks = {key: bank for key, bank in self._banks.items() if key in live}

    def _take(self, row: int, chosen: tuple[int, _Reference], warp: FloatArray, state: FollowState) -> None:
        """Gives a target a reference, with its number among all, under a warp (6,) of which it was found."""
        index, of = chosen
        moved = (self._turn_to(of, np.array([row]), state) - state.warps[[row]])[0, :2]
        for places in state.looks[:-1]:
            places[row] += moved
        state.looks[-1][row], state.warps[row] = warp[:2], warp
        state.seen[row], state.outside[row], state.unsure[row] = True, False, False
        self._of[row] = index

    def _turn_to(self, of: _Reference, rows: IntArray, state: FollowState) -> FloatArray:
        """Warps of targets by a reference under which they are where they were found last, shape (N, 6)."""
        found = np.empty((len(rows), 6))
        for own, mine in self._groups():
            some = np.isin(rows, mine)
            last = state.warps[rows[some]]
            found[some] = of.warps(rows[some], own.places(rows[some], last), last)
        return found

    def _compare(self, luma: LumaArray, state: FollowState) -> tuple[FloatArray, FloatArray]:
        """Correlations (K, P) [1] and warps (K, P, 6) of the P targets in a frame by all K references; else NaN.

        Targets that the own reference does not find are looked for by the others.
        """
        shape = len(self._known), len(self._of)
        correlation, warps = np.full(shape, np.nan), np.full((*shape, 6), np.nan)
        found = state.seen & ~state.unsure
        for index, of in enumerate(self._known):
            rows = of.rows
            start = self._turn_to(of, rows, state)
            start[~found[rows]] = np.nan
            for k in np.flatnonzero(~found[rows] & ~state.outside[rows] & (self._of[rows] != index)).tolist():
                start[k] = self._search(luma, of, rows[k : k + 1], state)
            bank, most = self._bank(of, rows), self._settings.max_iterations
            raw = bank.run(luma, np.arange(len(rows)), start, max_iterations=most, exact=True, executor=self._executor)
            ok = raw.converged & (np.hypot(*(raw.warps[:, :2] - start[:, :2]).T) <= _AGREE_PX)
            ok &= found[rows] | (raw.correlation >= self._settings.reliable_correlation)
            correlation[index, rows] = np.where(ok, raw.correlation, np.nan)
            warps[index, rows] = np.where(ok[:, None], raw.warps, np.nan)
        return correlation, warps

    def _search(self, luma: LumaArray, of: _Reference, row: IntArray, state: FollowState) -> FloatArray:
        """Warp (6,) of a target, shape (1,), that is looked for around where it was last; NaN where it is not found."""
        own = state.of(row)
        warps = self._turn_to(of, row, state)
        looks = tuple(places + (warps - own.warps)[:, :2] for places in own.looks[:-1])
        start = FollowState(warps, own.seen, own.outside, own.unsure, looks)
        found = self._follower(of, row, start, self._settings.search_radius_px).look(luma)
        return found.warps[0] if found.seen[0] and not found.unsure[0] else np.full(6, np.nan)

    def _renew(self, look: Look, luma: LumaArray, warps: FloatArray, enough: FloatArray) -> _Reference:
        """The look's frame as a reference of those targets that have a place in it.

        ``warps`` are those of targets whose references have sunk, by the K that can be registered, shape (K, P, 6),
        else NaN; ``enough`` is the correlation (P,) below which a reference has sunk.
        """
        count = len(self._of)
        cut, new = (_Reference.without(look.number, luma, count) for _ in range(2))
        known: list[tuple[_Reference, IntArray, FloatArray]] = []
        for of, warp in zip(self._known, warps, strict=True):
            rows = np.flatnonzero(np.isfinite(warp[:, 0]))
            if rows.size:
                known.append((of, rows, warp[rows]))
                cut.points[rows] = of.places(rows, warp[rows])
        if not known:
            return new
        (of_new, *of_old), runs = self._watch(look, [(cut, cut.rows, cut.home(cut.rows)), *known])
        sunk = np.array([seen.usual() for seen in of_old]).max(axis=0) < enough
        fresh = of_new.usual() >= enough
        size = np.full(count, np.inf)
        for (of, some, _), seen in zip(known, of_old, strict=True):
            for row in some.tolist():
                link = _link(of_new, seen, row, runs)
                if sunk[row] and fresh[row] and link is not None:
                    total = add_alike(of.covariance[row], _hold_along(link[1], self._across[row]))
                    variance = float(measured_variance(total[None], self._across[[row]])[0])
                    if variance < size[row]:
                        size[row], new.covariance[row] = variance, total
                        new.points[row] = cut.points[row] - link[0]
        return replace(new, frame=look.frame().on_one_thread())

    def _watch(
        self, look: Look, started: Sequence[tuple[_Reference, IntArray, FloatArray]]
    ) -> tuple[list[_Seen], IntArray]:
        """What references see of targets in F frames of a segment, from their warps (N, 6) on; and the frames' runs."""
        banks = [
            self._prepare(of.luma, self._designed.of(rows, of.points[rows]), self._executor) for of, rows, _ in started
        ]
        seen: list[list[_Seen]] = [[] for _ in started]
        runs = []
        for number, run in enumerate(look.runs()):
            followers = []
            for bank, (of, _, warps) in zip(banks, started, strict=True):
                no = np.zeros(len(warps), np.bool_)
                start = FollowState(warps, bank.usable, no, no)
                followers.append(Follower(bank, of.luma, self._settings, self._executor, start))
            for luma in run:
                runs.append(number)
                for bank, follower, into, (_, rows, _) in zip(banks, followers, seen, started, strict=True):
                    raw, status = follower.advance(luma)
                    into.append(_Seen.of(bank, raw, status == Status.OK, (rows, len(self._of))))
        return [_Seen.joined(of_one, len(self._of)) for of_one in seen], np.array(runs, np.int64)


def add_alike(first: FloatArray, second: FloatArray) -> FloatArray:
    """Covariance of the sum of two errors of which nobody knows how alike they are: standard deviations add up.

    Parameters
    ----------
    first, second
        Covariances, shape (2, 2) [px2].

    Notes
    -----
    ``(1 + s2 / s1) C1 + (1 + s1 / s2) C2`` with ``s`` the roots of the traces: not less than the covariance of the sum
    in any direction, however the errors are correlated.

    Examples
    --------
    >>> add_alike(np.diag([0.01, 0.0]), np.diag([0.04, 0.0])).round(9).tolist()
    [[0.09, 0.0], [0.0, 0.0]]
    """
    of_first, of_second = (float(np.sqrt(max(np.trace(one), 0.0))) for one in (first, second))
    if of_first == 0 or of_second == 0:
        return first + second
    ratio = of_second / of_first
    return (1 + ratio) * first + (1 + 1 / ratio) * second


def _link(new: _Seen, old: _Seen, row: int, runs: IntArray) -> tuple[FloatArray, FloatArray] | None:
    """How far a new reference sees a target beside where an old one sees it, shape (2,) [px], and the covariance [px2].

    ``None`` where the frames do not tell.
    """
    both = np.isfinite(new.correlation[:, row]) & np.isfinite(old.covariance[:, row, 0, 0])
    if both.sum() < max(_FEWEST, len(both) // 2):
        return None
    apart = new.place[both, row] - old.place[both, row]
    shift = apart.mean(axis=0)
    if np.hypot(*shift) > _AGREE_PX:
        return None
    # Frames of one run hold the noise of each other, as codecs make them.
    scatter = np.cov(apart.T) / len(np.unique(runs[both]))
    return shift, old.covariance[both, row].mean(axis=0) + scatter


def _hold_along(covariance: FloatArray, across: FloatArray) -> FloatArray:
    """What a covariance (2, 2) says across an edge, where the point is one; along it nothing is measured."""
    if not np.isfinite(across).all():
        return covariance
    return np.asarray(float(across @ covariance @ across) * np.outer(across, across))
