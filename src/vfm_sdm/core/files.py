"""Files that are either whole or absent: atomic writing, JSON, and hashes that identify a file's content."""

import csv
import hashlib
import io
import json
import math
import re
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from vfm_sdm.errors import ResultsError

__all__ = [
    "csv_text",
    "distinct_stem",
    "file_fingerprint",
    "file_hash",
    "file_stem",
    "match_files",
    "natural_key",
    "number_cell",
    "remove_orphans",
    "replace_file",
    "write_file",
    "write_json",
]

_BLOCK_BYTES = 1 << 20
_WHOLE_BYTES = 16 << 20
"""Files up to this size are always read whole."""
_SAMPLES, _SAMPLE_BYTES = 64, 64 << 10
_STEM_BYTES = 120
_TEMPORARY = re.compile(r"\..+-[0-9a-f]{8}(\.\w+)?")
"""Names that `replace_file` gives to what it has not finished."""


@contextmanager
def replace_file(path: Path | str) -> Iterator[Path]:
    """A temporary path to write to; it takes the name ``path`` only when the block ends without an error.

    A failed write leaves an earlier file as it was and nothing half-written beside it.

    Parameters
    ----------
    path
        The file to make or replace; its folder is made when absent.

    Raises
    ------
    OSError
        The folder cannot be made or written to.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with replace_file(f"{folder}/notes.txt") as temporary:
    ...         _ = temporary.write_text("whole")
    ...     print([path.name for path in Path(folder).iterdir()])
    ['notes.txt']
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    # In the same folder, because a rename is atomic only within one file system; with the same suffix, because some
    # writers choose the format by it or append it when it is missing.
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(4)}{target.suffix}")
    try:
        yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_file(path: Path | str, content: bytes | memoryview | str) -> Path:
    """Writes a file that is complete in memory, whole or not at all; returns its path.

    Libraries that write by themselves may end the process where a disk is full; they write to memory, and this writes
    the file.

    Parameters
    ----------
    path
        The file to make or replace; its folder is made when absent.
    content
        All of it; text is encoded as UTF-8.

    Raises
    ------
    ResultsError
        The file cannot be written; an earlier one is as it was.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     print(write_file(f"{folder}/notes.txt", "whole").read_text())
    whole
    """
    target = Path(path)
    try:
        with replace_file(target) as temporary:
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL
        reason = getattr(error, "strerror", None) or error
        raise ResultsError(
            f"{target}: expected to write it, got: {reason}; choose another folder, or free space"
        ) from error
    return target


def match_files(pattern: Path | str) -> list[Path]:
    """Files that match a pattern, of which the folders and names that are there stand for themselves.

    Parameters
    ----------
    pattern
        Path with ``*``, ``?``, ``[...]`` and, for folders of any depth, ``**``.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     Path(folder, "visit [2]").mkdir()
    ...     Path(folder, "visit [2]", "a.toml").touch()
    ...     print([path.name for path in match_files(f"{folder}/visit [2]/*.toml")])
    ['a.toml']
    """
    parts = Path(pattern).parts
    folder = Path()
    # The name of a folder may hold brackets.
    while parts and (folder / parts[0]).exists():
        folder, parts = folder / parts[0], parts[1:]
    matches = folder.glob(str(Path(*parts))) if parts else [folder]
    return [path for path in matches if path.is_file()]


def remove_orphans(folder: Path | str) -> list[str]:
    """Removes what killed processes left half-written in a folder; the names that were removed.

    Parameters
    ----------
    folder
        A folder into which nobody writes now; its subfolders are not looked at.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, ".tracks-01234567.nc").write_bytes(b"half")
    ...     print(remove_orphans(folder))
    ['.tracks-01234567.nc']
    """
    orphans = [path for path in sorted(Path(folder).glob(".*")) if _TEMPORARY.fullmatch(path.name) and path.is_file()]
    for path in orphans:
        path.unlink(missing_ok=True)
    return [path.name for path in orphans]


def file_hash(path: Path | str) -> str:
    """SHA-256 of a file's content as 64 hexadecimal digits, read in blocks.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "empty").touch()
    ...     print(file_hash(Path(folder, "empty"))[:8])
    e3b0c442
    """
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def file_fingerprint(path: Path | str, *, whole: bool = False) -> str:
    """Text that identifies a file's content, found in a time that does not grow with the file's size.

    Parameters
    ----------
    path
        The file.
    whole
        Whether to read the whole file.

    Returns
    -------
    fingerprint
        The `file_hash` of files up to 16 MiB and where ``whole`` is asked for; else ``sampled-`` and the SHA-256 of
        size, time of the last change, and 64 blocks of 64 KiB from the first to the last.

    Raises
    ------
    OSError
        The file cannot be read.

    Notes
    -----
    A change that keeps the size of a large file, falls between the blocks and hides its time stamp is not seen; ask for
    the whole content where somebody might do that.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "empty").touch()
    ...     print(file_fingerprint(Path(folder, "empty"))[:8])
    e3b0c442
    """
    place = Path(path)
    status = place.stat()
    if whole or status.st_size <= _WHOLE_BYTES:
        return file_hash(place)
    digest = hashlib.sha256(f"{status.st_size} {status.st_mtime_ns}".encode())
    with place.open("rb") as stream:
        for number in range(_SAMPLES):
            stream.seek((status.st_size - _SAMPLE_BYTES) * number // (_SAMPLES - 1))
            digest.update(stream.read(_SAMPLE_BYTES))
    return f"sampled-{digest.hexdigest()}"


def number_cell(value: float) -> str:
    """A number as a cell of `csv_text`, to six digits; nothing where it is not finite.

    Parameters
    ----------
    value
        The number, in any unit.

    Examples
    --------
    >>> number_cell(1 / 3), number_cell(float("nan"))
    ('0.333333', '')
    """
    return f"{value:.6g}" if math.isfinite(value) else ""


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table as comma-separated values, a line a row.

    Parameters
    ----------
    header
        Names of the columns.
    rows
        Cells of each row, as they are to be written.

    Examples
    --------
    >>> csv_text(["point", "u, v"], [["mid", 0.5]]).splitlines()
    ['point,"u, v"', 'mid,0.5']
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def write_json(path: Path, content: Mapping[str, Any], *, label: str) -> Path:
    """Writes a table as JSON, whole or not at all, with null for numbers that are not finite; returns the path.

    Parameters
    ----------
    path
        The file to make or replace.
    content
        Tables and lists of text, numbers, truth values, NumPy scalars and arrays, paths and ``None``.
    label
        Name of the table in messages.

    Raises
    ------
    ResultsError
        The file cannot be written, or a value is of another type.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = write_json(Path(folder, "table.json"), {"gain": np.float64("nan")}, label="table")
    ...     print(path.read_text())
    {
      "gain": null
    }
    """
    text = json.dumps(_convert_for_json(content, label), indent=2, ensure_ascii=False, allow_nan=False)
    return write_file(path, text + "\n")


def _convert_for_json(value: Any, label: str) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _convert_for_json(inner, f"{label}.{key}") for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_convert_for_json(inner, f"{label}[{index}]") for index, inner in enumerate(value)]
    if isinstance(value, np.ndarray | np.generic):
        return _convert_for_json(value.tolist(), label)
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Path):
        return value.as_posix()
    raise ResultsError(f"{label}: expected text, numbers, lists or tables, got {type(value).__name__}; convert it")


def file_stem(name: str) -> str:
    """A name as part of a file name.

    Parameters
    ----------
    name
        Name of a view or a point.

    Examples
    --------
    >>> file_stem("1/2 span")
    '1-2_span'
    """
    stem = re.sub(r"[^\w.+-]", "-", re.sub(r"\s+", "_", name.strip()))
    short = stem.encode()[:_STEM_BYTES].decode(errors="ignore")  # file systems allow 255 bytes, with all around it
    return short.strip(".") or "unnamed"


def distinct_stem(stem: str, taken: set[str]) -> str:
    """A file name's stem that no other has: two names may become one, at the latest where file systems ignore case.

    Parameters
    ----------
    stem
        The wanted stem.
    taken
        Stems that are taken, without case; the new one is added.

    Examples
    --------
    >>> taken = set()
    >>> [distinct_stem(stem, taken) for stem in ("left", "Left")]
    ['left', 'Left_2']
    """
    unique, number = stem, 2
    while unique.casefold() in taken:
        unique, number = f"{stem}_{number}", number + 1
    taken.add(unique.casefold())
    return unique


def natural_key(path: Path) -> tuple[list[tuple[int, str]], str]:
    """What files are sorted by so that numbers in their names count by value, and stand before text.

    Parameters
    ----------
    path
        The file.

    Examples
    --------
    >>> [one.name for one in sorted([Path("10.png"), Path("9.png")], key=natural_key)]
    ['9.png', '10.png']
    """
    # The name itself decides between 1 and 01.
    pieces = [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", str(path)) if p]
    return pieces, str(path)
