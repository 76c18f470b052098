"""Metadata in boxes of MP4 and QuickTime files that FFmpeg does not hand on, as text by name.

Read are, of the box ``moov``: text in ``udta``, GoPro's ``GPMF`` in it, and keys with values in ``meta``, of the movie
and of its tracks (QuickTime File Format Specification, Apple; ISO/IEC 14496-12; GPMF of GoPro). Of a file that is none
of these, or is cut, whatever stands before the fault.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

__all__ = ["read_boxes"]

_LARGEST = 1 << 20
"""Boxes of metadata that are larger hold pictures or something else [bytes]."""
_DEEPEST = 8
_NESTED = {b"moov", b"udta", b"trak"}
_NAMES = {
    b"FIRM": "firm",
    b"\xa9mak": "make",
    b"\xa9mod": "model",
    b"\xa9mdl": "model",
    b"manu": "make",
    b"modl": "model",
}
_GOPRO = {"MINF", "VFOV", "EISE", "EISA", "FMWR"}
_STRING, _NEST = ord("c"), 0
_DEVICE = re.compile(rb'<Device manufacturer="([^"<>]{1,64})" modelName="([^"<>]{1,64})"')
"""How Sony's cameras name themselves in the file's XML."""


def read_boxes(path: Path) -> dict[str, str]:
    """Metadata of a file by name; nothing where there are none or the file cannot be read.

    Parameters
    ----------
    path
        A video file.
    """
    found: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(4)
            if file.read(4) not in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
                return found
            for kind, start, end in _boxes(file, 0, size):
                if kind in _NESTED:
                    _walk(file, start, end, found, 0)
                elif kind == b"meta" and end - start <= _LARGEST:
                    device = _DEVICE.search(_content(file, start, end))
                    if device is not None:
                        found |= {"make": _text(device[1]), "model": _text(device[2])}
    except (OSError, struct.error):
        return found
    return found


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kinds of the boxes in a part of the file, with where their contents begin and end."""
    while start + 8 <= end:
        file.seek(start)
        size, kind = struct.unpack(">I4s", file.read(8))
        head = 8
        if size == 1:
            (size,) = struct.unpack(">Q", file.read(8))
            head = 16
        elif size == 0:
            size = end - start
        if size < head or start + size > end:
            return
        yield kind, start + head, start + size
        start += size


def _walk(file: BinaryIO, start: int, end: int, found: dict[str, str], depth: int) -> None:
    for kind, first, last in _boxes(file, start, end):
        if kind in _NESTED and depth < _DEEPEST:
            _walk(file, first, last, found, depth + 1)
        elif last - first > _LARGEST:
            continue
        elif kind == b"GPMF":
            _read_gopro(_content(file, first, last), found, 0)
        elif kind == b"meta":
            for name, value in _read_keys(file, first, last):
                found.setdefault(name, value)
        elif kind in _NAMES:
            content = _content(file, first, last)
            # International text begins with its length and language.
            length = struct.unpack(">H", content[:2])[0] if kind[:1] == b"\xa9" and len(content) > 4 else 0
            found.setdefault(_NAMES[kind], _text(content[4 : 4 + length] if length else content))


def _read_keys(file: BinaryIO, start: int, end: int) -> Iterator[tuple[str, str]]:
    """Names and values of a box ``meta``: the list ``keys``, and ``ilst`` with the number of a key in each item."""
    # In QuickTime it holds boxes at once, by ISO a version before them.
    if _content(file, start, end)[4:8] != b"hdlr":
        start += 4
    inner = {kind: (first, last) for kind, first, last in _boxes(file, start, end)}
    if b"keys" not in inner or b"ilst" not in inner:
        return
    content = _content(file, *inner[b"keys"])
    names, place = [], 8
    while place + 8 <= len(content):
        (size,) = struct.unpack(">I", content[place : place + 4])
        if size < 8:
            return
        names.append(_text(content[place + 8 : place + size]))
        place += size
    for kind, first, last in _boxes(file, *inner[b"ilst"]):
        (number,) = struct.unpack(">I", kind)
        data = _content(file, first, last)
        if 1 <= number <= len(names) and data[4:8] == b"data":
            value = _value(struct.unpack(">I", data[8:12])[0], data[16:])
            if value:
                yield names[number - 1], value


def _value(kind: int, data: bytes) -> str:
    """The value of an item as text: UTF-8, whole numbers and floating point numbers, big-endian."""
    if kind == 1:
        return _text(data)
    if kind in (21, 22, 65, 66, 67, 74, 75, 76, 77, 78) and len(data) <= 8:
        return str(int.from_bytes(data, "big", signed=kind in (21, 65, 66, 67, 74)))
    if kind in (23, 24) and len(data) == {23: 4, 24: 8}[kind]:
        return f"{struct.unpack('>f' if kind == 23 else '>d', data)[0]:g}"
    return ""


def _read_gopro(content: bytes, found: dict[str, str], depth: int) -> None:
    """Text of known names in GoPro's structure: name, type, size, count, and data up to a multiple of four bytes."""
    place = 0
    while place + 8 <= len(content):
        name, kind, size, count = struct.unpack(">4sBBH", content[place : place + 8])
        data = content[place + 8 : place + 8 + size * count]
        place += 8 + (size * count + 3) // 4 * 4
        if kind == _NEST and depth < _DEEPEST:
            _read_gopro(data, found, depth + 1)
        elif kind == _STRING and _text(name) in _GOPRO:
            found.setdefault(_text(name).lower(), _text(data))


def _content(file: BinaryIO, start: int, end: int) -> bytes:
    file.seek(start)
    return file.read(min(end - start, _LARGEST))


def _text(data: bytes) -> str:
    return data.decode("utf-8", errors="replace").split("\0", maxsplit=1)[0].strip()
