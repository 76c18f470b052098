"""What a container says about the clock and the pixels of its recording, beyond its time stamps."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

__all__ = ["CaptureClock", "read_capture_clock", "read_pixel_aspect"]

_CAPTURE_TAG = "com.android.capture.fps"
"""Rate at which Android's cameras took the frames [1/s]; slow motion and time lapse are stored at another."""
_INTENT_TAG = "com.apple.quicktime.full-frame-rate-playback-intent"
_APPLE_SLOW_TICKS = Fraction(1, 2400)
_NORMAL_FPS = 60.5
_OTHER_RATE = 1.5
"""Ratio from which on they are two rates: cameras that were asked for 30 frames a second take 24 in poor light,
and those frames have true stamps."""
_NAMED_RATIO = 1.05
_WHOLE = 0.05
"""Share by which a ratio of two nominal rates may miss a whole number, as 120 over 29.97 does."""
_SQUARE = 5e-3
"""Share by which pixels may differ from squares without a word: sizes rounded to whole pixels."""


@dataclass(frozen=True)
class CaptureClock:
    """How the time that went by while the camera filmed follows from a container's stamps.

    Parameters
    ----------
    scale
        Seconds that went by in one second of the stamps [1].
    remarks
        Sentences on what was found.
    doubts
        Sentences on what may be wrong and cannot be told from the file.
    """

    scale: Fraction
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def read_capture_clock(
    stored_fps: Fraction | None,
    tags: Mapping[str, str],
    *,
    capture_fps: float | None = None,
    time_base: Fraction | None = None,
) -> CaptureClock:
    """The clock of the camera, from what was stated or what the file's metadata say.

    Parameters
    ----------
    stored_fps
        Mean rate of the stamps [1/s]; ``None`` where the container names none.
    tags
        Metadata of the container and its stream.
    capture_fps
        Rate at which the camera took the frames, where somebody states it; it counts as exact [1/s].
    time_base
        Unit of the stamps [s].

    Notes
    -----
    Android writes the rate of the camera into every file. A file that is stored at another rate holds slow motion or
    time lapse, and its stamps are stretched by the ratio of both nominal rates. Apple's cameras keep true stamps in
    their original files; what is exported with slow motion has stretched ones and no tag that says so, only the finer
    unit of the stamps: that is a doubt.

    Examples
    --------
    >>> slow = read_capture_clock(Fraction(30000, 1001), {"com.android.capture.fps": "120.000000"})
    >>> slow.scale
    Fraction(1, 4)
    >>> read_capture_clock(Fraction(30), {}, capture_fps=240.0).scale
    Fraction(1, 8)
    """
    if capture_fps is not None:
        if not stored_fps:
            return CaptureClock(Fraction(1), doubts=("capture_fps was stated, but the file names no rate of its own",))
        scale = stored_fps / Fraction(capture_fps).limit_denominator(1_000_000)
        return CaptureClock(scale, (_say_scaled(float(capture_fps), float(stored_fps), "as stated (capture_fps)"),))
    taken = _number(tags.get(_CAPTURE_TAG, ""))
    if not stored_fps:
        return CaptureClock(Fraction(1))
    if taken is not None:
        return _compare_rates(taken, stored_fps)
    fine = time_base is not None and time_base == _APPLE_SLOW_TICKS
    if fine and tags.get(_INTENT_TAG) == "0" and stored_fps < _NORMAL_FPS:
        doubt = (
            f"stamps as of exported slow motion ({float(stored_fps):.4g} frames a second): film without it, use "
            "the camera's original file, or state capture_fps, the rate at which it was filmed"
        )
        return CaptureClock(Fraction(1), doubts=(doubt,))
    return CaptureClock(Fraction(1))


def _compare_rates(taken: float, stored_fps: Fraction) -> CaptureClock:
    """The clock of a file whose metadata name the rate of the camera [1/s]."""
    ratio = taken / float(stored_fps)
    if max(ratio, 1 / ratio) < _NAMED_RATIO:
        return CaptureClock(Fraction(1))
    if max(ratio, 1 / ratio) < _OTHER_RATE:
        said = (
            f"the file says that {taken:g} frames a second were taken and holds {float(stored_fps):.4g}: its time "
            "stamps are used; state capture_fps where they are wrong"
        )
        return CaptureClock(Fraction(1), (said,))
    whole = round(max(ratio, 1 / ratio))
    exact = Fraction(ratio).limit_denominator(1_000_000)
    if abs(max(ratio, 1 / ratio) / whole - 1) <= _WHOLE:
        exact = Fraction(whole) if ratio > 1 else Fraction(1, whole)
    said = _say_scaled(taken, float(stored_fps), "as the file says")
    advice = f"; state capture_fps = {float(stored_fps):.4g} if its time stamps are right"
    return CaptureClock(1 / exact, (said + advice,))


def _say_scaled(taken: float, stored: float, why: str) -> str:
    kind = "slow motion" if taken > stored else "time lapse" if taken < stored else "capture rate"
    return f"{kind}: filmed at {taken:.6g} and stored at {stored:.4g} frames a second, {why}; time is that of filming"


def _number(text: str) -> float | None:
    """A positive number in a tag; ``None`` for anything else."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if 0 < number < float("inf") else None


def read_pixel_aspect(stored: Fraction | None, rotation_deg: int) -> tuple[float, tuple[str, ...]]:
    """Width of a pixel over its height after rotation [1], and what there is to say about it.

    Parameters
    ----------
    stored
        Sample aspect ratio of the stream, before rotation; ``None`` or 0 where it names none, which means squares.
    rotation_deg
        Clockwise turn of the pictures [deg].

    Examples
    --------
    >>> read_pixel_aspect(Fraction(4, 3), 90)[0]
    0.75
    >>> read_pixel_aspect(None, 0)
    (1.0, ())
    """
    if not stored or stored < 0:
        return 1.0, ()
    aspect = float(1 / stored if rotation_deg % 180 else stored)
    if abs(aspect - 1) < _SQUARE:
        return aspect, ()
    said = (
        f"anamorphic: pixels are {aspect:.4g} times as wide as high (sample aspect ratio {stored.numerator}:"
        f"{stored.denominator}); cameras allow for it, and all pixels, those of named points too, are the stored ones"
    )
    return aspect, (said,)
