"""Pictures in memory as a recording."""

from collections.abc import Generator, Iterable
from functools import partial

import numpy as np

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.inputs.video.reader import Video
from vfm_sdm.inputs.video.records import Frame, RgbArray, VideoInfo
from vfm_sdm.inputs.video.region import Region

__all__ = ["video_in_memory"]


class _MemorySource:
    """Pictures, one after the other, as a source of frames."""

    def __init__(self, luma: LumaArray, fps: float, bit_depth: int) -> None:
        self._luma, self._bit_depth = luma, bit_depth
        count, height, width = luma.shape
        self.info = VideoInfo("memory", width, height, fps, count, count / fps, "raw", "gray", bit_depth, 0)

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the frames, in order, numbered from 0."""
        for index, picture in enumerate(self._luma):
            yield Frame(index, index / self.info.fps, picture, partial(self._convert, picture))

    def _convert(self, picture: LumaArray, region: Region) -> RgbArray:
        part = region.crop(picture) >> max(self._bit_depth - 8, 0)
        return np.repeat(part[..., None], 3, axis=2).astype(np.uint8)


def video_in_memory(luma: LumaArray | Iterable[LumaArray], *, fps: float, bit_depth: int = 8) -> Video:
    """Pictures as a recording with a constant rate.

    Parameters
    ----------
    luma
        Pictures, shape (T, H, W), uint8 or uint16.
    fps
        Pictures a second [1/s].
    bit_depth
        Significant bits.

    Examples
    --------
    >>> video = video_in_memory(np.zeros((3, 48, 64), np.uint8), fps=10)
    >>> [frame.time_s for frame in video.frames()]
    [0.0, 0.1, 0.2]
    """
    return Video(_MemorySource(np.asarray(luma), fps, bit_depth))
