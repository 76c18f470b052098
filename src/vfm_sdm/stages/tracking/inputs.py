"""Steps that all trackers of this package share: checks of their inputs, and the pass over the frames."""

from collections.abc import Callable, Sequence

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray, as_float_array
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.inputs.video import Frame, Video

__all__ = ["check_correlations", "check_counts", "check_points", "find_reference", "follow_frames"]


def check_points(points2d: FloatArray, names: Sequence[str], video: Video) -> FloatArray:
    """The points as an array, after checking them against the picture and their names.

    Parameters
    ----------
    points2d
        Positions of the points, shape (P, 2) [px].
    names
        Point names, length P.
    video
        The view; only its size is used.

    Raises
    ------
    DatasetError
        There is no point, a point lies outside the picture, or the names are not one distinct name a point.
    """
    points = as_float_array(points2d, "points2d", (None, 2))
    if len(points) == 0 or len(names) != len(points) or len(set(names)) != len(names):
        raise DatasetError(
            f"points2d: expected one distinct name a point, got {len(points)} points and names {list(names)}; "
            "name every point once"
        )
    width, height = video.info.width, video.info.height
    inside = ((points >= 0) & (points <= [width - 1, height - 1])).all(axis=1)
    if not inside.all():
        outside = [f"{names[k]} at {points[k].tolist()}" for k in np.flatnonzero(~inside).tolist()]
        raise DatasetError(
            f"points2d: expected pixels inside {width} x {height}, got {', '.join(outside)}; "
            "name points in the reference frame"
        )
    return points


def check_counts(tracker: str, **settings: float | None) -> None:
    """Refuses settings that are not positive.

    Parameters
    ----------
    tracker
        Name of the tracker, for the message.
    settings
        Numbers by name; ``None`` stands for the default.

    Raises
    ------
    SessionError
        A setting is not positive.

    Examples
    --------
    >>> check_counts("icgn", search_radius_px=40, threads=None)
    """
    wrong = {name: value for name, value in settings.items() if value is not None and not value > 0}
    if wrong:
        listed = ", ".join(f"{name} = {value}" for name, value in wrong.items())
        raise SessionError(f"{tracker}: expected positive settings, got {listed}; leave them out for the defaults")


def check_correlations(tracker: str, minimum: float, reliable: float) -> None:
    """Refuses limits of the correlation that contradict each other.

    Parameters
    ----------
    tracker
        Name of the tracker, for the message.
    minimum, reliable
        Correlations below which a point is lost, and below which it is unreliable [1].

    Raises
    ------
    SessionError
        The limits are not ``0 < minimum <= reliable < 1``.

    Examples
    --------
    >>> check_correlations("icgn", 0.6, 0.8)
    """
    if not 0 < minimum <= reliable < 1:
        raise SessionError(
            f"{tracker}: expected 0 < minimum_correlation <= reliable_correlation < 1, got {minimum} and {reliable}; "
            "leave them out for the defaults"
        )


def follow_frames(
    video: Video,
    reference: Frame | None,
    begin: Callable[[LumaArray], Callable[[LumaArray], None]],
    progress: Progress | None,
) -> FloatArray:
    """Time stamps of all frames, after each was handed to a tracker, shape (T,) [s].

    Parameters
    ----------
    video
        Read once, in order.
    reference
        The reference frame; ``None`` for the first one of the pass.
    begin
        Called with the luma of the reference frame, shape (H, W); returns what is called with each frame.
    progress
        Called with ``tracking``, the number of frames done so far and that of all.

    Raises
    ------
    DatasetError
        Neither a reference frame is given nor has the video one.
    """
    advance = None if reference is None else begin(reference.luma)
    time_s: list[float] = []
    for frame in video.frames():
        if advance is None:
            advance = begin(frame.luma)
        advance(frame.luma)
        time_s.append(frame.time_s)
        if progress is not None:
            progress("tracking", len(time_s), video.info.frame_count)
    if advance is None:
        raise DatasetError("video: expected at least one frame, got none; check the file")
    return np.array(time_s)


def find_reference(video: Video, index: int) -> Frame | None:
    """The reference frame, by a pass up to it; ``None`` for the first one, with which every pass begins.

    Parameters
    ----------
    video
        The view.
    index
        Number of the frame.

    Raises
    ------
    DatasetError
        The video has no such frame.
    """
    return None if index == 0 else _frame(video, index)


def _frame(video: Video, index: int) -> Frame:
    """One frame of the video, by a pass up to it."""
    if index < 0:
        raise DatasetError(f"reference_frame: expected 0 or more, got {index}; count frames from the first")
    last: Frame | None = None
    for frame in video.frames(stop=index + 1):
        last = frame
    if last is None or last.index < index:
        found = 0 if last is None else last.index + 1
        raise DatasetError(
            f"reference_frame: expected a frame {index}, got a video of {found} frames; name an earlier one"
        )
    return last
