"""Colours of a decoded picture: FFmpeg's conversion of no more than the part that is asked for."""

from typing import Any, cast

import av
import numpy as np

from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.luma import has_luma_plane
from vfm_sdm.inputs.video.records import RgbArray
from vfm_sdm.inputs.video.region import Region

__all__ = ["convert_part"]

# Wide enough for the chroma samples that any conversion interpolates between, and for a whole period of its dither.
_MARGIN_PX = 8
_GRID_PX = 16
# From PyAV 17 on, a conversion otherwise starts a thread for each processor, which takes longer than a patch.
_ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.split(".")[0]) >= 17 else {}


def convert_part(picture: av.VideoFrame, region: Region, rotation_deg: int = 0) -> RgbArray:
    """Part of a decoded picture in colour.

    Parameters
    ----------
    picture
        Decoded picture in main memory, not rotated; it stays as it is.
    region
        The part [px], inside the rotated picture; its scale has no effect.
    rotation_deg
        Clockwise turn of the picture: 0, 90, 180 or 270 [deg].

    Returns
    -------
    colours
        Red, green and blue in 8 bits, shape (height, width, 3).

    Raises
    ------
    VideoError
        FFmpeg cannot convert from the colour space that the picture names.

    Notes
    -----
    Only the planes' rows and columns around the part are converted, without a copy of them, so that the colours
    equal those of the whole picture. The picture is converted whole where a part of it would be treated differently:
    luma and chroma in one plane, RGB, or a size that is no multiple of the chroma subsampling.

    Examples
    --------
    >>> picture = av.VideoFrame.from_ndarray(np.full((32, 48, 3), 128, np.uint8), format="rgb24")
    >>> convert_part(picture, Region(4, 8, 20, 10)).shape
    (10, 20, 3)
    """
    stored = _map_to_stored(region, picture, rotation_deg)
    tile = _tile_around(stored, picture)
    try:
        converted = _cut(picture, tile).to_ndarray(format="rgb24", **_ONE_THREAD)
    except av.FFmpegError as error:
        raise VideoError(
            f"colour: expected a colour space that FFmpeg converts to RGB, got number {picture.colorspace} of ITU-T "
            f"H.273 in {picture.format.name} ({error.strerror}); convert the file to BT.709"
        ) from error
    part = stored.within(tile).crop(cast("RgbArray", converted))
    return np.ascontiguousarray(np.rot90(part, -rotation_deg // 90))


def _map_to_stored(region: Region, picture: av.VideoFrame, rotation_deg: int) -> Region:
    """The region of the picture as it is stored that a region of the rotated picture shows [px]."""
    turns = rotation_deg // 90
    columns, rows = (picture.height, picture.width) if turns % 2 else (picture.width, picture.height)
    stored = Region(region.x, region.y, region.width, region.height)
    for _ in range(turns):
        # A quarter anticlockwise: the right border becomes the upper one.
        stored = Region(stored.y, columns - stored.x - stored.width, stored.height, stored.width)
        columns, rows = rows, columns
    return stored


def _tile_around(region: Region, picture: av.VideoFrame) -> Region:
    step_u = _GRID_PX // picture.format.chroma_width(_GRID_PX)
    step_v = _GRID_PX // picture.format.chroma_height(_GRID_PX) * (2 if picture.interlaced_frame else 1)
    # FFmpeg stretches chroma that reaches beyond the luma, in either field of an interlaced picture.
    if picture.width % step_u or picture.height % step_v or not has_luma_plane(picture.format.name):
        return Region(0, 0, picture.width, picture.height)
    left, right = _span(region.x, region.width, picture.width)
    top, bottom = _span(region.y, region.height, picture.height)
    return Region(left, top, right - left, bottom - top)


def _span(first: int, count: int, length: int) -> tuple[int, int]:
    start = max(first - _MARGIN_PX, 0) // _GRID_PX * _GRID_PX
    stop = -(-(first + count + _MARGIN_PX) // _GRID_PX) * _GRID_PX
    # An odd length stays odd: FFmpeg has another conversion for it.
    return start, min(stop + length % 2, length)


def _cut(picture: av.VideoFrame, tile: Region) -> av.VideoFrame:
    """A picture that refers to the same memory, with all properties that a conversion looks at."""
    if (tile.width, tile.height) == (picture.width, picture.height):
        return picture
    graph = av.filter.Graph()
    graph.threads = 1
    source = graph.add(
        "buffer",
        f"video_size={picture.width}x{picture.height}:pix_fmt={picture.format.name}:time_base=1/1:"
        f"colorspace={picture.colorspace}:range={picture.color_range}",
    )
    crop = graph.add("crop", f"w={tile.width}:h={tile.height}:x={tile.x}:y={tile.y}")
    graph.link_nodes(source, crop, graph.add("buffersink")).configure()
    graph.push(picture)
    return cast("av.VideoFrame", graph.pull())
