"""Bytes of a file that another process is still writing."""

import struct
import time
from pathlib import Path
from threading import Event
from typing import BinaryIO

from vfm_sdm.errors import VideoError

__all__ = ["GrowingFile"]

_POLL_S = 0.01
_ISO_BOXES = {b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"uuid", b"styp", b"sidx", b"moof"}
_READABLE = "record MPEG-TS (.ts), Matroska (.mkv) or fragmented MP4, or measure the film when it is complete"


class GrowingFile:
    """A file that is read from its beginning on; at its end it is waited for more.

    Parameters
    ----------
    path
        The file. It may not be there yet.
    idle_s
        How long it may stay as it is before it counts as complete [s].
    stopped
        Set by whoever wants no more of it.

    Attributes
    ----------
    position
        Bytes handed out so far.
    complete
        Whether it has stopped growing.
    reached_end
        Whether everything that was there has been handed out at least once.

    Raises
    ------
    VideoError
        There is no such file, nothing comes into it, or it is an MP4 that can be read only when it is complete.

    Notes
    -----
    It has ``read`` alone: nobody may jump to the end of what has none, so that FFmpeg reads it as it would a pipe.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "film.ts").write_bytes(b"0123456789")
    ...     with GrowingFile(Path(folder, "film.ts"), idle_s=0.05, stopped=Event()) as file:
    ...         print(file.read(8), file.read(8), file.read(8), file.reached_end)
    b'01234567' b'89' b'' True
    """

    def __init__(self, path: Path, *, idle_s: float, stopped: Event) -> None:
        self.name = str(path)
        self.position, self.reached_end = 0, False
        self._path, self._idle_s, self._stopped = path, idle_s, stopped
        self.complete = False
        self._file = self._open()
        try:
            self._check_index()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "GrowingFile":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int) -> bytes:
        """The next bytes, at most so many; none when the file has stopped growing, or was to be read no more.

        Parameters
        ----------
        size
            Largest number of bytes.
        """
        found = self._wait(size)
        self.position += len(found)
        return found

    @property
    def waiting_bytes(self) -> int:
        """Bytes that are there and not yet handed out."""
        return self._path.stat().st_size - self.position

    def _wait(self, size: int) -> bytes:
        """The next bytes, as soon as there are some."""
        deadline = time.monotonic() + self._idle_s
        while not (self._stopped.is_set() or self.complete):
            if found := self._file.read(size):
                return found
            self.reached_end = True
            # Who reads asks several times before it believes that there is no more.
            self.complete = time.monotonic() > deadline
            self._stopped.wait(_POLL_S)
        return b""

    def _open(self) -> BinaryIO:
        deadline = time.monotonic() + self._idle_s
        while not self._path.is_file():
            if self._path.is_dir() or time.monotonic() > deadline or self._stopped.is_set():
                found = "a folder" if self._path.is_dir() else f"nothing of that name within {self._idle_s:g} s"
                raise VideoError(
                    f"{self._path}: expected a video file, got {found}; start recording, or check the path"
                )
            self._stopped.wait(_POLL_S)
        return self._path.open("rb", buffering=0)

    def _check_index(self) -> None:
        """Refuses MP4 and QuickTime files whose index is written when they are complete."""
        place = 0
        while True:
            self._file.seek(place)
            head = self._exactly(8)
            if len(head) < 8:
                if place == 0:
                    raise VideoError(
                        f"{self._path}: expected a video, got {len(head)} bytes and no more within {self._idle_s:g} s; "
                        "check that the camera records into it"
                    )
                break
            size, kind = struct.unpack(">I4s", head[:8])
            if (place == 0 and kind not in _ISO_BOXES) or kind in (b"moov", b"moof"):
                break
            if kind == b"mdat":
                raise VideoError(
                    f"{self._path}: expected a film that can be read while it is written, got an MP4 whose index comes "
                    f"at its end; {_READABLE}"
                )
            # Sizes of 0 and 1 are for data alone: what else says so is no such file.
            if size < 8:
                break
            place += size
        self._file.seek(0)
        self.complete = self.reached_end = False

    def _exactly(self, size: int) -> bytes:
        """So many bytes, or less where no more come."""
        found = b""
        while len(found) < size and (more := self._wait(size - len(found))):
            found += more
        return found
