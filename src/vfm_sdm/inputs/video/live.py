"""Pictures as they are taken: of a camera, of a stream, or of a file that another process is still writing."""

import os
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Condition, Event, Thread
from typing import Any, cast

import av
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.container import read_rotation
from vfm_sdm.inputs.video.decoder import choose_stream, drain
from vfm_sdm.inputs.video.growing import GrowingFile
from vfm_sdm.inputs.video.luma import luma_bits, luma_plane

__all__ = ["LiveCounts", "LivePicture", "LiveSource"]

_HELD_S, _HELD_BYTES = 1.0, 128_000_000
"""Pictures that wait at most [s]: files are written, and streams sent, several at a time; and their size in memory."""
_BEHIND_S = 2.0
"""How far decoding may fall behind what has come before it goes on from the next key frame."""
_THREADS = 4
_DRIFT = 1e-4
"""How much faster than a true clock a camera's may go [1]: 100 parts in a million."""
_STAMPS = 4096
_CAMERAS = {"linux": ("v4l2", "/dev/video{}"), "darwin": ("avfoundation", "{}")}
_JPEG_RANGE = 2  # of FFmpeg's AVColorRange


@dataclass(frozen=True, eq=False, slots=True)
class LivePicture:
    """One picture of a live view.

    Parameters
    ----------
    time_s
        Time from the first picture, by the source's stamps [s].
    luma
        Brightness, shape (height, width), turned as it is to be shown, read-only.
    due_s
        When it could have been here at the earliest, by `time.monotonic` [s]; NaN where that is not known.
    """

    time_s: float
    luma: LumaArray
    due_s: float


@dataclass(frozen=True)
class LiveCounts:
    """What has come so far.

    Parameters
    ----------
    came
        All pictures, decoded or not: those that were taken or wait, and the following.
    dropped
        Those that nobody took in time, or that there was no time to decode.
    before
        Those that lay in the file before, and were passed over.
    damaged
        Those that could not be decoded, or whose stamp goes back.
    """

    came: int = 0
    dropped: int = 0
    before: int = 0
    damaged: int = 0


