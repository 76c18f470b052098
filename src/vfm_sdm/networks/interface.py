"""What networks take and yield, without PyTorch."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray

__all__ = ["SEEN", "ChunkNetwork", "ChunkTracks", "Precision", "RgbFrames"]

Precision = Literal["auto", "float32", "bfloat16"]
"""Precision of matrix products; ``auto`` is bfloat16 on GPUs that have it."""

SEEN = 0.5
"""Visibility from which on a point counts as seen."""

RgbFrames = npt.NDArray[np.uint8]
"""Red, green, blue, shape (frames, height, width, 3)."""


@dataclass(frozen=True, eq=False)
class ChunkTracks:
    """Points followed through a chunk of frames.

    Parameters
    ----------
    positions
        Column and row, shape (S, N, 2) [px]; the centre of the top-left pixel is (0, 0).
    visibility
        Probability that a point is seen, shape (S, N), 0 to 1 [1].
    confidence
        Probability that a position is right, shape (S, N), 0 to 1 [1].

    Examples
    --------
    >>> one = ChunkTracks(np.zeros((2, 1, 2)), np.ones((2, 1)), np.ones((2, 1)))
    >>> ChunkTracks.joined(one, one[1:]).positions.shape
    (3, 1, 2)
    """

    positions: FloatArray
    visibility: FloatArray
    confidence: FloatArray

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, frames: slice) -> "ChunkTracks":
        """The tracks in some of the frames."""
        return ChunkTracks(self.positions[frames], self.visibility[frames], self.confidence[frames])

    @classmethod
    def joined(cls, *parts: "ChunkTracks") -> "ChunkTracks":
        """Tracks of several parts of a recording, one part after the other in time, shape (S, N, ...)."""
        names = ("positions", "visibility", "confidence")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class ChunkNetwork(Protocol):
    """A network on its device that follows points through a few frames at a time."""

    @property
    def precision(self) -> str:
        """Precision of its matrix products: ``float32`` or ``bfloat16``."""
        ...

    def follow(self, frames: RgbFrames, queries: FloatArray) -> ChunkTracks:
        """Tracks of points of the first frame through all frames.

        Parameters
        ----------
        frames
            Red, green and blue, shape (S, H, W, 3).
        queries
            Column and row in the first frame, shape (N, 2) [px].

        Raises
        ------
        MemoryError
            The frames do not fit the memory.
        """
        ...

    def plan_frames(self, height: int, width: int) -> int | None:
        """How many frames of one size fit the free memory; ``None`` where that is not known.

        Parameters
        ----------
        height, width
            Size of a frame, shape (height, width, 3) [px].
        """
        ...
