"""Tracks as a table, a row a point and frame."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vfm_sdm.core.datasets import STATUS_MEANINGS, Status
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.tracks.record import ForeignTracks, whole_frames

__all__ = ["is_table", "read_table"]

_NEEDED = ("point", "u", "v")


def is_table(head: str) -> bool:
    """Whether a first line is that of such a table.

    Parameters
    ----------
    head
        First line of a file.

    Examples
    --------
    >>> is_table("frame,point,u,v,std_u,std_v")
    True
    """
    return {*_NEEDED} <= {*_split(head)}


def read_table(path: Path) -> ForeignTracks:
    """Tracks in a CSV file of one view.

    Parameters
    ----------
    path
        The file: columns ``frame`` (from 0) or ``time_s``, ``point``, ``u`` and ``v`` [px]; where known ``std``, or
        ``std_u`` and ``std_v`` [px], and ``status`` in this package's words. Empty cells are missing values.

    Raises
    ------
    ResultsError
        A column is missing, or there twice; a row has other cells than the head, a value is no number, or a point has
        two rows for one frame.
    """
    with path.open(encoding="utf-8-sig", newline="") as stream:
        lines = [line for line in stream if line.strip() and not line.startswith("#")]
    columns = _split(lines[0])
    rows = _rows(path, columns, lines[1:])
    clock = next((name for name in ("frame", "time_s") if name in columns), None)
    if clock is None or not rows:
        raise ResultsError(
            f"{path}: expected rows with a column frame or time_s, got columns {columns} and {len(rows)} rows; add it"
        )
    stds = next((pair for pair in (("std_u", "std_v"), ("std", "std")) if {*pair} <= {*columns}), None)
    names = tuple(dict.fromkeys(row["point"] for row in rows))
    values = np.array([_numbers(path, number, row, (clock, "u", "v")) for number, row in enumerate(rows, start=2)])
    times, at = np.unique(values[:, 0], return_inverse=True)
    place = at, np.array([names.index(row["point"]) for row in rows])
    if len({*zip(*(one.tolist() for one in place), strict=True)}) < len(rows):
        raise ResultsError(f"{path}: expected one row a point and frame, got several; remove what is there twice")
    shape = len(times), len(names)
    position, std, doubtful = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan), np.zeros(shape, np.bool_)
    position[place] = values[:, 1:]
    if stds is not None:
        std[place] = [_numbers(path, number, row, stds) for number, row in enumerate(rows, start=2)]
    if "status" in columns:
        codes = np.array([_status(path, row["status"]) for row in rows])
        doubtful[place] = codes == Status.UNRELIABLE
        position[place[0][codes % Status.UNRELIABLE > 0], place[1][codes % Status.UNRELIABLE > 0]] = np.nan
    if clock == "time_s":
        return ForeignTracks(position, std, doubtful, names, time_s=times)
    return ForeignTracks(position, std, doubtful, names, frames=whole_frames(path, times))


def _rows(path: Path, columns: Sequence[str], lines: Sequence[str]) -> list[dict[str, str]]:
    """Cells of each row by column. Other cells than columns are decimal commas, or a quote that is not closed."""
    if len({*columns}) < len(columns):
        raise ResultsError(f"{path}: expected each column once, got {', '.join(columns)}; rename what is there twice")
    rows = []
    try:
        for number, cells in enumerate(csv.reader(lines, strict=True), start=2):
            if len(cells) != len(columns):
                raise ResultsError(
                    f"{path}, row {number}: expected {len(columns)} cells as in the head, got {len(cells)}; write "
                    "decimal points, and quotes around names with commas"
                )
            rows.append(dict(zip(columns, map(str.strip, cells), strict=True)))
    except csv.Error as error:
        raise ResultsError(f"{path}: expected a table, got: {error}; look for a quote that is not closed") from error
    return rows


def _split(head: str) -> list[str]:
    return [name.strip().lower() for name in next(csv.reader([head]), [])]


def _numbers(path: Path, number: int, row: dict[str, str], columns: Sequence[str]) -> list[float]:
    try:
        return [float(row[name] or "nan") for name in columns]
    except ValueError as error:
        raise ResultsError(f"{path}, row {number}: expected numbers in {', '.join(columns)}, got: {error}") from error


def _status(path: Path, word: str) -> int:
    if word not in STATUS_MEANINGS:
        raise ResultsError(f"{path}: expected a status of {', '.join(STATUS_MEANINGS)}, got {word!r}; correct it")
    return STATUS_MEANINGS.index(word)
