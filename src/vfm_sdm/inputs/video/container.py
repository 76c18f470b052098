"""Frames of a video file through PyAV: what the container says, time stamps and rotation."""

import math
from collections.abc import Generator, Iterable
from contextlib import closing
from copy import copy
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.sidedata.sidedata import SideData

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.camera_tags import read_camera_tags
from vfm_sdm.inputs.video.color import convert_part
from vfm_sdm.inputs.video.continuity import read_date, read_time_code
from vfm_sdm.inputs.video.cuts import Cut
from vfm_sdm.inputs.video.decoder import Start, first_picture, open_stream, read_pictures
from vfm_sdm.inputs.video.luma import luma_bits, luma_plane
from vfm_sdm.inputs.video.marks import read_capture_clock, read_pixel_aspect
from vfm_sdm.inputs.video.records import DecodeStop, Frame, VideoInfo
from vfm_sdm.inputs.video.timeline import Timeline, read_timeline

__all__ = ["INTERLACED", "ContainerSource"]

# Display matrix (a, b, c, d) of ISO/IEC 14496-12, x' = a x + c y and y' = b x + d y, and the clockwise turn it makes.
_CLOCKWISE_DEG = {(1, 0, 0, 1): 0, (0, 1, -1, 0): 90, (-1, 0, 0, -1): 180, (0, -1, 1, 0): 270}
_FIXED_POINT = 65536
INTERLACED = (
    "interlaced: every picture holds two fields of different times, and motion comes out late and too small; film "
    "progressively, or make a picture of each field (bwdif)"
)
_STRIDE = 7  # a prime: how many frames are decoded after a jump differs from jump to jump


_Probed = tuple[Fraction, Fraction, int, VideoInfo]
"""Unit of the stamps [s], the time that goes by in it [s], the first stamp, and what the container says."""
_known: dict[tuple[object, ...], _Probed] = {}
_MOST_KNOWN = 256


