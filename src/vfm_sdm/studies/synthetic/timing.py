"""When frames are taken and which are written: variable rates, dropped and repeated frames."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.errors import DatasetError

__all__ = ["Schedule", "Timing"]


@dataclass(frozen=True, eq=False)
class Schedule:
    """Frames of a file.

    Parameters
    ----------
    stamps
        Time stamps, shape (frames,) [frame intervals].
    repeated
        Whether a frame shows the picture before it once more, shape (frames,).
    """

    stamps: FloatArray
    repeated: BoolArray


@dataclass(frozen=True)
class Timing:
    """A camera that keeps no steady pace.

    Parameters
    ----------
    variation
        Standard deviation of the interval between frames as a share of its mean [1]; stamps say the truth.
    dropped
        Share of frames that are missing, the stamps with them [1].
    repeated
        Share of frames that show the picture before, with a stamp of their own [1].

    Raises
    ------
    DatasetError
        A share is out of its range.
    """

    variation: float = 0.0
    dropped: float = 0.0
    repeated: float = 0.0

    def __post_init__(self) -> None:
        # Up to two standard deviations; intervals stay longer than a third of their mean.
        if not (0 <= self.variation <= 0.3 and min(self.dropped, self.repeated) >= 0 and self.dropped < 0.5):
            raise DatasetError(
                f"timing: expected a variation in [0, 0.3] and shares in [0, 0.5), got {self}; correct them"
            )

    def schedule(self, frames: int, *, seed: tuple[int, ...]) -> Schedule:
        """Frames of a film of so many frame intervals; the first and the last stay.

        Parameters
        ----------
        frames
            Number of frames without drops.
        seed
            Of everything at random.

        Examples
        --------
        >>> schedule = Timing(dropped=0.2).schedule(50, seed=(3,))
        >>> bool(len(schedule.stamps) < 50), float(schedule.stamps[-1])
        (True, 49.0)
        """
        paces, losses, repeats = (np.random.default_rng((*seed, stream)) for stream in range(3))
        intervals = 1 + self.variation * np.clip(paces.standard_normal(frames - 1), -2, 2)
        stamps = np.concatenate([[0.0], np.cumsum(intervals)])
        kept = losses.random(frames) >= self.dropped
        kept[[0, -1]] = True
        repeated = repeats.random(frames) < self.repeated
        repeated[0] = False
        return Schedule(stamps[kept], repeated[kept])
