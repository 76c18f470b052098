"""Files of synthetic frames as a camera writes them: H.264 or HEVC with exact time stamps."""

from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast

import av
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.files import replace_file
from vfm_sdm.errors import VideoError

if TYPE_CHECKING:
    from av import VideoStream

__all__ = ["write_video"]

_LIMITED_RANGE = 1
"""FFmpeg's code for luma from 16 to 235."""
_KINDS = {"libx264": "H.264", "libx265": "HEVC"}
_TIME_BASE = 512
"""Ticks of the container's clock in a frame interval."""


def write_video(
    path: Path | str,
    frames: Iterable[npt.NDArray[np.uint8]],
    *,
    fps: Fraction | int,
    chroma: npt.NDArray[np.uint8] | None = None,
    options: Mapping[str, str],
    stamps: npt.ArrayLike | None = None,
) -> Path:
    """Writes frames as H.264 or HEVC, 4:2:0, to an MP4 or another container named by the suffix.

    Parameters
    ----------
    path
        File to write; it is replaced only when the new file is complete.
    frames
        Luma, each of shape (H, W), H and W even; read one at a time.
    fps
        Frames a second; frame k gets the time stamp k / fps exactly.
    chroma
        Chroma of all frames, shape (2, H / 2, W / 2); grey when None.
    options
        Options of the encoder x264, such as ``{"crf": "14", "preset": "fast", "threads": "2"}``; of another one, such
        as ``libx265`` for HEVC, with its name as ``codec``. Two runs give the same bytes when the number of threads is
        fixed.
    stamps
        Time stamps that rise, one a frame at least, shape (N,) [frame intervals]; 0, 1, 2, ... when ``None``. Rounded
        to 1/512 of an interval.

    Raises
    ------
    VideoError
        There is no frame, frames differ in size or have an odd one, or the file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> frames = [np.full((48, 64), 16 + 10 * number, np.uint8) for number in range(3)]
    >>> with TemporaryDirectory() as folder:
    ...     file = write_video(f"{folder}/left.mp4", frames, fps=30, options={"qp": "0", "threads": "1"})
    ...     with av.open(file) as container:
    ...         print(container.streams.video[0].frames)
    3
    """
    target = Path(path)
    rate = Fraction(fps)
    settings = dict(options)
    codec = settings.pop("codec", "libx264")
    ticks = None if stamps is None else np.rint(_TIME_BASE * np.asarray(stamps, np.float64)).astype(int).tolist()
    try:
        with (
            replace_file(target) as temporary,
            av.open(str(temporary), "w") as container,
            ThreadPoolExecutor(1) as worker,
        ):
            encoded: Future[None] | None = None
            stream = cast("VideoStream", container.add_stream(codec, rate=rate, options=settings))
            stream.pix_fmt = "yuv420p"
            stream.codec_context.color_range = _LIMITED_RANGE
            # Finer than a frame, because the muxer rounds decoding times of reordered frames to it.
            stream.codec_context.time_base = 1 / (rate * _TIME_BASE)
            colour: npt.NDArray[np.uint8] | None = None

            def encode(picture: npt.NDArray[np.uint8], number: int) -> None:
                frame = av.VideoFrame.from_ndarray(picture, format="yuv420p")
                frame.pts = number * _TIME_BASE if ticks is None else ticks[number]
                frame.time_base = stream.codec_context.time_base
                container.mux(stream.encode(frame))

            for number, luma in enumerate(frames):
                height, width = luma.shape
                if colour is None:
                    stream.width, stream.height = width, height
                    colour = _colour_rows(chroma, width, height)
                if (stream.height, stream.width) != luma.shape:
                    raise VideoError(
                        f"frame {number}: expected {stream.width} x {stream.height} px as the first, got "
                        f"{width} x {height}; render all frames of a view with one camera"
                    )
                picture = np.concatenate([luma, colour])
                # One frame is encoded while the next is drawn.
                if encoded is not None:
                    encoded.result()
                encoded = worker.submit(encode, picture, number)
            if colour is None:
                raise VideoError(f"{target}: expected at least one frame, got none; pass frames")
            if encoded is not None:
                encoded.result()
            container.mux(stream.encode(None))
    except av.FFmpegError as error:
        kind = _KINDS.get(codec, codec)
        raise VideoError(f"{target}: expected to write {kind} with {settings}, got: {error}; check both") from error
    return target


def _colour_rows(chroma: npt.NDArray[np.uint8] | None, width: int, height: int) -> npt.NDArray[np.uint8]:
    """Both chroma planes as the rows that follow the luma in planar 4:2:0."""
    shape = (2, height // 2, width // 2)
    if width % 2 or height % 2 or (chroma is not None and chroma.shape != shape):
        found = "" if chroma is None else f" and chroma {chroma.shape}"
        raise VideoError(f"frame: expected an even size and chroma {shape}, got {width} x {height} px{found}; crop it")
    planes = np.full(shape, 128, np.uint8) if chroma is None else chroma
    return planes.reshape(height // 2, width)
