"""Recordings made of others: an interval of one, and the chapters of which a camera writes one film."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.continuity import doubt_dates, missing_by_code, missing_by_stamps
from vfm_sdm.inputs.video.cuts import Cut, CutSource
from vfm_sdm.inputs.video.decoder import Start
from vfm_sdm.inputs.video.records import Frame, FrameSource, VideoInfo

__all__ = ["IntervalSource", "JoinedSource", "SeekableSource"]

_SAME_RATE = 1e-3


@runtime_checkable
class SeekableSource(FrameSource, Protocol):
    """A source of frames that can begin a pass anywhere."""

    @property
    def begins_s(self) -> float:
        """Stamp of the first frame in the file's own time [s]."""
        ...

    def clock(self) -> FloatArray:
        """Times of all frames from the first one, shape (T,) [s]."""
        ...

    def stream_from(self, first: int) -> Generator[Frame]:
        """A pass that begins with a later frame; numbers and times are those of a whole pass."""
        ...

    def soon_decoded(self, number: int, frames: int) -> int:
        """The frame itself, or the last one before it that comes with at most so many decoded frames."""
        ...

    def compressed_from(self, number: int) -> tuple[Path, Start | None]:
        """The file that holds a frame, and where in it; ``None`` for its first one."""
        ...

    def keys(self) -> IntArray:
        """Numbers of the frames with which decoding can begin, rising, shape (K,)."""
        ...

    def cut(self, first: int, count: int | None) -> list[Cut]:
        """So many frames from a frame on, file by file; all that follow for ``None``."""
        ...