class ContainerSource:
    """The first video stream of a file.

    Parameters
    ----------
    path
        The file: mp4, mov, mkv, or another container whose stream has time stamps.
    capture_fps
        Rate at which the camera took the frames, where it is stated [1/s]; see `vfm_sdm.inputs.video.marks`.

    Raises
    ------
    VideoError
        The file is missing or empty, is not a video, or not one frame of it can be decoded and placed in time.
    """

    def __init__(self, path: Path, *, capture_fps: float | None = None) -> None:
        self._path, self._threads = path, True
        (self._base, self._tick, self._first, self.info), self._opening = _probe(self._path, capture_fps)

    def __getstate__(self) -> dict[str, Any]:
        # What was read of the whole file goes with no copy: neither to a part of it nor to another process.
        state = {**vars(self), "_opening": None}
        state.pop("_timeline", None)
        return state

    def opening(self) -> Frame | None:
        """The first frame as it was decoded when the file was opened; nothing when it was fetched before."""
        picture, self._opening = self._opening, None
        return None if picture is None else self._frame(0, 0.0, picture)

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the frames, in order, numbered from 0.

        Raises
        ------
        DecodeStop
            The file ends early, data are damaged, the picture changes its size, or a time stamp is missing or does
            not rise.
        """
        return self.decode(0, None)

    def stream_from(self, first: int) -> Generator[Frame]:
        """A pass that begins with a later frame; numbers and times are those of a whole pass.

        Parameters
        ----------
        first
            Number of the frame. The file is decoded from the key frame before it on.

        Raises
        ------
        DecodeStop
            As of `stream`, or there is no such frame.
        """
        return self.decode(first, self._find(first) if first else None)

    def keys(self) -> IntArray:
        """Numbers of the frames with which decoding can begin, shape (K,)."""
        return np.searchsorted(self._timeline.stamps, self._timeline.keys)

    def on_one_thread(self) -> "ContainerSource":
        """The same file, decoded picture by picture, for one of several processes that share the processors."""
        source = copy(self)
        source._threads = False
        return source

    def cut(self, first: int, count: int | None) -> list[Cut]:
        """So many frames from one on; all that follow for ``None``.

        Parameters
        ----------
        first, count
            Number of the first frame, and of frames.
        """
        start = self._find(first) if first else None
        return [Cut(copy(self), first, start, count)]

    def clock(self) -> FloatArray:
        """Times of all frames from the first one, shape (T,) [s]; the file is read once, and not decoded."""
        seconds, ticks = self._tick.as_integer_ratio()
        return np.asarray((self._timeline.stamps - self._first) * seconds / ticks, np.float64)

    def soon_decoded(self, number: int, frames: int) -> int:
        """The frame itself, or the last one before it that comes with at most so many decoded frames.

        Parameters
        ----------
        number
            Number of the frame.
        frames
            Largest number of frames to decode.
        """
        start = self._find(number)
        key = int(np.searchsorted(self._timeline.stamps, start.key))
        return min(number, key + max(frames, 1) - 1)

    def compressed_from(self, number: int) -> tuple[Path, Start | None]:
        """The file, and where in it a frame is found; ``None`` for the first one.

        Parameters
        ----------
        number
            Number of the frame.
        """
        return self._path, self._find(number) if number else None

    @property
    def begins_s(self) -> float:
        """Stamp of the first frame in the file's own time [s]; not 0 in files that go on where another ended."""
        return float(self._first * self._tick)

    @cached_property
    def _timeline(self) -> Timeline:
        return read_timeline(self._path, self._first)

    def _find(self, first: int) -> Start:
        stamps = self._timeline.stamps
        if not first < len(stamps):
            raise DecodeStop(RecordingStatus.TRUNCATED, f"expected a frame {first}, got {len(stamps)}; ask for fewer")
        return self._timeline.start_at(int(stamps[first]))

    def decode(self, number: int, start: Start | None) -> Generator[Frame]:
        """A pass that begins with a frame of this number; see `stream_from`.

        Parameters
        ----------
        number
            Number of the frame.
        start
            Where in the file it is; ``None`` at the beginning.
        """
        first: int | None = None if start is None else self._first
        last = (start.stamp if start is not None else self._first) - 1
        seconds, ticks = self._tick.as_integer_ratio()
        with closing(read_pictures(self._path, start, threads=self._threads)) as pictures:
            for index, picture in enumerate(pictures, start=number):
                self._check_size(picture)
                stamp = _rising_stamp(picture, None if first is None else last, self._base)
                if index == number and start is not None and stamp != start.stamp:
                    raise DecodeStop(RecordingStatus.CORRUPT, f"frame {number} does not decode; copy the file again")
                first = stamp if first is None else first
                last = stamp
                yield self._frame(index, (stamp - first) * seconds / ticks, picture)

    def jump(self, count: int, frames: int) -> Generator[Frame]:
        """Frames near times spread evenly over the file, in order, numbered by their time.

        Parameters
        ----------
        count
            Number of times.
        frames
            Largest number of frames to decode after each jump.

        Notes
        -----
        A jump lands on the key frame before its time. Where key frames are rare, several times share one; they then
        end a different number of frames behind it.
        """
        duration_s = (self.info.duration_s or 0.0) / self.info.time_scale
        first, last = None, -1
        with open_stream(self._path) as (container, video):
            start = video.start_time or 0
            for number in range(count):
                target = start + int((number + 1) / count * duration_s * 0.999 / self._base)
                try:
                    container.seek(target, stream=video)
                    allowed = 1 + (number * _STRIDE) % frames
                    for decoded, picture in enumerate(container.decode(video)):
                        if decoded + 1 >= allowed or (picture.pts or 0) >= target:
                            break
                    else:
                        continue
                except av.FFmpegError as error:
                    raise DecodeStop(RecordingStatus.CORRUPT, f"damaged data ({error.strerror})") from error
                self._check_size(picture)
                first = start if first is None else first
                index = round(((picture.pts or first) - first) * self._tick * Fraction(self.info.fps))
                if index > last:
                    last = index
                    yield self._frame(index, float(((picture.pts or first) - first) * self._tick), picture)

    def _frame(self, number: int, time_s: float, picture: av.VideoFrame) -> Frame:
        luma = luma_plane(picture)
        # np.rot90 turns anticlockwise; it is a view, and so keeps the picture's memory alive.
        turns = -self.info.rotation_deg // 90
        turned = np.rot90(luma, turns) if turns else luma
        return Frame(number, time_s, turned, partial(convert_part, picture, rotation_deg=self.info.rotation_deg))

    def _check_size(self, picture: av.VideoFrame) -> None:
        width, height = _turned_size(picture, self.info.rotation_deg)
        if (width, height, picture.format.name) != (self.info.width, self.info.height, self.info.pixel_format):
            raise DecodeStop(
                RecordingStatus.CORRUPT,
                f"expected {self.info.width} x {self.info.height} {self.info.pixel_format} throughout, got "
                f"{width} x {height} {picture.format.name}; cut the file where the camera changed its settings",
            )


