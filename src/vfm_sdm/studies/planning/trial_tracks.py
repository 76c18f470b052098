"""Candidates tracked on a part of the recordings: can they be followed, how well, and do they move."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.inputs.video import Video
from vfm_sdm.inputs.video.records import Frame, VideoInfo
from vfm_sdm.stages.tracking.base import DesignedTracker, Tracker
from vfm_sdm.stages.tracking.lone_errors import include_lone_errors
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.stages.tracking.track_noise import include_track_noise

__all__ = ["FrameRow", "Tried", "choose_row", "try_candidates"]

_IN_A_ROW = 96
"""Frames in a row that are tracked: the filter for noise near the Nyquist frequency needs 82 of them."""
_MOST_PIXELS = 1_500_000_000
"""Pixels that may be decoded to reach the row: some seconds, as `Video.spread` allows itself."""
_SPREAD = 20
"""Frames beside them, spread over the recording: as many as subsets are designed from."""


@dataclass(frozen=True)
class FrameRow:
    """Frames in a row that are tracked beside the first one and those spread over the recording.

    Parameters
    ----------
    start
        Number of the first of them.
    count
        How many; 1 for a quick look at what moves.
    """

    start: int = 0
    count: int = _IN_A_ROW


@dataclass(frozen=True, eq=False)
class Tried:
    """What trial tracks of one view show of P candidates.

    Parameters
    ----------
    followed
        Share of the frames in which each was followed with status ok, shape (P,) [1].
    covariance
        Typical covariance of one frame's position, raised to the scatter that the tracks show, shape (P, 2, 2) [px2].
    scattered
        Whether the row of frames was long enough to show scatter, that is, the errors of a codec, too.
    moved
        Positions less their median over time, shape (T, P, 2) [px]; NaN where a point was not followed.
    parts_apart
        Spread of the gains of the parts of each subset, shape (P,) [1]; 0 where none was seen.
    time_s
        Times of the frames, shape (T,) [s].
    """

    followed: FloatArray
    covariance: FloatArray
    scattered: bool
    moved: FloatArray
    parts_apart: FloatArray
    time_s: FloatArray

    def std_px(self) -> FloatArray:
        """Standard deviation of one frame in the worst direction, shape (P,) [px]; infinite where not followed."""
        known: BoolArray = np.asarray(np.isfinite(self.covariance).all(axis=(1, 2)))
        worst = np.linalg.eigvalsh(np.where(known[:, None, None], self.covariance, 0.0))[:, 1]
        return np.where(known, np.sqrt(np.maximum(worst, 0.0)), np.inf)


def try_candidates(
    video: Video,
    pixels: FloatArray,
    tracker: Tracker,
    choices: Sequence[SubsetChoice] | None = None,
    *,
    row: FrameRow | None = None,
) -> Tried:
    """Tracks of candidates over a row of frames and some spread over the rest.

    Parameters
    ----------
    video
        The view.
    pixels
        Places in its first frame, shape (P, 2) [px]; NaN for those that it does not show.
    tracker
        The session's tracker.
    choices
        What the subset of each compares, length P; ``None`` for whole squares.
    row
        Frames in a row; the first ones by default.

    Notes
    -----
    Noise is taken from frames in a row, as in the measurement itself, because the errors of a codec show in time only;
    whether something moves, from all.
    """
    count = len(pixels)
    known: BoolArray = np.asarray(np.isfinite(pixels).all(axis=1))
    if choices is not None:
        known &= np.array([one.design is not None for one in choices], dtype=np.bool_)
    if not known.any():
        nothing = np.full((count, 2, 2), np.nan)
        never = np.full((1, count, 2), np.nan)
        return Tried(np.zeros(count), nothing, False, never, np.zeros(count), np.zeros(1))
    names = [str(number) for number in np.flatnonzero(known)]
    row = row or FrameRow()
    excerpt = Video(_Excerpt(video, row))
    if choices is not None and isinstance(tracker, DesignedTracker):
        designs = [one.design for one, there in zip(choices, known, strict=True) if there]
        tracks = tracker.track(excerpt, pixels[known], names=names, designs=designs)
    else:
        tracks = tracker.track(excerpt, pixels[known], names=names)
    return _describe(tracks, known, row)


def choose_row(video: Video, looked: Tried, moving: BoolArray) -> FrameRow:
    """The row of frames in which a quick look saw the most motion: a codec's errors grow with it.

    Parameters
    ----------
    video
        The view.
    looked
        Trial tracks of a quick look at it.
    moving
        Which of its places move, shape (P,); the first frames are taken where none does.
    """
    known, fps = video.info.frame_count, video.info.fps
    if known is None or not np.isfinite(fps) or not moving.any():
        return FrameRow()
    last = min(known, max(_MOST_PIXELS // (video.info.width * video.info.height), _IN_A_ROW)) - _IN_A_ROW
    square = np.nanmean(np.sum(np.nan_to_num(looked.moved[:, moving]) ** 2, axis=2), axis=1)
    starts = np.arange(0, max(last, 0) + 1, _IN_A_ROW // 8)
    numbers = looked.time_s * fps
    inside = (numbers >= starts[:, None]) & (numbers <= starts[:, None] + _IN_A_ROW)
    mean = np.sum(inside * square, axis=1) / np.maximum(inside.sum(axis=1), 1)
    return FrameRow(int(starts[np.argmax(mean)]))


def _describe(tracks: xr.Dataset, known: BoolArray, row: FrameRow) -> Tried:
    """The tracks of the known ones among all candidates."""
    first = min(row.start, 1)
    last = first + row.count if row.count > 1 else tracks.sizes["time"]
    burst = include_lone_errors(include_track_noise(tracks.isel(time=slice(first, last))))
    good = tracks["status"].values == Status.OK
    covariance = burst["position_covariance"].values.copy()
    # In the reference frame the position is given.
    covariance[~good[first:last] | (covariance == 0).all(axis=(2, 3))] = np.nan
    moved = np.where(good[..., None], tracks["position"].values, np.nan)
    followed, typical = np.zeros(len(known)), np.full((len(known), 2, 2), np.nan)
    followed[known], typical[known] = good.mean(axis=0), _median(covariance)
    all_moved = np.full((len(moved), len(known), 2), np.nan)
    all_moved[:, known] = moved - _median(moved)
    apart = np.zeros(len(known))
    if "part_gain_std" in tracks:
        apart[known] = np.nan_to_num(tracks["part_gain_std"].values).max(axis=1)
    return Tried(
        followed, typical, bool(np.isfinite(burst["scatter"].values).any()), all_moved, apart, tracks["time"].values
    )


def _median(values: FloatArray) -> FloatArray:
    """Median over the first axis of what is known; NaN where nothing is."""
    some = np.isfinite(values).any(axis=0)
    return np.where(some, np.nanmedian(np.where(some, values, 0.0), axis=0), np.nan)


class _Excerpt:
    """Source of the first frame of a view, a row of frames, and some spread over what comes after, in order."""

    def __init__(self, video: Video, row: FrameRow) -> None:
        self._video, self._row = video, row

    @property
    def info(self) -> VideoInfo:
        """That of the whole view."""
        return replace(self._video.info, frame_count=None, duration_s=None)

    def stream(self) -> Generator[Frame]:
        """A fresh pass over them, numbered from 0."""
        number, last_s = 0, -np.inf
        with closing(self._in_a_row()) as frames:
            for frame in frames:
                yield replace(frame, index=number)
                number, last_s = number + 1, frame.time_s
        for frame in self._video.spread(_SPREAD):
            if frame.time_s > last_s:
                yield replace(frame, index=number)
                number, last_s = number + 1, frame.time_s

    def _in_a_row(self) -> Generator[Frame]:
        for frame in self._video.frames(stop=self._row.start + self._row.count):
            if frame.index == 0 or frame.index >= self._row.start:
                yield frame
