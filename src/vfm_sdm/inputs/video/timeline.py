"""When every frame of a video file was taken, and with which ones decoding can begin; found without decoding."""

import re
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np

from vfm_sdm.core.arrays import IntArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.decoder import Start, open_stream

__all__ = ["Timeline", "read_timeline"]

_MEMORY = 16
"""Frames that a decoder of H.264 keeps at most."""
_UNIT_TYPE, _IDR = 0x1F, 5
_IDR_UNIT = re.compile(rb"\x00\x00\x01[\x25\x45\x65]")


@dataclass(frozen=True, eq=False)
class Timeline:
    """Stamps of a video stream.

    Parameters
    ----------
    stamps
        Of all frames in the order they are shown, shape (T,) [unit of the stream's stamps].
    keys
        Of the frames with which decoding can begin, a part of these, shape (K,).
    roots
        For each of them, of the key frame that the decoder is given first: itself or an earlier one, shape (K,).
    """

    stamps: IntArray
    keys: IntArray
    roots: IntArray

    def start_at(self, stamp: int) -> Start:
        """How decoding leads to a picture: from the last key frame that is not shown after it, or the first one.

        Parameters
        ----------
        stamp
            Stamp of the picture.
        """
        number = max(int(np.searchsorted(self.keys, stamp, side="right")) - 1, 0)
        return Start(stamp, int(self.keys[number]), int(self.roots[number]))


def read_timeline(path: Path, first: int) -> Timeline:
    """Stamps of all frames of a file; its data are read once, and not decoded.

    Parameters
    ----------
    path
        A video file.
    first
        Stamp of the first picture that can be shown; what is shown earlier lacks what it refers to.

    Raises
    ------
    VideoError
        The file cannot be read, has no key frame, or frames without time stamps.

    Notes
    -----
    In H.264, pictures after a key frame may say which of those before it are no longer needed, unless it resets the
    decoder (IDR); a decoder that did not get these takes that for damage. There, decoding begins with an earlier key
    frame.
    """
    stamps, keys, unready = [], [], []
    with open_stream(path) as (container, video):
        codec = video.codec_context
        try:
            for packet in container.demux(video):
                if not packet.size or packet.is_corrupt or packet.is_discard:
                    continue
                if packet.pts is None:
                    raise VideoError(
                        f"{path}: expected a time stamp for every frame, got one without; copy the recording into an "
                        "mp4 or mkv file with time stamps"
                    )
                stamps.append(packet.pts)
                if packet.is_keyframe:
                    keys.append(packet.pts)
                    if codec.name == "h264" and not _resets(bytes(packet), codec.extradata or b""):
                        unready.append(packet.pts)
        except av.FFmpegError as error:
            # What was read so far is what a pass over the frames can yield; that names the damage.
            if not keys:
                raise VideoError(f"{path}: expected a readable file, got {error.strerror}; copy it again") from error
    shown = np.unique(np.array(stamps, np.int64))
    found = np.unique(np.array(keys, np.int64))
    shown, found = shown[shown >= first], found[found >= first]
    if not found.size:
        raise VideoError(f"{path}: expected a key frame, got none; convert the recording to H.264 or HEVC")
    numbers = np.searchsorted(shown, found)
    before = np.maximum(np.searchsorted(numbers, numbers - _MEMORY, side="right") - 1, 0)
    return Timeline(shown, found, np.where(np.isin(found, unready), found[before], found))


def _resets(packet: bytes, header: bytes) -> bool:
    """Whether an H.264 packet holds an IDR picture; ``header`` tells how its units are told apart (ISO 14496-15)."""
    if header[:1] != b"\1":
        return _IDR_UNIT.search(packet) is not None
    place, size_bytes = 0, (header[4] & 3) + 1
    while place + size_bytes < len(packet):
        if packet[place + size_bytes] & _UNIT_TYPE == _IDR:
            return True
        place += size_bytes + int.from_bytes(packet[place : place + size_bytes])
    return False