def _probe(path: Path, capture_fps: float | None) -> tuple[_Probed, av.VideoFrame | None]:
    """What a file says, asked once for as long as it is as it was; and its first picture, where it was asked now."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return _read_head(path, capture_fps)  # which says what is wrong
    key = (path, path.absolute(), found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, capture_fps)
    if key in _known:
        return _known[key], None
    probed, picture = _read_head(path, capture_fps)
    if len(_known) >= _MOST_KNOWN:
        _known.clear()
    _known[key] = probed
    return probed, picture


def _read_head(path: Path, capture_fps: float | None) -> tuple[_Probed, av.VideoFrame]:
    """What a container and its first picture say, and that picture."""
    picture: av.VideoFrame | None = None
    why = "the stream is empty; record it again"
    with open_stream(path, threads=False) as (container, video):
        try:
            picture = first_picture(container, video, path)
        except DecodeStop as damage:
            why = damage.detail
        if picture is None:
            raise VideoError(f"{path}: expected at least one usable frame, got none: {why}")
        rotation_deg = read_rotation(picture, path)
        width, height = _turned_size(picture, rotation_deg)
        said_of_it = {**container.metadata, **video.metadata}
        rate = video.average_rate or video.guessed_rate
        base = video.time_base or Fraction(1)
        clock = read_capture_clock(rate, said_of_it, capture_fps=capture_fps, time_base=base)
        aspect, said = read_pixel_aspect(video.sample_aspect_ratio, rotation_deg)
        duration_s = _duration_s(container, video)
        probed = (
            base,
            base * clock.scale,
            picture.pts or 0,
            VideoInfo(
                source=str(path),
                width=width,
                height=height,
                fps=float(rate / clock.scale) if rate else math.nan,
                frame_count=video.frames or None,
                duration_s=None if duration_s is None else duration_s * float(clock.scale),
                codec=video.codec_context.name,
                pixel_format=picture.format.name,
                bit_depth=luma_bits(picture.format.name),
                rotation_deg=rotation_deg,
                pixel_aspect=aspect,
                time_scale=float(clock.scale),
                size_bytes=path.stat().st_size,
                remarks=said + clock.remarks,
                doubts=clock.doubts + (INTERLACED,) * picture.interlaced_frame,
                camera=read_camera_tags(said_of_it, path),
                time_code=read_time_code(said_of_it),
                date=read_date(said_of_it),
            ),
        )
    return probed, picture


def _rising_stamp(picture: av.VideoFrame, last: int | None, base: Fraction) -> int:
    # The decoder's accounts let no picture pass without one.
    stamp = cast("int", picture.pts)
    if last is not None and stamp <= last:
        raise DecodeStop(
            RecordingStatus.CORRUPT,
            f"expected rising time stamps, got {float(stamp * base):.6f} s after {float(last * base):.6f} s; "
            "write the file anew with rising stamps",
        )
    return stamp


def _turned_size(picture: av.VideoFrame, rotation_deg: int) -> tuple[int, int]:
    return (picture.height, picture.width) if rotation_deg % 180 else (picture.width, picture.height)


def _duration_s(container: av.container.InputContainer, video: av.VideoStream) -> float | None:
    if video.duration is not None and video.time_base is not None:
        return float(video.duration * video.time_base)
    return None if container.duration is None else float(container.duration / av.time_base)


def read_rotation(picture: av.VideoFrame, name: object) -> int:
    """Clockwise turn with which a picture is to be shown: 0, 90, 180 or 270 [deg].

    Parameters
    ----------
    picture
        Decoded picture.
    name
        What its recording is called, for messages.

    Raises
    ------
    VideoError
        The turn is another one, or the picture is mirrored.
    """
    for side_data in cast("Iterable[SideData]", picture.side_data):
        if side_data.type.name == "DISPLAYMATRIX":
            matrix = np.frombuffer(bytes(side_data), dtype=np.int32).reshape(3, 3)[:2, :2].ravel() / _FIXED_POINT
            whole = np.rint(matrix)
            turn = _CLOCKWISE_DEG.get(tuple(whole.tolist())) if np.allclose(matrix, whole, atol=1e-3) else None
            if turn is None:
                raise VideoError(
                    f"{name}: expected a rotation by 0, 90, 180 or 270 degrees, got the display matrix "
                    f"{matrix.tolist()}; correct it in the file"
                )
            return turn
    return 0
