"""Parts of recordings as frames of single files, small enough to be sent to another process, and where to cut."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.inputs.video.decoder import Start
from vfm_sdm.inputs.video.records import DecodeStop, Frame, VideoInfo

__all__ = ["Cut", "CutSource", "FileSource", "choose_cuts"]

_LEAST = 0.5
"""Share of a segment's length below which what is left at the end belongs to the segment before it."""


class FileSource(Protocol):
    """Frames of one file, or of one sequence of images."""

    def decode(self, number: int, start: Start | None) -> Generator[Frame]:
        """A pass that begins with a frame of this number, which decoding reaches from ``start``."""
        ...

    def on_one_thread(self) -> "FileSource":
        """The same file, decoded picture by picture."""
        ...


@dataclass(frozen=True, eq=False)
class Cut:
    """Frames of one file that follow one another.

    Parameters
    ----------
    source
        The file.
    number
        Number of the first frame in it.
    start
        Where decoding begins; ``None`` at the file's beginning.
    count
        Number of frames; ``None`` goes to the file's end.
    shift, shift_s
        What is added to numbers and times [s] of the file's frames.
    label
        Name of the file where it is one of several, for messages.
    """

    source: FileSource
    number: int
    start: Start | None
    count: int | None = None
    shift: int = 0
    shift_s: float = 0.0
    label: str = ""

    def moved(self, shift: int, shift_s: float, label: str = "") -> "Cut":
        """The same frames with other numbers and times [s].

        Parameters
        ----------
        shift, shift_s
            What is added to those they have.
        label
            Name of the file, where it has none yet.
        """
        return replace(self, shift=self.shift + shift, shift_s=self.shift_s + shift_s, label=self.label or label)

    def frames(self) -> Generator[Frame]:
        """A pass over the frames.

        Raises
        ------
        DecodeStop
            The file ends early or is damaged.
        """
        done = 0
        try:
            with closing(self.source.decode(self.number, self.start)) as frames:
                for frame in frames:
                    yield Frame(frame.index + self.shift, frame.time_s + self.shift_s, frame.luma, frame.convert)
                    done += 1
                    if done == self.count:
                        return
        except DecodeStop as damage:
            raise DecodeStop(damage.status, self._named(damage.detail)) from damage
        if self.count is not None:
            wanted = f"expected {self.count} frames, got {done}; copy the file again"
            raise DecodeStop(RecordingStatus.TRUNCATED, self._named(wanted))

    def _named(self, detail: str) -> str:
        return f"{self.label}: {detail}" if self.label else detail


@dataclass(frozen=True, eq=False)
class CutSource:
    """Frames of a part of a recording, with the numbers and times that they have in the whole.

    Parameters
    ----------
    info
        What is known of the whole recording.
    cuts
        Its frames, file by file.
    """

    info: VideoInfo
    cuts: Sequence[Cut]

    def on_one_thread(self) -> "CutSource":
        """The same part, decoded picture by picture."""
        return replace(self, cuts=[replace(cut, source=cut.source.on_one_thread()) for cut in self.cuts])

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the frames of the part."""
        for cut in self.cuts:
            yield from cut.frames()


def choose_cuts(clock_s: FloatArray, keys: IntArray, length_s: float) -> list[int]:
    """Numbers of the frames with which the segments of a recording begin.

    Parameters
    ----------
    clock_s
        Times of all frames, shape (T,) [s].
    keys
        Numbers of the frames with which decoding can begin, rising.
    length_s
        Nominal length of a segment [s].

    Notes
    -----
    A segment begins with the first such frame that is not before a whole multiple of the length, so that where it
    begins does not depend on the segments before it. What is left at the end is at least half a segment.

    Examples
    --------
    >>> choose_cuts(np.arange(0, 10, 0.1), np.arange(0, 100, 25), 3.0)
    [0, 50, 75]
    """
    if not len(clock_s):
        return [0]
    targets = np.arange(length_s, clock_s[-1], length_s)
    later = np.searchsorted(clock_s[keys], targets - 1e-9)
    firsts = np.unique(keys[later[later < len(keys)]])
    kept = firsts[(firsts > 0) & (clock_s[-1] - clock_s[firsts] >= _LEAST * length_s)]
    return [0, *kept.tolist()]
