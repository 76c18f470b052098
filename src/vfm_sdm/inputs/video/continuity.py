"""What is missing between two chapters of a recording, by their stamps, their time codes and their files' dates."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.records import VideoInfo

__all__ = ["count_time_code", "doubt_dates", "missing_by_code", "missing_by_stamps", "read_date", "read_time_code"]

_OWN_CLOCK_S = 1.0
"""Difference of first stamps up to which both chapters begin a clock of their own [s]: encoders delay some frames."""
_WITHIN_FRAME = 0.5
"""Share of the time between two frames by which stamps of two files may miss each other and still go on [1]."""
_FEWEST_FRAMES = 2
"""Frames that a time code must miss: one that runs on its own while the camera rests may be one off by rounding."""
_DAY = 24
_DATE_S = 2.5
"""Time that dates of files, whole seconds written when the camera came to it, must miss [s]."""
_CODE = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})([:;.])(\d{2,3})")


def read_time_code(metadata: Mapping[str, str]) -> str:
    """Time code of the first frame, as the camera wrote it; empty without one.

    Parameters
    ----------
    metadata
        What the container says of the film and its tracks.
    """
    found = metadata.get("timecode", "").strip()
    return found if _CODE.fullmatch(found) else ""


def read_date(metadata: Mapping[str, str]) -> datetime | None:
    """When the file was begun, by its own account; ``None`` where it does not say, or has no clock.

    Parameters
    ----------
    metadata
        What the container says.
    """
    try:
        found = datetime.fromisoformat(metadata.get("creation_time", ""))
    except ValueError:
        return None
    found = found if found.tzinfo else found.replace(tzinfo=UTC)
    return found if found.year > 2000 else None


def count_time_code(code: str, fps: float) -> int:
    """Number of a frame since midnight, by its time code.

    Parameters
    ----------
    code
        ``hours:minutes:seconds:frames``; with ``;`` before the frames two numbers are left out in every minute but each
        tenth, so that 29.97 frames a second keep step with a clock (SMPTE ST 12-1), at 59.94 twice as many.
    fps
        Rate [1/s].

    Examples
    --------
    >>> count_time_code("00:01:00:00", 25.0), count_time_code("00:01:00;02", 29.97)
    (1500, 1800)
    """
    match = _CODE.fullmatch(code)
    if match is None:
        raise ValueError(f"expected a time code, got {code!r}")
    hours, minutes, seconds, frames = (int(match[group]) for group in (1, 2, 3, 5))
    rate = round(fps)
    count = ((hours * 60 + minutes) * 60 + seconds) * rate + frames
    if match[4] == ":":
        return count
    whole = hours * 60 + minutes
    return count - round(rate / 15) * (whole - whole // 10)


def missing_by_stamps(infos: tuple[VideoInfo, VideoInfo], begins_s: tuple[float, float], clock: FloatArray) -> float:
    """Time that is missing between two chapters by their stamps [s]; 0 where each begins a clock of its own.

    Parameters
    ----------
    infos, begins_s
        Both chapters, and the stamps of their first frames [s].
    clock
        Times of the first chapter's frames, and of the one that would follow, shape (T + 1,) [s].

    Raises
    ------
    VideoError
        The second begins before the first ends.
    """
    length, interval = float(clock[-1]), float(clock[-1] - clock[-2])
    apart = begins_s[1] - begins_s[0]
    if abs(apart) < min(_OWN_CLOCK_S, length / 2):
        return 0.0
    gap = apart - length
    if gap < -_WITHIN_FRAME * interval:
        raise VideoError(
            f"{infos[1].source}: expected a chapter that begins where {infos[0].source} ends, got one that begins "
            f"{-gap:.3f} s earlier; correct the order of the chapters"
        )
    return gap if gap > _WITHIN_FRAME * interval else 0.0


def missing_by_code(infos: tuple[VideoInfo, VideoInfo], frames: int) -> float:
    """Time that is missing between two chapters by their time codes [s]; 0 where these do not tell.

    Parameters
    ----------
    infos
        Both chapters.
    frames
        Number of frames of the first.

    Notes
    -----
    Codes that begin anew with each chapter, or go back, say nothing. Films whose stamps are not those of the camera
    (slow motion) are left out: what their codes count is not known.
    """
    before, after = infos
    if not (before.time_code and after.time_code and before.fps > 0) or before.time_scale != 1:
        return 0.0
    day = round(before.fps) * _DAY * 3600
    missing = count_time_code(after.time_code, before.fps) - count_time_code(before.time_code, before.fps) - frames
    missing += day if missing < -day // 2 else 0  # over midnight
    return missing / before.fps if missing >= _FEWEST_FRAMES else 0.0


def doubt_dates(infos: tuple[VideoInfo, VideoInfo], length_s: float) -> str:
    """Sentence where the dates of two chapters lie farther apart than these are joined; empty where they do not.

    Parameters
    ----------
    infos
        Both chapters.
    length_s
        Time from the first frame of the one to that of the other, as they are joined [s].

    Notes
    -----
    Some cameras write the date of the whole recording into each chapter, some that of its end.
    """
    before, after = infos
    if before.date is None or after.date is None:
        return ""
    apart_s = (after.date - before.date).total_seconds()
    longest_s = max(length_s, after.duration_s or 0.0)
    if apart_s <= longest_s + _DATE_S:
        return ""
    return (
        f"{after.source} was begun {apart_s:.0f} s after {before.source} by the dates of the files, "
        f"{apart_s - length_s:.0f} s later than it is joined; if the camera was stopped between them, measure them "
        "one by one"
    )
