"""Results of programs of digital image correlation, which write a table a frame: DICe and OpenCorr."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.files import natural_key
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.tracks.record import ForeignTracks

__all__ = ["is_correlation", "read_correlation"]

_LEAST_ZNCC, _SURE_ZNCC = 0.6, 0.8
"""Correlations of OpenCorr below which a subset is lost, and below which it is doubtful [1]."""


@dataclass(frozen=True)
class _Form:
    """Columns of a program's tables.

    Parameters
    ----------
    place, moved
        Place in the reference frame and motion since, along u and v [px].
    quality
        Standard deviation of the motion [px], or correlation [1].
    """

    place: tuple[str, str]
    moved: tuple[str, str]
    quality: str


_FORMS = {
    "DICe": _Form(("coordinate_x", "coordinate_y"), ("displacement_x", "displacement_y"), "sigma"),
    "OpenCorr": _Form(("x", "y"), ("u", "v"), "zncc"),
}


def is_correlation(head: str) -> bool:
    """Whether a line is the head of a table of DICe or OpenCorr.

    Parameters
    ----------
    head
        The line.

    Examples
    --------
    >>> is_correlation("SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA")
    True
    """
    return _program(_columns(head)) is not None


def read_correlation(path: Path) -> ForeignTracks:
    """Tracks in the tables of DICe (``DICe_solution_*.txt``) or OpenCorr (``*.csv``), one a frame.

    Parameters
    ----------
    path
        Folder of the tables, which are taken in natural order, or a single table.

    Returns
    -------
    tracks
        Subsets with their places in the reference frame. Of DICe ``SIGMA`` is the standard deviation, and a negative
        one a failure; of OpenCorr a ``ZNCC`` below 0.6 is a failure, and below 0.8 a doubtful sample.

    Raises
    ------
    ResultsError
        There is no such table, one is missing between others, or they are not of one set of subsets.

    References
    ----------
    .. [1] Turner, D.Z. (2015). Digital Image Correlation Engine (DICe) Reference Manual. Sandia Report
       SAND2015-10606 O.
    .. [2] Jiang, Z. (2023). OpenCorr: An open source library for research and development of digital image correlation.
       Optics and Lasers in Engineering 165, 107566.
    """
    files = [path]
    if path.is_dir():
        inside = (one for one in path.iterdir() if one.suffix.lower() in (".txt", ".csv") and one.name[0] != ".")
        files = sorted(inside, key=natural_key)
    tables = [(file, found) for file in files if (found := _read(file)) is not None]
    if not tables:
        raise ResultsError(f"{path}: expected tables of DICe or OpenCorr, one a frame, got none; check the folder")
    program, first = tables[0][1]
    form = _FORMS[program]
    homes = _take(tables[0][0], first, form.place)
    for file, (other, table) in tables:
        if other != program or not np.array_equal(_take(file, table, form.place), homes):
            raise ResultsError(
                f"{file}: expected the same subsets as in {tables[0][0].name}, got others; put each run of the program "
                "into a folder of its own, with one reference frame"
            )
    _check_numbers(path, [file for file, _ in tables])
    moved = np.stack([_take(file, table, form.moved) for file, (_, table) in tables])
    quality = np.stack([_take(file, table, (form.quality,)) for file, (_, table) in tables])[..., 0]
    if program == "DICe":
        failed, doubtful = quality < 0, np.zeros(quality.shape, np.bool_)
        std = np.where(quality > 0, quality, np.nan)
    else:
        failed, doubtful = ~(quality >= _LEAST_ZNCC), quality < _SURE_ZNCC
        std = np.full_like(quality, np.nan)
    moved[failed] = np.nan
    return ForeignTracks(moved, np.repeat(std[..., None], 2, axis=-1), doubtful, homes=homes, program=program)


def _check_numbers(path: Path, files: Sequence[Path]) -> None:
    """Refuses a gap in the numbers of the files: all frames behind it would be taken for others.

    The number is the one that differs from file to file; of names without, or with several, nothing is known.
    """
    digits = [tuple(map(int, re.findall(r"\d+", file.stem))) for file in files]
    if len({len(one) for one in digits}) > 1:
        return
    differing = [column for column in zip(*digits, strict=True) if len({*column}) > 1]
    if len(differing) != 1:
        return
    steps = np.diff(differing[0])
    if (steps != steps[0]).any():
        at = int(np.argmax(steps != min(steps)))
        raise ResultsError(
            f"{path}: expected a table for every frame, got none between {files[at].name} and {files[at + 1].name}, or "
            "one that cannot be read; run the other program again"
        )


def _columns(head: str) -> list[str]:
    return [name.strip().lower() for name in next(csv.reader([head]), [])]


def _program(columns: Sequence[str]) -> str | None:
    for program, form in _FORMS.items():
        if {*form.place, *form.moved, form.quality} <= {*columns}:
            return program
    return None


def _read(file: Path) -> tuple[str, Mapping[str, FloatArray]] | None:
    """Program and columns of a table; ``None`` for another file, such as a list of settings or statistics."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ResultsError(f"{file}: expected a table of one frame, got: {error}; check the file") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("***")]
    columns = _columns(lines[0]) if lines else []
    program = _program(columns)
    if program is None:
        return None
    try:
        values = np.loadtxt(io.StringIO("\n".join(lines[1:])), delimiter=",", ndmin=2)
    except ValueError as error:
        raise ResultsError(f"{file}: expected numbers, got: {error}; check the file") from error
    if values.shape[1:] != (len(columns),) or not len(values):
        raise ResultsError(f"{file}: expected {len(columns)} columns, got a table {values.shape}; check the file")
    return program, dict(zip(columns, values.T, strict=True))


def _take(file: Path, table: Mapping[str, FloatArray], columns: Sequence[str]) -> FloatArray:
    """Columns of a table, shape (S, C)."""
    missing = [name for name in columns if name not in table]
    if missing:
        raise ResultsError(f"{file}: expected columns {', '.join(columns)}, got none of {missing}; write them")
    return np.column_stack([table[name] for name in columns])
