"""Frames in which points are named that come into view later: one in every view, all taken at the same time."""

from collections.abc import Mapping
from functools import cache

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session.model import Point, Session
from vfm_sdm.inputs.video import Video

__all__ = ["find_reference_frames"]

_WITHIN = 0.5
"""Share of the time between two frames by which a time may lie before the first or after the last one [1]."""
_NEAR_S = 1e-6


def find_reference_frames(session: Session, videos: Mapping[str, Video]) -> dict[str, dict[str, int]]:
    """Numbers of the frames in which points are named, by view and point; of points that come later, and only these.

    Parameters
    ----------
    session
        Its points say when; its views, how much later one begins than another. Where that is not stated, recordings
        begin together.
    videos
        Open recordings by view.

    Raises
    ------
    SessionError
        A frame or a time lies outside of a recording; the message names every such point.
    VideoError
        A recording cannot be read.

    Notes
    -----
    In the point's own view the frame is the stated one, or the nearest to the stated time; in every other view the
    nearest to the time at which that one was taken. A point of frame 0 is one of the first frames, as if it said
    nothing.
    """
    late = [point for point in session.point if point.comes_later]
    clock = cache(lambda view: videos[view].clock())
    begins = {view.name: session.begins_s(view) for view in session.view} if late else {}
    found: dict[str, dict[str, int]] = {}
    faults: list[str] = []
    for point in late:
        own = clock(point.view)
        number, fault = _number_in(own, point)
        if fault:
            faults.append(f"point[{point.name}].{fault}")
        if number == 0 or fault:
            continue
        for view, begins_s in begins.items():
            at_s = float(own[number]) + begins[point.view] - begins_s
            there = number if view == point.view else _nearest(clock(view), at_s)
            if there is None:
                faults.append(
                    f"point[{point.name}]: expected a time at which view {view!r} films, too, got {at_s:.3f} s of "
                    f"{float(clock(view)[-1]):.3f} s there; name the point in a frame of a time that all views show, "
                    "or correct time_offset_s"
                )
                continue
            found.setdefault(view, {})[point.name] = there
    if faults:
        raise SessionError("\n".join(faults))
    return found


def _number_in(clock: FloatArray, point: Point) -> tuple[int, str]:
    """Number of the frame in which a point is named in its own view, and what is wrong with it."""
    if point.frame is not None:
        wrong = "" if point.frame < len(clock) else _beyond("frame", f"less than {len(clock)}", str(point.frame))
        return point.frame, wrong
    at_s = float(point.time_s or 0.0)
    number = _nearest(clock, at_s)
    if number is None:
        return 0, _beyond("time_s", f"up to {float(clock[-1]) if len(clock) else 0.0:.3f} s", f"{at_s:g} s")
    return number, ""


def _beyond(key: str, expected: str, found: str) -> str:
    return f"{key}: expected {expected}, the last frame that is used of the recording, got {found}; correct it"


def _nearest(clock: FloatArray, at_s: float) -> int | None:
    """Number of the frame nearest to a time [s]; ``None`` where the recording has not begun or is over."""
    if not len(clock):
        return None
    number = int(np.abs(clock - at_s).argmin())
    apart = float(np.median(np.diff(clock))) if len(clock) > 1 else 0.0
    outside = max(float(clock[0]) - at_s, at_s - float(clock[-1]))
    return number if outside <= _WITHIN * apart + _NEAR_S else None