class LiveSource:
    """Pictures of a live view, of which the newest wait in a short queue; read by a thread of its own.

    Parameters
    ----------
    source
        A file that grows (its path), an address such as ``rtsp://...``, a camera's number, or its device
        (``/dev/video0``).
    idle_s
        After how long without anything new it has ended [s].

    Attributes
    ----------
    name
        The source in words.

    Notes
    -----
    A picture that is not taken within a second gives way to newer ones. Where decoding itself falls 2 s behind, what
    has come is passed over up to the next key frame. Both are counted.

    When a picture was taken is not known, only its stamp. `LivePicture.due_s` is its stamp on this machine's clock by
    the quickest pictures so far: what camera, encoder and writer hold back of all pictures is not in it.

    Examples
    --------
    >>> LiveSource("7", idle_s=0.1).name.endswith("7")
    True
    """

    def __init__(self, source: str, *, idle_s: float) -> None:
        self.name, self._idle_s = source, idle_s
        self.width = self.height = self.bit_depth = 0
        self.range = (0.0, 0.0)
        self._stop, self._news = Event(), Condition()
        self._queue: deque[LivePicture] = deque()
        self._counts, self._stamps = LiveCounts(), deque[float](maxlen=_STAMPS)
        self._ended = ""
        self._error: VideoError | None = None
        self._file: GrowingFile | None = None
        self._first: tuple[float, int] | None = None  # stamp [s] and turn [deg] of the first picture
        self._last_s, self._offset_s, self._offset_at = -np.inf, np.inf, time.monotonic()
        self._thread = Thread(target=self._run, name=f"read {source}", daemon=True)

    def start(self) -> None:
        """Begins to read."""
        self._thread.start()

    def stop(self) -> None:
        """Ends reading; what waits can still be taken."""
        self._stop.set()
        # A thread that waits for a camera ends when that answers; it must not keep the program from ending.
        self._thread.join(timeout=1.0)

    def take(self, timeout_s: float) -> LivePicture | None:
        """The oldest picture that waits; ``None`` where none came in this time, or none will.

        Parameters
        ----------
        timeout_s
            How long to wait for one [s].

        Raises
        ------
        VideoError
            The source cannot be opened or decoded.
        """
        with self._news:
            self._news.wait_for(lambda: bool(self._queue or self._ended), timeout_s)
            if self._queue:
                return self._queue.popleft()
            if self._error is not None:
                raise self._error
            return None

    @property
    def ended(self) -> str:
        """Why nothing more comes; empty as long as something may."""
        with self._news:
            return "" if self._queue else self._ended

    @property
    def counts(self) -> LiveCounts:
        """What has come so far."""
        return self._counts

    def stamps_s(self) -> FloatArray:
        """Times of the last pictures that came, decoded or not, increasing, shape (T,) [s]."""
        with self._news:
            return np.unique(np.array(self._stamps, np.float64))

    def _run(self) -> None:
        error: VideoError | None = None
        try:
            ended = self._read_source()
        except VideoError as found:
            ended, error = str(found), found
        except (av.FFmpegError, OSError) as found:
            silent = isinstance(found, av.ExitError)
            why = f"nothing within {self._idle_s:g} s" if silent else found.strerror or str(found)
            ended = f"{self.name}: expected pictures, got {why}; check camera and connection"
        if self._stop.is_set():
            ended = "stopped"
        elif self._first is None:
            error = error or VideoError(ended)
        with self._news:
            self._ended, self._error = ended, None if self._stop.is_set() else error
            self._news.notify_all()

    def _read_source(self) -> str:
        """Reads until nothing more comes, and says why."""
        with self._open() as container:
            video = choose_stream(container, self.name)
            # Each thread holds a picture back.
            video.thread_count = min(os.cpu_count() or 1, _THREADS)
            try:
                self._read(container, video)
            finally:
                drain(video.codec_context)
        if self._first is None:
            return f"{self.name}: expected pictures, got none that can be decoded; check what is recorded"
        return f"nothing new for {self._idle_s:g} s" if self._file is not None else "the stream has ended"

    @contextmanager
    def _open(self) -> Iterator[av.container.InputContainer]:
        asked: dict[str, Any] = {"mode": "r", "metadata_errors": "replace"}
        if not (self.name.isdecimal() or self.name.startswith("/dev/") or "://" in self.name):
            with (
                GrowingFile(Path(self.name), idle_s=self._idle_s, stopped=self._stop) as self._file,
                self._container(self._file, asked) as container,
            ):
                yield container
            return
        asked |= {
            "timeout": (max(self._idle_s, 1.0), max(self._idle_s, 1.0)),
            "container_options": {"fflags": "nobuffer"},
        }
        if self.name.startswith("rtsp"):
            asked["container_options"]["rtsp_transport"] = "tcp"
        address = self.name
        if "://" not in address:
            if sys.platform not in _CAMERAS:
                raise VideoError(
                    f"{address}: expected Linux or macOS for a camera, got {sys.platform}; give an RTSP address"
                )
            asked["format"], device = _CAMERAS[sys.platform]
            address = device.format(address) if address.isdecimal() else address
        with self._container(address, asked) as container:
            yield container

    def _container(self, what: object, asked: dict[str, Any]) -> av.container.InputContainer:
        try:
            return cast("av.container.InputContainer", av.open(what, **asked))
        except (av.FFmpegError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise VideoError(
                f"{self.name}: expected a live source that FFmpeg can open, got an error ({why}); check address, "
                "device or file"
            ) from error

    def _read(self, container: av.container.InputContainer, video: av.VideoStream) -> None:
        """Decodes until the source ends; from key frame to key frame where data are damaged or too many."""
        skipping, lost, inside = True, False, 0
        for packet in container.demux(video):
            if self._stop.is_set():
                return
            stamp_s = None if packet.pts is None else float(packet.pts * packet.time_base)
            behind_s = 0.0 if stamp_s is None else self._follow_clock(stamp_s)
            if packet.size and (behind_s > _BEHIND_S or (skipping and not packet.is_keyframe)):
                skipping = True
                self._pass_over(stamp_s, damaged=lost)
                continue
            skipping = lost = False
            inside += packet.size > 0
            try:
                for picture in packet.decode():
                    inside -= 1
                    self._enter(picture)
            except av.InvalidDataError:
                skipping = lost = True
                inside -= 1
                self._pass_over(stamp_s, damaged=True)
        # What went in and did not come out, the decoder lost without a word.
        for _ in range(inside):
            self._pass_over(None, damaged=True)

    def _follow_clock(self, stamp_s: float) -> float:
        """Fits this machine's clock to a stamp just read; returns how far that lies behind what has come [s]."""
        now = time.monotonic()
        allowed = self._offset_s + _DRIFT * (now - self._offset_at)
        self._offset_s, self._offset_at = min(allowed, now - stamp_s), now
        if self._first is None:
            return 0.0
        if self._file is not None:
            return self._file.waiting_bytes / self._file.position * (stamp_s - self._first[0])
        return now - stamp_s - self._offset_s

    def _enter(self, picture: av.VideoFrame) -> None:
        """Puts a picture into the queue."""
        stamp_s = time.monotonic() if picture.time is None else picture.time
        if self._first is None:
            self._first = stamp_s, read_rotation(picture, self.name)
            self._describe(picture)
        time_s, turn = stamp_s - self._first[0], self._first[1]
        luma = luma_plane(picture)
        luma = np.rot90(luma, -turn // 90) if turn else luma
        if (luma.shape[1], luma.shape[0]) != (self.width, self.height):
            raise VideoError(
                f"{self.name}: expected {self.width} x {self.height} px throughout, got {luma.shape[1]} x "
                f"{luma.shape[0]}; watch again with the camera's new setting"
            )
        if picture.is_corrupt or time_s <= self._last_s:
            self._pass_over(None, damaged=True)
            return
        self._last_s = time_s
        # What the decoder gives up at a file's end it held back because nothing came, which tells no latency.
        unknown = self._lay_there or (self._file is not None and self._file.complete)
        with self._news:
            passed = 0
            self._queue.append(LivePicture(time_s, luma, np.nan if unknown else stamp_s + self._offset_s))
            while time_s - self._queue[0].time_s > _HELD_S or len(self._queue) * luma.nbytes > _HELD_BYTES:
                self._queue.popleft()
                passed += 1
            self._add(came=1, **{"before" if self._lay_there else "dropped": passed})
            self._stamps.append(stamp_s)
            self._news.notify()

    @property
    def _lay_there(self) -> bool:
        """Whether what is read now was in the file before."""
        return self._file is not None and not self._file.reached_end

    def _pass_over(self, stamp_s: float | None, *, damaged: bool = False) -> None:
        """Counts a picture that is not shown."""
        why = "dropped" if self._first is not None and not self._lay_there else "before"
        with self._news:
            self._add(came=1, **{"damaged" if damaged else why: 1})
            if stamp_s is not None:
                self._stamps.append(stamp_s)

    def _add(self, **more: int) -> None:
        self._counts = replace(self._counts, **{name: getattr(self._counts, name) + n for name, n in more.items()})

    def _describe(self, picture: av.VideoFrame) -> None:
        """Size, depth and range of the pictures."""
        self.bit_depth = luma_bits(picture.format.name)
        step, turned = 2 ** (self.bit_depth - 8), self._first is not None and self._first[1] % 180
        self.height, self.width = (picture.width, picture.height) if turned else (picture.height, picture.width)
        full = picture.color_range == _JPEG_RANGE or not picture.format.name.startswith("yuv")
        full = full or picture.format.name.startswith("yuvj")
        self.range = (0.0, 256.0 * step - 1) if full else (16.0 * step, 235.0 * step)
