"""Where points are as segments of a recording begin, found by looks at single frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.stages.tracking.follow import Follower, FollowState

__all__ = ["Look", "find_starts"]

_WIDER = (2, 4, 8)
"""Times the search radius in which a point is looked for that is not found nearer."""


@dataclass(frozen=True)
class Look:
    """First frame of a segment.

    Parameters
    ----------
    luma
        Function that decodes the frame, shape (H, W); it returns ``None`` where that is damaged.
    between
        The same of frames between it and the look before, in their order.
    """

    luma: Callable[[], LumaArray | None]
    between: Sequence[Callable[[], LumaArray | None]] = ()


def find_starts(
    looks: Sequence[Look], make: Callable[[FollowState | None, int], Follower], radius_px: int
) -> list[FollowState | None]:
    """Where points are as each segment begins.

    Parameters
    ----------
    looks
        First frames of the segments in their order.
    make
        Function that makes a follower, of a state and a search radius [px].
    radius_px
        Search radius [px].

    Returns
    -------
    states
        One a segment; that before where the frame is damaged, and ``None`` before the first one.

    Notes
    -----
    A point that was seen before and is not found is looked for in the frames between, which it reaches by shorter
    steps; then in wider circles.
    """
    states: list[FollowState | None] = []
    last: FollowState | None = None
    for look in looks:
        luma = look.luma()
        if luma is None:
            states.append(last)
            continue
        state = make(last, radius_px).look(luma)
        if _missing(state, last) and look.between:
            steps = make(last, radius_px)
            for decode in look.between:
                if (frame := decode()) is not None:
                    steps.look(frame)
            state = steps.look(luma)
        for times in _WIDER:
            if not _missing(state, last):
                break
            state = make(_before(state), times * radius_px).look(luma)
        states.append(state)
        last = state
    return states


def _missing(state: FollowState, before: FollowState | None) -> bool:
    """Whether a point is gone that was seen before, and did not leave the image."""
    seen = np.ones(len(state.seen), np.bool_) if before is None else before.seen
    return bool((seen & ~state.seen & ~state.outside).any())


def _before(state: FollowState) -> FollowState:
    """A state without its last look."""
    return FollowState(state.warps, state.seen, state.outside, state.unsure, state.looks[:-1])
