"""When every frame of a video file was taken, and with which ones decoding can begin; found without decoding."""

from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np

from vfm_sdm.core.arrays import IntArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.decoder import open_stream

__all__ = ["Timeline", "read_timeline"]


@dataclass(frozen=True, eq=False)
class Timeline:
    """Stamps of a video stream.

    Parameters
    ----------
    stamps
        Of all frames in the order they are shown, shape (T,) [unit of the stream's stamps].
    keys
        Of the frames with which decoding can begin, a part of these, shape (K,).
    """

    stamps: IntArray
    keys: IntArray

    def key_before(self, stamp: int) -> int:
        """Stamp of the last key frame that is not shown after a stamp; of the first one where none is."""
        return int(self.keys[max(int(np.searchsorted(self.keys, stamp, side="right")) - 1, 0)])


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
    """
    stamps, keys = [], []
    with open_stream(path) as (container, video):
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
        except av.FFmpegError as error:
            # What was read so far is what a pass over the frames can yield; that names the damage.
            if not keys:
                raise VideoError(f"{path}: expected a readable file, got {error.strerror}; copy it again") from error
    shown = np.unique(np.array(stamps, np.int64))
    found = np.unique(np.array(keys, np.int64))
    shown, found = shown[shown >= first], found[found >= first]
    if not found.size:
        raise VideoError(f"{path}: expected a key frame, got none; convert the recording to H.264 or HEVC")
    return Timeline(shown, found)
