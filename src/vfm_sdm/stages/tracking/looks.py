"""Where points are as segments of a recording begin, found by looks at single frames."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.tracking.follow import Follower, FollowState

__all__ = ["Look", "plan_looks", "take_look"]

_WIDER = (2, 4, 8)
"""Times the search radius in which a point is looked for that is not found nearer."""
_BETWEEN_S = 2.0
"""Time between two looks at least [s]: many motions of a structure, and few frames of a recording."""
_RUNS, _SPREAD = 8, 32
"""Runs of frames, and frames in all, that are spread over a segment."""


@dataclass(frozen=True, eq=False)
class Look:
    """A look at the first frame of a segment, and at others where one does not tell enough.

    Parameters
    ----------
    video
        The view.
    number
        Number of the frame in it.
    between, within
        Numbers of frames with which decoding can begin, between the look before and this one, and in the segment.
    end
        Number of the frame with which the next segment begins; ``None`` after the last one.
    """

    video: Video
    number: int
    between: tuple[int, ...] = ()
    within: tuple[int, ...] = ()
    end: int | None = None

    def luma(self) -> LumaArray | None:
        """The frame, shape (H, W); ``None`` where it is damaged."""
        return _decode(self.video, self.number)

    def steps(self) -> Iterator[LumaArray]:
        """Frames between the look before and this one, each of shape (H, W)."""
        found = (_decode(self.video, number) for number in self.between)
        return (luma for luma in found if luma is not None)

    def frame(self) -> Video:
        """The frame as a recording of its own."""
        return self.video.part(self.number, 1)

    def backwards(self) -> "Look":
        """The look from a later time: what lies between are the frames of the segment, the last one first."""
        return replace(self, between=tuple(number for number in reversed(self.within) if number != self.number))

    def runs(self) -> Iterator[Iterator[LumaArray]]:
        """Runs of successive frames spread over the segment, each frame of shape (H, W), without the first one."""
        chosen = np.linspace(0, len(self.within) - 1, min(_RUNS, len(self.within))).round().astype(int).tolist()
        count = _SPREAD // max(len(chosen), 1) + 1
        for begin in (self.within[k] for k in chosen):
            left = count if self.end is None else min(count, self.end - begin)
            run = self.video.part(begin, left).frames()
            yield (frame.luma for frame in run if frame.index != self.number)


def plan_looks(video: Video, firsts: Sequence[int]) -> list[Look]:
    """Looks at the first frames of all segments but the first one.

    Parameters
    ----------
    video
        The view.
    firsts
        Numbers of the segments' first frames.
    """
    keys = video.keys(_BETWEEN_S)
    looks = []
    for (before, first), after in zip(pairwise(firsts), [*firsts[2:], None], strict=True):
        between = tuple(k for k in keys if before < k < first)
        within = (first, *(k for k in keys if k > first and (after is None or k < after)))
        looks.append(Look(video, first, between, within, after))
    return looks


def take_look(
    look: Look,
    luma: LumaArray,
    last: FollowState | None,
    make: Callable[[FollowState | None, int], Follower],
    radius_px: int,
) -> FollowState:
    """Where points are as a segment begins.

    Parameters
    ----------
    look
        The look at its first frame.
    luma
        The frame, shape (H, W).
    last
        Where they were at the look before; ``None`` is where they are in the reference frame.
    make
        Function that makes a follower, of a state and a search radius [px].
    radius_px
        Search radius [px].

    Notes
    -----
    A point that was seen before and is not found is looked for in the frames between, which it reaches by shorter
    steps; then in wider circles.
    """
    state = make(last, radius_px).look(luma)
    if _missing(state, last) and look.between:
        steps = make(last, radius_px)
        for frame in look.steps():
            steps.look(frame)
        state = steps.look(luma)
    for times in _WIDER:
        if not _missing(state, last):
            break
        state = make(_before(state), times * radius_px).look(luma)
    return state


def _missing(state: FollowState, before: FollowState | None) -> bool:
    """Whether a point is gone that was seen before, and did not leave the image."""
    seen = np.ones(len(state.seen), np.bool_) if before is None else before.seen
    return bool((seen & ~state.seen & ~state.outside).any())


def _before(state: FollowState) -> FollowState:
    """A state without its last look."""
    return FollowState(state.warps, state.seen, state.outside, state.unsure, state.looks[:-1])


def _decode(video: Video, number: int) -> LumaArray | None:
    """One frame, shape (H, W); ``None`` where it is damaged."""
    try:
        return video.part(number, 1).frame(number).luma
    except VideoError:
        return None
