"""How a recording was compressed: types and quantisers of its first frames, and what its encoder says of itself."""

import gc
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import cast

import av
import av.logging
import numpy as np
import numpy.typing as npt
from av.bitstream import BitStreamFilterContext
from av.sidedata.encparams import VideoEncParams
from av.sidedata.sidedata import SideData

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray, mean_of_known
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.decoder import Start, open_stream, seek_key
from vfm_sdm.inputs.video.luma import luma_plane
from vfm_sdm.inputs.video.reader import Video
from vfm_sdm.inputs.video.region import Region

__all__ = ["BLOCK_PX", "CodedClip", "read_coded_clip"]

BLOCK_PX = 16
"""Side of the blocks of H.264, each with its own quantiser [px]."""
_QUANTISER = re.compile(r"\d+\s+(init_qp_minus26|slice_qp_delta)\s+\d+ = (-?\d+)")
_HEADERS = Lock()
_UUID_BYTES = 16
_KEPT = 4
"""Pictures after which those read before are let go."""
_DELTA = 4
"""Place of a block's difference from the picture's quantiser, after its place and size."""


@dataclass(frozen=True, eq=False)
class CodedClip:
    """The first frames of a compressed recording, in the order they are shown, and parts of their pictures.

    Parameters
    ----------
    codec
        ``h264`` or ``hevc``.
    pixel_format
        Layout of the pictures, in FFmpeg's words.
    bit_depth
        Significant bits of the luma.
    encoder
        What the encoder wrote into the stream about itself (x264 and x265 do); empty where it wrote nothing.
    frame_types
        1 for pictures by themselves (I), 2 for those predicted from earlier ones (P), 3 for those from both sides (B),
        shape (T,).
    quantisers
        Quantisation parameters on the codec's scale: of every block of `BLOCK_PX`, shape (T, rows, columns), with
        H.264; of the whole picture, shape (T, 1, 1), with HEVC whose encoder does not say how it was
        set; NaN where they were not found.
    crops
        Luma of the parts asked for, each of shape (T, height, width).
    first
        Luma of the whole first picture, shape (H, W).
    """

    codec: str
    pixel_format: str
    bit_depth: int
    encoder: str
    frame_types: IntArray
    quantisers: FloatArray
    crops: list[LumaArray]
    first: LumaArray

    def quantisers_of(self, region: Region) -> FloatArray:
        """Mean quantiser of the blocks that a region touches in each frame, shape (T,).

        Parameters
        ----------
        region
            Part of the picture as it is shown [px].
        """
        rows, columns = self.quantisers.shape[1:]
        first_row, first_column = (
            min(max(x // BLOCK_PX, 0), n - 1) for x, n in ((region.y, rows), (region.x, columns))
        )
        last_row = max(-(-(region.y + region.height) // BLOCK_PX), first_row + 1)
        last_column = max(-(-(region.x + region.width) // BLOCK_PX), first_column + 1)
        return mean_of_known(self.quantisers[:, first_row:last_row, first_column:last_column], axis=(1, 2))


def read_coded_clip(video: Video, regions: Sequence[Region], *, frames: int) -> CodedClip | None:
    """The first frames of a recording, as they were compressed; ``None`` where it is neither H.264 nor HEVC.

    Parameters
    ----------
    video
        The recording; it is read by itself, in one pass of a few frames.
    regions
        Parts of the picture to keep, in pixels of the picture as it is shown; what lies outside of it is mirrored.
    frames
        Number of frames to read.

    Notes
    -----
    FFmpeg's decoder exports the quantiser of every block of H.264. Of HEVC, the headers of the slices tell that of
    each picture, before the encoder adapts it to the blocks.
    """
    if video.info.codec not in ("h264", "hevc"):
        return None
    path, start = video.compressed_from()
    turns = -video.info.rotation_deg // 90
    types: list[int] = []
    stamps: list[int | None] = []
    quantisers: list[npt.NDArray[np.float32] | None] = []
    crops: list[list[LumaArray]] = [[] for _ in regions]
    encoder, first = "", None
    # With several pictures in work at once, FFmpeg exports quantisers of some before they are read: by chance.
    one_by_one = open_stream(path, threads=False)
    with suppress(av.FFmpegError, VideoError), one_by_one as (container, stream), _old_objects_aside():
        stream.codec_context.options = {"export_side_data": "venc_params"}
        if start is not None:
            # Encoders say what they are in the first picture alone.
            encoder = _read_encoder(next(container.decode(stream)))
            seek_key(container, stream, start)
        for picture in container.decode(stream):
            if start is not None and (picture.pts is None or picture.pts < start.stamp):
                continue
            types.append(int(picture.pict_type))
            stamps.append(picture.pts)
            encoder = encoder or _read_encoder(picture)
            quantisers.append(_read_quantisers(picture))
            luma = np.rot90(luma_plane(picture), turns)
            first = luma.copy() if first is None else first
            for kept, region in zip(crops, regions, strict=True):
                kept.append(_cut(luma, region))
            if len(types) % _KEPT == 0:
                gc.collect()
            if len(types) == frames:
                break
    if first is None:
        return None
    if not encoder and any(found is None for found in quantisers):
        by_stamp = _read_slice_quantisers(path, start, frames)
        quantisers = [np.full((1, 1), by_stamp.get(stamp, np.nan), np.float32) for stamp in stamps]
    known = [found for found in quantisers if found is not None]
    if len(known) < len(types) or len({found.shape for found in known}) > 1:
        known = [np.full((1, 1), np.nan, np.float32) for _ in types]
    return CodedClip(
        codec=video.info.codec,
        pixel_format=video.info.pixel_format,
        bit_depth=video.info.bit_depth,
        encoder=encoder,
        frame_types=np.array(types),
        quantisers=np.array([np.rot90(found, turns) for found in known], np.float64),
        crops=[cast("LumaArray", np.array(kept)) for kept in crops],
        first=first,
    )


@contextmanager
def _old_objects_aside() -> Iterator[None]:
    """Lets collections of garbage look at new objects alone, so that they take no time.

    A picture and the data beside it refer to each other: only the collector frees them, and it counts objects, not
    megabytes.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _cut(luma: LumaArray, region: Region) -> LumaArray:
    """A copy of the region, mirrored about the border of the picture."""
    indices = []
    for first, count, size in ((region.y, region.height, luma.shape[0]), (region.x, region.width, luma.shape[1])):
        period = max(2 * (size - 1), 1)
        folded = np.abs(np.arange(first, first + count)) % period
        indices.append(np.minimum(folded, period - folded))
    return cast("LumaArray", luma[indices[0][:, None], indices[1][None, :]])


def _side_data(picture: av.VideoFrame) -> Iterable[SideData]:
    # Iterating over this mapping gives its values.
    return cast("Iterable[SideData]", picture.side_data)


def _read_quantisers(picture: av.VideoFrame) -> npt.NDArray[np.float32] | None:
    """Quantisers of the blocks of a picture, shape (rows, columns); ``None`` where the decoder exports none."""
    for data in _side_data(picture):
        if data.type.name == "VIDEO_ENC_PARAMS":
            params = cast("VideoEncParams", data)
            blocks = np.frombuffer(bytes(data), np.int32, offset=params.blocks_offset).reshape(params.nb_blocks, -1)
            columns = int(np.count_nonzero(blocks[:, 1] == blocks[0, 1]))
            found = (params.qp + blocks[:, _DELTA]).reshape(-1, columns).astype(np.float32)
            # Blocks of pictures without any difference from their prediction have none.
            return np.where(found > 0, found, np.float32(np.nan))
    return None


def _read_encoder(picture: av.VideoFrame) -> str:
    """What the encoder says of itself beside a picture."""
    for data in _side_data(picture):
        if data.type.name == "SEI_UNREGISTERED":
            text = bytes(data)[_UUID_BYTES:].rstrip(b"\0").decode("ascii", errors="replace")
            if text.startswith(("x264", "x265")):
                return text
    return ""


def _read_slice_quantisers(path: Path, start: Start | None, frames: int) -> dict[int | None, float]:
    """Quantisers of the first slices of pictures by time stamp, from their headers as FFmpeg prints them."""
    found: dict[int | None, float] = {}
    # The lines come through the log, whose level is one for the process.
    with _HEADERS, open_stream(path, threads=False) as (container, stream):
        level = av.logging.get_level()
        av.logging.set_level(av.logging.TRACE)
        try:
            with av.logging.Capture() as lines:
                if start is not None:
                    seek_key(container, stream, start)
                headers, initial = BitStreamFilterContext("trace_headers", stream), 26
                for packet in container.demux(stream):
                    used = sum(start is None or (at or 0) >= start.stamp for at in found)
                    if not packet.size or used >= 2 * frames:
                        break
                    stamp, done = packet.pts, len(lines)
                    headers.filter(packet)
                    for line in lines[done:]:
                        match = _QUANTISER.match(line[2])
                        if match and match[1] == "init_qp_minus26":
                            initial = 26 + int(match[2])
                        elif match:
                            found.setdefault(stamp, float(initial + int(match[2])))
        except av.FFmpegError:
            return found
        finally:
            av.logging.set_level(level)
    return found
