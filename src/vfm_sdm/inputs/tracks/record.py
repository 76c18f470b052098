"""What finished tracks say, whoever wrote them."""

from dataclasses import dataclass

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray

__all__ = ["ForeignTracks"]


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
