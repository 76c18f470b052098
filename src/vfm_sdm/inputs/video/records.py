"""What a view says about itself, what a pass over it yields, and what a source of frames has to offer."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from datetime import datetime
from typing import Protocol

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.inputs.video.camera_tags import CameraTags
from vfm_sdm.inputs.video.region import Region

__all__ = ["DecodeReport", "DecodeStop", "Frame", "FrameSource", "RgbArray", "VideoInfo"]

RgbArray = npt.NDArray[np.uint8]
"""Red, green, blue, shape (height, width, 3)."""


@dataclass(frozen=True)
class VideoInfo:
    """What the container or the first image says; nothing here was counted by decoding."""

    source: str
    """File or pattern, as given."""
    width: int
    """Columns after rotation [px]."""
    height: int
    """Rows after rotation [px]."""
    fps: float
    """Mean rate [1/s]; NaN where the container names none. Time stamps, not this, place the frames in time."""
    frame_count: int | None
    """Number of frames that the container claims; ``None`` where it makes no claim (Matroska)."""
    duration_s: float | None
    """Duration that the container claims [s]."""
    codec: str
    """Decoder, or the images' file type."""
    pixel_format: str
    """Layout of the decoded picture, in FFmpeg's words."""
    bit_depth: int
    """Significant bits of the luma; values lie in 0 .. 2**bit_depth - 1."""
    rotation_deg: int
    """Clockwise turn that the container asks for, and that was applied to every frame: 0, 90, 180 or 270 [deg].

    0 for images, whose EXIF orientation is applied while they are read.
    """
    pixel_aspect: float = 1.0
    """Width of a pixel over its height, both after rotation [1]; what the container says of how it is to be shown."""
    time_scale: float = 1.0
    """Seconds that went by while the camera filmed, in one second of the container's stamps [1]: 1/4 for slow motion
    that was taken at 120 and is stored at 30 frames a second. `Frame.time_s`, `fps` and `duration_s` are true time."""
    remarks: tuple[str, ...] = ()
    """Sentences on what is unusual about the recording and was allowed for."""
    doubts: tuple[str, ...] = ()
    """Sentences on what may be wrong with it and cannot be mended."""
    size_bytes: int | None = None
    """Size of the compressed data, as far as the file tells; ``None`` of images [byte]."""
    camera: CameraTags = field(default_factory=CameraTags)
    """What the file says of the camera."""
    time_code: str = ""
    """Time code of the first frame, as the camera wrote it."""
    date: datetime | None = None
    """When the file was begun, by its own account."""


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One picture of a view."""

    index: int
    """Position among the frames that the pass yielded, from 0."""
    time_s: float
    """Time from the view's first frame [s], from the container's time stamps, as it went by while the camera filmed."""
    luma: LumaArray
    """Brightness, shape (height, width), read-only; valid as long as it is referenced.

    It may be a strided view into the decoder's memory (padded rows, a rotated picture): copy it where a routine
    needs contiguous rows. A live reference keeps the whole decoded picture in memory.
    """
    convert: Callable[[Region], RgbArray]
    """Colours of a region that lies inside the picture and is not resized, shape (height, width, 3); `color` calls it.

    It refers to the picture that the luma was taken from, so that colours can be had as long as the frame lives.
    """

    def color(self, region: Region | None = None) -> RgbArray:
        """The frame, or a region of it, in colour; the colours are converted only now.

        Parameters
        ----------
        region
            What to convert, in pixels of the luma, resized to its canvas; the whole frame when ``None``.

        Returns
        -------
        colours
            Red, green and blue in 8 bits, shape (height, width, 3), or that of the region's canvas.

        Raises
        ------
        DatasetError
            The region leaves the frame.
        VideoError
            The frame is in a colour space that cannot be converted.
        """
        rows, columns = self.luma.shape
        wanted = Region(0, 0, columns, rows) if region is None else region
        wanted.check_inside((columns, rows))
        part = Region(wanted.x, wanted.y, wanted.width, wanted.height)
        return wanted.within(part).crop(self.convert(part))


@dataclass(frozen=True)
class DecodeReport:
    """What happened in a pass over the frames."""

    frames: int
    """Frames yielded."""
    duplicated: int
    """Frames whose luma equals that of the frame before."""
    dropped: int
    """Frames missing in the time stamps (see `vfm_sdm.inputs.video.clock`), or in the numbers of images."""
    status: RecordingStatus
    message: str
    alike: tuple[int, ...] = ()
    """Numbers of the frames that hold the noise of the frame before (see `vfm_sdm.inputs.video.repeats`)."""


class DecodeStop(Exception):  # noqa: N818  (the end of what can be read, not misuse: it never leaves `Video.frames`)
    """Raised by a source of frames where the data end early or can no longer be trusted.

    Parameters
    ----------
    status
        ``truncated`` or ``corrupt``.
    detail
        What was found, and what to do about it.
    """

    def __init__(self, status: RecordingStatus, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail


class FrameSource(Protocol):
    """Where a `Video` takes its frames from: a container, an image sequence, or something that a test makes up."""

    @property
    def info(self) -> VideoInfo:
        """What is known before any pass."""
        ...

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the frames, in order, numbered from 0.

        Raises
        ------
        DecodeStop
            The data end early or are damaged; everything yielded before is sound.
        VideoError
            A frame contradicts the others in a way that the user has to mend.
        """
        ...
