"""What finished tracks say, whoever wrote them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.errors import ResultsError

__all__ = ["ForeignTracks", "whole_frames"]

_MOST_FRAMES = 2**31


@dataclass(frozen=True, eq=False)
class ForeignTracks:
    """Tracks of one view as another program gives them.

    Parameters
    ----------
    position
        Positions, shape (T, S, 2) [px]; where ``homes`` are given, motion relative to them. NaN where there is none.
    std
        Their standard deviations along u and v, shape (T, S, 2) [px]; NaN where nothing is stated.
    doubtful
        Samples that stand, but are not to be trusted, shape (T, S).
    names
        Names of the points, length S; none of programs whose subsets have no names.
    homes
        Places of the subsets in the reference frame, shape (S, 2) [px]; none where points have names.
    frames
        Numbers of the frames, shape (T,); ``None`` where times are stated, or where every frame is there.
    time_s
        Times of the frames on the view's own clock, shape (T,) [s]; ``None`` where numbers are stated.
    program
        Who wrote them.
    """

    position: FloatArray
    std: FloatArray
    doubtful: BoolArray
    names: tuple[str, ...] = ()
    homes: FloatArray | None = None
    frames: IntArray | None = None
    time_s: FloatArray | None = None
    program: str = "table"


def whole_frames(path: Path, numbers: FloatArray) -> IntArray:
    """Numbers of frames as whole numbers, shape (T,).

    Parameters
    ----------
    path
        Their file, for the message.
    numbers
        As they were read, shape (T,).

    Raises
    ------
    ResultsError
        One of them is no number of a frame, or stands there twice.

    Examples
    --------
    >>> whole_frames(Path("left.csv"), np.array([0.0, 2.0])).tolist()
    [0, 2]
    """
    wrong = ~((numbers >= 0) & (numbers < _MOST_FRAMES) & (numbers == np.rint(numbers)))
    if wrong.any() or np.unique(numbers).size < numbers.size:
        got = f"{numbers[wrong][0]:g}" if wrong.any() else "one of them twice"
        raise ResultsError(f"{path}: expected whole numbers of frames from 0 on, each once, got {got}; correct them")
    return numbers.astype(np.int64)