class IntervalSource:
    """Frames of an interval of a recording, numbered from 0, on a clock that begins with the interval.

    Parameters
    ----------
    source
        The whole recording.
    from_s, to_s
        Its beginning and end, from the recording's first frame [s]; frames at both are in it. ``None`` is the end.

    Raises
    ------
    VideoError
        The recording has no frame in the interval.
    """

    def __init__(self, source: SeekableSource, from_s: float, to_s: float | None) -> None:
        self._source, self._from_s = source, from_s
        clock = source.clock()
        # Stamps are whole ticks: what somebody reads off a player may miss one by rounding.
        near = 1e-6
        self._first = int(np.searchsorted(clock, from_s - near))
        end = len(clock) if to_s is None else int(np.searchsorted(clock, to_s + near, side="right"))
        self._clock = clock[self._first : end] - from_s
        last = float(clock[-1]) if len(clock) else 0.0
        if not self._clock.size:
            wanted = f"from {from_s:g} s on" if to_s is None else f"from {from_s:g} to {to_s:g} s"
            raise VideoError(
                f"{source.info.source}: expected frames {wanted}, got a recording that ends at {last:.3f} s; correct "
                "use_s"
            )
        whole = source.info
        said = f"used from {from_s:g} to {last if to_s is None else min(to_s, last):g} s of {last:.4g} s"
        self.info = replace(
            whole,
            frame_count=len(self._clock),
            duration_s=float(self._clock[-1]) + (0.0 if np.isnan(whole.fps) else 1 / whole.fps),
            size_bytes=None if whole.size_bytes is None else round(whole.size_bytes * len(self._clock) / len(clock)),
            remarks=(*whole.remarks, said),
        )
        self.begins_s = source.begins_s + from_s

    def clock(self) -> FloatArray:
        """Times of all frames from the interval's beginning, shape (T,) [s]."""
        return self._clock

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the frames of the interval."""
        return self.stream_from(0)

    def stream_from(self, first: int) -> Generator[Frame]:
        """A pass that begins with a later frame of the interval.

        Parameters
        ----------
        first
            Number of the frame in the interval.
        """
        return CutSource(self.info, self.cut(first, None)).stream()

    def keys(self) -> IntArray:
        """Numbers of the frames of the interval with which decoding can begin, shape (K,)."""
        found = self._source.keys() - self._first
        return found[(found >= 0) & (found < len(self._clock))]

    def cut(self, first: int, count: int | None) -> list[Cut]:
        """So many frames of the interval from a frame on; all that follow for ``None``.

        Parameters
        ----------
        first, count
            Number of the first frame in the interval, and of frames.
        """
        left = len(self._clock) - first
        cuts = self._source.cut(self._first + first, left if count is None else min(count, left))
        return [cut.moved(-self._first, -self._from_s) for cut in cuts]

    def soon_decoded(self, number: int, frames: int) -> int:
        """The frame itself, or the last one before it in the interval that comes with at most so many decoded ones."""
        return max(self._source.soon_decoded(self._first + number, frames) - self._first, 0)

    def compressed_from(self, number: int) -> tuple[Path, Start | None]:
        """The file that holds a frame of the interval, and where in it."""
        return self._source.compressed_from(self._first + number)

    def jump(self, count: int, frames: int) -> Generator[Frame]:
        """Frames spread evenly over the interval; see `_pick`."""
        return _pick(self, count, frames)


class JoinedSource:
    """Chapters as one recording.

    Parameters
    ----------
    sources
        The chapters in the order in which they were recorded, at least one.

    Raises
    ------
    VideoError
        Chapters differ in size, rate or format, or are not in the order of their stamps.

    Notes
    -----
    Cameras that write chapters lose no frame between them and begin each with a stamp near zero: the first frame of a
    chapter comes one interval after the last one of the chapter before, unless time codes tell of more. Files whose
    stamps go on where others end keep what their stamps say. Gaps are named, and so are files whose dates lie farther
    apart than they are joined.
    """

    def __init__(self, sources: Sequence[SeekableSource]) -> None:
        self._sources = tuple(sources)
        first = sources[0].info
        for one in sources[1:]:
            _check_alike(first, one.info)
        counts = [one.info.frame_count for one in sources]
        durations = [one.info.duration_s for one in sources]
        sizes = [one.info.size_bytes for one in sources]
        remarks = [remark for one in sources for remark in one.info.remarks]
        doubts = [doubt for one in sources for doubt in one.info.doubts]
        names = ", ".join(Path(one.info.source).name for one in sources)
        joined = replace(
            first,
            frame_count=None if None in counts else sum(count or 0 for count in counts),
            duration_s=None if None in durations else sum(duration or 0.0 for duration in durations),
            size_bytes=None if None in sizes else sum(size or 0 for size in sizes),
            remarks=(
                *dict.fromkeys(remarks),
                f"{len(sources)} chapters as one recording: {names}",
                *self._describe_gaps(),
            ),
            doubts=tuple(dict.fromkeys([*doubts, *self._doubt_dates()])),
        )
        self.info = joined
        self.begins_s = sources[0].begins_s

    @cached_property
    def _starts(self) -> list[tuple[int, float]]:
        """Number and time [s] of the first frame of each chapter."""
        starts = [(0, 0.0)]
        for chapter, gap_s in zip(self._sources, self._gaps_s, strict=False):
            number, start_s = starts[-1]
            clock = chapter.clock()
            starts.append((number + len(clock), start_s + _length_s(chapter, clock) + gap_s))
        return starts

    @cached_property
    def _gaps_s(self) -> list[float]:
        """What is missing after each chapter but the last one [s]."""
        pairs = zip(self._sources, self._sources[1:], strict=False)
        return [_gap_s(before, after) for before, after in pairs]

    def _describe_gaps(self) -> list[str]:
        """Sentences on what is missing between chapters."""
        joints = zip(self._sources, self._sources[1:], self._gaps_s, strict=False)
        return [f"{gap:.3f} s missing between {a.info.source} and {b.info.source}" for a, b, gap in joints if gap > 0]

    def _doubt_dates(self) -> list[str]:
        """Sentences on chapters whose files were begun later than they are joined."""
        joints = zip(self._sources, self._sources[1:], np.diff([start for _, start in self._starts]), strict=False)
        return [doubt for a, b, length in joints if (doubt := doubt_dates((a.info, b.info), float(length)))]

    def clock(self) -> FloatArray:
        """Times of all frames from the first one, shape (T,) [s]."""
        return np.concatenate(
            [one.clock() + start for one, (_, start) in zip(self._sources, self._starts, strict=True)]
        )

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the frames of all chapters."""
        return self.stream_from(0)

    def stream_from(self, first: int) -> Generator[Frame]:
        """A pass that begins with a later frame.

        Parameters
        ----------
        first
            Number of the frame among those of all chapters.

        Raises
        ------
        DecodeStop
            A chapter ends early or is damaged; those after it are not read.
        """
        return CutSource(self.info, self.cut(first, None)).stream()

    def keys(self) -> IntArray:
        """Numbers of the frames with which decoding can begin, shape (K,)."""
        pairs = zip(self._sources, self._starts, strict=True)
        return np.concatenate([chapter.keys() + number for chapter, (number, _) in pairs])

    def cut(self, first: int, count: int | None) -> list[Cut]:
        """So many frames from a frame on, chapter by chapter; all that follow for ``None``.

        Parameters
        ----------
        first, count
            Number of the first frame among those of all chapters, and of frames.
        """
        cuts: list[Cut] = []
        begin = self._chapter_of(first)
        ends = [number for number, _ in self._starts[1:]] + [None]
        for chapter, (number, start_s), end in list(zip(self._sources, self._starts, ends, strict=True))[begin:]:
            here = max(first - number, 0)
            if count is not None and count <= (done := max(number - first, 0)):
                break
            left = None if count is None else count - done
            whole = left is None or (end is not None and number + here + left > end)
            found = chapter.cut(here, None if whole else left)
            cuts += [cut.moved(number, start_s, chapter.info.source) for cut in found]
        return cuts

    def soon_decoded(self, number: int, frames: int) -> int:
        """The frame itself, or the last one before it in its chapter that comes with at most so many decoded ones."""
        chapter = self._chapter_of(number)
        first = self._starts[chapter][0]
        return first + self._sources[chapter].soon_decoded(number - first, frames)

    def compressed_from(self, number: int) -> tuple[Path, Start | None]:
        """The chapter that holds a frame, and where in it."""
        chapter = self._chapter_of(number)
        return self._sources[chapter].compressed_from(number - self._starts[chapter][0])

    def _chapter_of(self, number: int) -> int:
        return int(np.searchsorted([first for first, _ in self._starts], number, side="right")) - 1

    def jump(self, count: int, frames: int) -> Generator[Frame]:
        """Frames spread evenly over all chapters; see `_pick`."""
        return _pick(self, count, frames)


