"""Whether a file is as long as its own structure says."""

from pathlib import Path
from typing import BinaryIO

__all__ = ["missing_bytes"]

_BOXES = frozenset(b"ftyp styp moov moof mdat mfra sidx free skip wide uuid meta udta pdin prft emsg".split())
_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"


def missing_bytes(path: Path) -> int:
    """Number of bytes by which a file is shorter than its outermost boxes claim; 0 where they make no claim.

    Parameters
    ----------
    path
        A container file. MP4 and MOV (boxes, ISO/IEC 14496-12) and Matroska (EBML, RFC 8794) are understood.

    Notes
    -----
    FFmpeg ends such a file in silence at the last whole packet, and Matroska does not say how many frames there
    should be, so the length is the only exact sign.

    Examples
    --------
    >>> from tempfile import NamedTemporaryFile
    >>> with NamedTemporaryFile(suffix=".mp4") as file:
    ...     box = (100).to_bytes(4, "big") + b"ftyp" + bytes(60)
    ...     _ = file.write(box), file.flush()
    ...     print(missing_bytes(Path(file.name)))
    32
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        end = _matroska_end(file) if head[:4] == _EBML else _boxes_end(file, size) if head[4:8] == b"ftyp" else None
    return 0 if end is None else max(0, end - size)


def _boxes_end(file: BinaryIO, size: int) -> int:
    position = 0
    while position < size:
        file.seek(position)
        header = file.read(16)
        length = int.from_bytes(header[:4], "big")
        if length == 1:
            length = int.from_bytes(header[8:16], "big")
        if length < 8 or header[4:8] not in _BOXES:
            # 0 means "to the end of the file"; what is no box makes no claim.
            return size
        position += length
    return position


def _matroska_end(file: BinaryIO) -> int | None:
    position = 0
    for identifier in (_EBML, _SEGMENT):
        file.seek(position)
        header = file.read(12)
        if header[:4] != identifier or len(header) < 5 or header[4] == 0:
            return None
        # A length of n bytes starts with n - 1 zero bits and a one; all further bits set means "unknown".
        count = 9 - header[4].bit_length()
        value = int.from_bytes(header[4 : 4 + count], "big") & ((1 << 7 * count) - 1)
        if value == (1 << 7 * count) - 1:
            return None
        position += 4 + count + value
    return position
