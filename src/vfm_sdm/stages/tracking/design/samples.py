"""A few frames spread over a recording, cut to windows around points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.video import Video

__all__ = ["SampledWindows", "sample_windows"]

SAMPLES = 20
"""Frames that are looked at: motion of 0.1 px (rms) in noise of 0.1 px is then seen at four standard deviations."""


@dataclass(frozen=True, eq=False)
class SampledWindows:
    """Windows around points in the reference frame and in frames spread over the recording.

    Parameters
    ----------
    reference
        The whole reference frame, shape (H, W).
    windows
        Windows [v, u] of each point, the reference frame's first, shape (P, K + 1, R, R); its border repeated.
    centers
        Pixel in the middle of each window, shape (P, 2) [px].
    """

    reference: LumaArray
    windows: Sequence[LumaArray]
    centers: IntArray


def sample_windows(
    video: Video, points2d: FloatArray, *, half_px: int, reference_frame: int = 0, count: int = SAMPLES
) -> SampledWindows:
    """Windows around points in the reference frame and in frames spread evenly over the recording.

    Parameters
    ----------
    video
        The view; see `Video.spread` for what is read of it.
    points2d
        Points in the reference frame, shape (P, 2) [px].
    half_px
        Half the side of a window, without its middle [px].
    reference_frame
        Index of the frame in which the points are named.
    count
        Largest number of frames beside the reference frame.

    Raises
    ------
    DatasetError
        The recording ends before the reference frame.
    """
    centers = np.floor(points2d + 0.5).astype(np.int64)
    cuts: list[list[LumaArray]] = [[] for _ in centers]
    reference: LumaArray | None = None
    for frame in video.spread(count, also=reference_frame):
        of_frame = [_cut(frame.luma, center, half_px) for center in centers]
        if frame.index == reference_frame:
            reference = frame.luma.copy()
            for windows, window in zip(cuts, of_frame, strict=True):
                windows.insert(0, window)
        else:
            for windows, window in zip(cuts, of_frame, strict=True):
                windows.append(window)
    if reference is None:
        raise DatasetError(f"reference_frame: expected a frame {reference_frame} of the video; name an earlier one")
    stacks: list[LumaArray] = [np.stack(windows) for windows in cuts]  # type: ignore[misc]  # one depth in a video
    return SampledWindows(reference, stacks, centers)


def _cut(image: LumaArray, center: IntArray, half: int) -> LumaArray:
    """The window of an image around a pixel, its border repeated where it leaves the image."""
    rows, columns = (
        np.clip(np.arange(middle - half, middle + half + 1), 0, length - 1)
        for middle, length in zip(center[::-1].tolist(), image.shape, strict=True)
    )
    cut: LumaArray = image[np.ix_(rows, columns)]
    return cut