def _pick(source: SeekableSource, count: int, frames: int) -> Generator[Frame]:
    """Frames spread evenly over a recording, near the key frames before them where these are rare.

    Parameters
    ----------
    source
        The recording.
    count
        Number of frames.
    frames
        Largest number of frames to decode for each.
    """
    total = len(source.clock())
    wanted = np.unique(np.linspace(0, total - 1, min(count + 1, total)).round().astype(int))[1:].tolist()
    last = -1
    for number in wanted:
        nearest = source.soon_decoded(number, frames)
        if nearest > last:
            with closing(source.stream_from(nearest)) as found:
                yield from islice(found, 1)
            last = nearest


def _interval_s(source: SeekableSource, clock: FloatArray) -> float:
    """Usual time between two frames at the end of a recording [s]."""
    near = np.diff(clock[-61:])
    return float(np.median(near)) if near.size else 1 / source.info.fps


def _length_s(source: SeekableSource, clock: FloatArray) -> float:
    """Time from the first frame of a recording to the frame that would come after its last one [s]."""
    return float(clock[-1]) + _interval_s(source, clock)


def _gap_s(before: SeekableSource, after: SeekableSource) -> float:
    """Time that is missing between two chapters by their stamps, or, where these begin anew, by time codes [s]."""
    clock, infos = before.clock(), (before.info, after.info)
    with_next = np.append(clock, _length_s(before, clock))
    gap_s = missing_by_stamps(infos, (before.begins_s, after.begins_s), with_next)
    return gap_s or missing_by_code(infos, len(clock))


def _check_alike(first: VideoInfo, other: VideoInfo) -> None:
    for what in ("width", "height", "pixel_format", "bit_depth", "rotation_deg", "pixel_aspect", "time_scale"):
        wanted, got = getattr(first, what), getattr(other, what)
        if wanted != got:
            raise VideoError(
                f"{other.source}: expected the {what.replace('_', ' ')} of {first.source} ({wanted}), got {got}; name "
                "only chapters of one recording"
            )
    if abs(first.fps / other.fps - 1) > _SAME_RATE:
        raise VideoError(
            f"{other.source}: expected the {first.fps:g} frames a second of {first.source}, got {other.fps:g}; name "
            "only chapters of one recording"
        )
