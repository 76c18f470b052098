"""A few frames spread over a recording, cut to windows around points."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.tracking.design.whole_picture import PictureMotion, cut_turned

__all__ = ["SampledWindows", "find_covered", "find_hidden", "sample_windows"]

SAMPLES = 20
"""Frames that are looked at: motion of 0.1 px (rms) in noise of 0.1 px is then seen at four standard deviations."""

_REACH_PX = 10
"""How far texture may move and still explain a change [px]."""
_CLEAR = 5.0
"""Times the noise by which a pixel must lie outside all that its surroundings show."""
_COVERED, _MOST_COVERED = 0.1, 1 / 3
"""Share of a window that must be covered, and of the frames that may be, to be left out."""
_FAR_PX = 40
"""How far from its place in the reference frame a point is looked for [px]."""
_SHOWN = 0.6
"""Correlation from which on a sample frame shows the point: below, trackers call it lost."""


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
    turning
        Whether the whole picture moves far, as from a drone: windows of such frames are cut where the picture on the
        whole went, and turned back.
    """

    reference: LumaArray
    windows: Sequence[LumaArray]
    centers: IntArray
    turning: bool = False


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
    motion: PictureMotion | None = None
    turning = False
    for frame in video.spread(count, also=reference_frame):
        if frame.index == reference_frame:
            reference = frame.luma.copy()
            motion = PictureMotion(reference)
            for windows, center in zip(cuts, centers, strict=True):
                windows.insert(0, _cut(frame.luma, center, half_px))
            continue
        homography = None if motion is None else motion.find(frame.luma)
        turning |= homography is not None
        for windows, center in zip(cuts, centers, strict=True):
            if homography is None:
                windows.append(_cut(frame.luma, center, half_px))
            else:
                windows.append(cut_turned(frame.luma, center, half_px, homography))
    if reference is None:
        raise DatasetError(f"reference_frame: expected a frame {reference_frame} of the video; name an earlier one")
    stacks: list[LumaArray] = [np.stack(windows) for windows in cuts]  # type: ignore[misc]  # one depth in a video
    return SampledWindows(reference, stacks, centers, turning)


def find_covered(frames: LumaArray) -> BoolArray:
    """Sample frames in which something passes before a point.

    Parameters
    ----------
    frames
        The window in the reference frame and in K sample frames, shape (K + 1, R, R).

    Returns
    -------
    covered
        Shape (K,); all False where that holds for more than a third of the frames: light that changes, not a passer-by.

    Notes
    -----
    What moves by up to 10 px shows nothing that its surroundings did not show before: a pixel counts as covered if it
    is darker, or brighter, than the middle of all frames is anywhere within this distance, by more than noise.

    Examples
    --------
    >>> frames = np.full((7, 50, 50), 120, np.uint8)
    >>> frames[3, :, 10:40] = 20
    >>> find_covered(frames).tolist()
    [False, False, True, False, False, False]
    """
    usual = np.median(frames, axis=0).astype(np.float32)
    apart = np.abs(frames.astype(np.float32) - usual)
    noise = max(MAD_TO_STD * float(np.median(apart)), 1.0)
    reach = np.ones((2 * _REACH_PX + 1, 2 * _REACH_PX + 1), np.uint8)
    low, high = cv2.erode(usual, reach) - _CLEAR * noise, cv2.dilate(usual, reach) + _CLEAR * noise
    covered = np.asarray(np.mean((frames[1:] < low) | (frames[1:] > high), axis=(1, 2)) > _COVERED)
    return covered if np.mean(covered) <= _MOST_COVERED else np.zeros_like(covered)


def find_hidden(frames: LumaArray, side_px: int) -> BoolArray:
    """Sample frames that do not show what the reference frame shows in the middle of its window.

    Parameters
    ----------
    frames
        The window in the reference frame and in K sample frames, shape (K + 1, R, R).
    side_px
        Side of the square in the middle that is looked for [px].

    Returns
    -------
    hidden
        Shape (K,).

    Examples
    --------
    >>> seen = np.random.default_rng(0).integers(0, 255, (80, 80), np.uint8)
    >>> find_hidden(np.stack([seen, np.roll(seen, 3, axis=1), np.full_like(seen, 20)]), 21).tolist()
    [False, True]
    """
    low = frames.shape[1] // 2 - side_px // 2
    template = frames[0, low : low + side_px, low : low + side_px].astype(np.float32)
    reach = max(low - _FAR_PX, 0)
    around = slice(reach, frames.shape[1] - reach)
    best = [
        float(cv2.matchTemplate(frame[around, around].astype(np.float32), template, cv2.TM_CCOEFF_NORMED).max())
        for frame in frames[1:]
    ]
    return np.array([not score >= _SHOWN for score in best], np.bool_)


def _cut(image: LumaArray, center: IntArray, half: int) -> LumaArray:
    """The window of an image around a pixel, its border repeated where it leaves the image."""
    rows, columns = (
        np.clip(np.arange(middle - half, middle + half + 1), 0, length - 1)
        for middle, length in zip(center[::-1].tolist(), image.shape, strict=True)
    )
    cut: LumaArray = image[np.ix_(rows, columns)]
    return cut
