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

__all__ = ["IN_A_ROW", "Tried", "try_candidates"]

IN_A_ROW = 96
"""Frames in a row that are tracked: the filter for noise near the Nyquist frequency needs 82 of them."""
_SPREAD = 20
"""Frames beside them, spread over the recording: as many as subsets are designed from."""


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
    """

    followed: FloatArray
    covariance: FloatArray
    scattered: bool
    moved: FloatArray
    parts_apart: FloatArray

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
    in_a_row: int = IN_A_ROW,
) -> Tried:
    """Tracks of candidates over the first frames and some spread over the rest.

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
    in_a_row
        First frames that are tracked beside those spread over the recording; 1 for a quick look at what moves.

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
        return Tried(np.zeros(count), nothing, False, np.full((1, count, 2), np.nan), np.zeros(count))
    names = [str(number) for number in np.flatnonzero(known)]
    excerpt = Video(_Excerpt(video, in_a_row))
    if choices is not None and isinstance(tracker, DesignedTracker):
        designs = [one.design for one, there in zip(choices, known, strict=True) if there]
        tracks = tracker.track(excerpt, pixels[known], names=names, designs=designs)
    else:
        tracks = tracker.track(excerpt, pixels[known], names=names)
    return _describe(tracks, known, in_a_row)


def _describe(tracks: xr.Dataset, known: BoolArray, in_a_row: int) -> Tried:
    """The tracks of the known ones among all candidates."""
    row = min(in_a_row, tracks.sizes["time"]) if in_a_row > 1 else tracks.sizes["time"]
    burst = include_lone_errors(include_track_noise(tracks.isel(time=slice(0, row))))
    good = tracks["status"].values == Status.OK
    covariance = burst["position_covariance"].values.copy()
    # In the reference frame the position is given.
    covariance[~good[:row] | (covariance == 0).all(axis=(2, 3))] = np.nan
    moved = np.where(good[..., None], tracks["position"].values, np.nan)
    followed, typical = np.zeros(len(known)), np.full((len(known), 2, 2), np.nan)
    followed[known], typical[known] = good.mean(axis=0), _median(covariance)
    all_moved = np.full((len(moved), len(known), 2), np.nan)
    all_moved[:, known] = moved - _median(moved)
    apart = np.zeros(len(known))
    if "part_gain_std" in tracks:
        apart[known] = np.nan_to_num(tracks["part_gain_std"].values).max(axis=1)
    return Tried(followed, typical, bool(np.isfinite(burst["scatter"].values).any()), all_moved, apart)


def _median(values: FloatArray) -> FloatArray:
    """Median over the first axis of what is known; NaN where nothing is."""
    some = np.isfinite(values).any(axis=0)
    return np.where(some, np.nanmedian(np.where(some, values, 0.0), axis=0), np.nan)


class _Excerpt:
    """Source of the first frames of a view, and of some spread over the rest of it, in order."""

    def __init__(self, video: Video, in_a_row: int) -> None:
        self._video, self._in_a_row = video, in_a_row

    @property
    def info(self) -> VideoInfo:
        """That of the whole view."""
        return replace(self._video.info, frame_count=None, duration_s=None)

    def stream(self) -> Generator[Frame]:
        """A fresh pass over them, numbered from 0."""
        number, last_s = 0, -np.inf
        with closing(self._first()) as frames:
            for frame in frames:
                yield replace(frame, index=number)
                number, last_s = number + 1, frame.time_s
        for frame in self._video.spread(_SPREAD):
            if frame.time_s > last_s:
                yield replace(frame, index=number)
                number, last_s = number + 1, frame.time_s

    def _first(self) -> Generator[Frame]:
        yield from self._video.frames(stop=self._in_a_row)
