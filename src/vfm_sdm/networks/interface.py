"""What networks take and yield, without PyTorch."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray

__all__ = ["SEEN", "ChunkNetwork", "ChunkTracks", "Precision", "RgbFrames"]

Precision = Literal["auto", "float32", "bfloat16"]
"""Of matrix products; ``auto`` is bfloat16 on GPUs that have it."""

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
        That a point is seen, shape (S, N), 0 to 1.
    confidence
        That a position is right, shape (S, N), 0 to 1.
    """

    positions: FloatArray
    visibility: FloatArray
    confidence: FloatArray

    def __getitem__(self, frames: slice) -> "ChunkTracks":
        """Some of the frames."""
        return ChunkTracks(self.positions[frames], self.visibility[frames], self.confidence[frames])

    @classmethod
    def joined(cls, *parts: "ChunkTracks") -> "ChunkTracks":
        """One after the other."""
        names = ("positions", "visibility", "confidence")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class ChunkNetwork(Protocol):
    """A network on its device that follows points through a few frames at a time."""

    @property
    def precision(self) -> str:
        """Of its matrix products: ``float32`` or ``bfloat16``."""
        ...

    def follow(self, frames: RgbFrames, queries: FloatArray) -> ChunkTracks:
        """Points of the first frame (N, 2) [px] followed through all (S, H, W, 3).

        Raises
        ------
        MemoryError
            They do not fit.
        """
        ...

    def plan_frames(self, height: int, width: int) -> int | None:
        """How many frames of this size fit the free memory; ``None`` where that is not known."""
        ...
