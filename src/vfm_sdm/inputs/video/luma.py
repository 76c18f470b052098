"""Brightness of a decoded picture: the decoder's own Y plane wherever there is one."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import av
import numpy as np

from vfm_sdm.core.arrays import LumaArray

__all__ = ["has_luma_plane", "luma_bits", "luma_plane"]

_HIGH_BITS = {"p010": 6, "p012": 4, "p210": 6, "p212": 4, "p410": 6, "p412": 4}
"""Formats that keep their values in the upper bits of 16, and by how much these are shifted."""


@dataclass(frozen=True)
class _Layout:
    bits: int
    dtype: np.dtype[Any]
    shift: int
    convert_to: str | None


def has_luma_plane(pixel_format: str) -> bool:
    """Whether pictures of a pixel format keep their luma in a plane of its own.

    Parameters
    ----------
    pixel_format
        Name of the format in FFmpeg's words.

    Examples
    --------
    >>> has_luma_plane("yuv420p"), has_luma_plane("rgb24")
    (True, False)
    """
    return _layout(pixel_format).convert_to is None


def luma_bits(pixel_format: str) -> int:
    """Significant bits of the luma that `luma_plane` returns for a pixel format.

    Parameters
    ----------
    pixel_format
        Name of the format in FFmpeg's words.

    Examples
    --------
    >>> luma_bits("yuv420p"), luma_bits("yuv420p10le")
    (8, 10)
    """
    return _layout(pixel_format).bits


def luma_plane(frame: av.VideoFrame) -> LumaArray:
    """Brightness of a decoded picture.

    Parameters
    ----------
    frame
        Decoded picture in main memory, not rotated.

    Returns
    -------
    luma
        Shape (height, width), uint8 or uint16, read-only.

    Notes
    -----
    A planar YUV or grey picture is returned as a view into the decoder's memory, which stays alive with the view:
    no copy, no colour conversion, no change of range (limited-range video keeps its 16 .. 235). 10-bit values come
    as 0 .. 1023, also where the format keeps them in the upper bits. Packed YUV is unpacked, its luma unchanged;
    RGB and palette pictures are converted to grey of the same depth with FFmpeg's BT.601 weights.

    Examples
    --------
    >>> picture = av.VideoFrame.from_ndarray(np.full((32, 48), 90, np.uint8), format="gray")
    >>> luma = luma_plane(picture)
    >>> luma.shape, int(luma[0, 0])
    ((32, 48), 90)
    """
    layout = _layout(frame.format.name)
    if layout.convert_to is not None:
        return luma_plane(frame.reformat(format=layout.convert_to))
    plane = frame.planes[0]
    rows: LumaArray = np.frombuffer(memoryview(plane), dtype=layout.dtype).reshape(plane.height, -1)
    if plane.line_size < 0:
        # Bottom-up pictures: the buffer starts at the last row.
        rows = rows[::-1]
    luma = rows[:, : plane.width]
    if layout.shift:
        luma = cast("LumaArray", luma >> layout.shift)
    if not layout.dtype.isnative:
        luma = luma.astype(layout.dtype.newbyteorder("="))
    # The decoder goes on to predict from this very memory.
    luma.flags.writeable = False
    return luma


@lru_cache(maxsize=64)
def _layout(name: str) -> _Layout:
    pixel_format = av.VideoFormat(name)
    components = pixel_format.components
    first = components[0]
    others = components[1:]
    depth = max(8, first.bits)
    alone = all(component.plane != first.plane for component in others)
    is_luma = first.is_luma and not pixel_format.has_palette
    if is_luma and alone and 8 <= first.bits <= 16:
        order = ">" if pixel_format.is_big_endian else "<"
        dtype = np.dtype(np.uint8) if first.bits == 8 else np.dtype(f"{order}u2")
        return _Layout(first.bits, dtype, _HIGH_BITS.get(name[:4], 0), None)
    family = "yuv444p" if is_luma and any(component.is_chroma for component in others) else "gray"
    known = depth if depth in (8, 9, 10, 12, 14, 16) else 16
    target = family if known == 8 else f"{family}{known}le"
    return _Layout(known, np.dtype(np.uint8 if known == 8 else np.uint16), 0, target)
