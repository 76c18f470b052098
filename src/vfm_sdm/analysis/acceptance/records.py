"""Records of an acceptance test, its file beside the run, and the run that is tested."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.files import write_json
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.run_folder import SESSION, RunFolder
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import Session, read_session

__all__ = ["Acceptance", "AcceptanceRow", "AcceptedRun", "as_number", "check_limit", "read_rows", "read_run"]
__all__ += ["write_acceptance"]


@dataclass(frozen=True)
class AcceptanceRow:
    """One figure beside its limit.

    Parameters
    ----------
    subject
        What it is a figure of: a point and axis, a pair of points.
    quantity
        Name of the figure.
    value, limit
        The figure, and the largest amount that is accepted; NaN where one of them is not known.
    units
        Units of both.
    """

    subject: str
    quantity: str
    value: float
    limit: float
    units: str

    @property
    def outcome(self) -> Outcome:
        """Whether the amount of the figure is within its limit."""
        if not (np.isfinite(self.value) and np.isfinite(self.limit)):
            return Outcome.NOT_POSSIBLE
        return Outcome.PASS if abs(self.value) <= self.limit else Outcome.FAIL


@dataclass(frozen=True, eq=False)
class Acceptance:
    """Result of an acceptance test.

    Parameters
    ----------
    name
        Name of the test, as the command line has it.
    limits
        Where the limits come from, a sentence.
    rows
        Figures and limits.
    notes
        Sentences that a reader must know.
    details
        Further figures for the file: tables, lists and numbers.
    """

    name: str
    limits: str
    rows: tuple[AcceptanceRow, ...]
    notes: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def outcome(self) -> Outcome:
        """Fail where one figure fails, not possible where none could be judged."""
        found = {row.outcome for row in self.rows}
        if Outcome.FAIL in found:
            return Outcome.FAIL
        return Outcome.PASS if Outcome.PASS in found else Outcome.NOT_POSSIBLE


@dataclass(frozen=True, eq=False)
class AcceptedRun:
    """A run folder whose displacement is tested.

    Parameters
    ----------
    folder
        The run folder.
    displacement
        Its displacement, shape (T, P, 3) [mm].
    session
        Its session; ``None`` where the folder holds none.
    notes
        What a reader of the result must know.
    """

    folder: Path
    displacement: xr.Dataset
    session: Session | None
    notes: tuple[str, ...] = ()

    @property
    def moving(self) -> list[str]:
        """Names of the points that may move."""
        static = {point.name for point in self.session.point if point.static} if self.session is not None else set()
        return [str(name) for name in self.displacement["point"].values if str(name) not in static]


def read_run(folder: Path | str) -> AcceptedRun:
    """The run in a folder, whole and of one session.

    Parameters
    ----------
    folder
        Run folder with ``displacement.nc``.

    Raises
    ------
    ResultsError, SessionError
        A file is missing, damaged, or of another run.
    """
    path = Path(folder)
    displacement = read_displacement(path)
    session = read_session(path / SESSION, check_files=False) if (path / SESSION).is_file() else None
    notes = RunFolder(path).check_whole("displacement", displacement.attrs)
    return AcceptedRun(path, displacement, session, notes)


def write_acceptance(run: AcceptedRun, result: Acceptance) -> Path:
    """Writes ``acceptance_NAME.json`` beside the run, with null for what is not known; returns its path.

    Parameters
    ----------
    run
        The run that was tested; the key of its displacement is written along.
    result
        Figures in the units that they state.

    Raises
    ------
    ResultsError
        The file cannot be written.
    """
    content = {
        "test": result.name,
        "outcome": result.outcome,
        "limits": result.limits,
        "displacement_key": run.displacement.attrs.get("key"),
        "rows": [{**asdict(row), "outcome": row.outcome} for row in result.rows],
        "notes": [*run.notes, *result.notes],
        **result.details,
    }
    return write_json(run.folder / f"acceptance_{result.name}.json", content, label=f"acceptance {result.name}")


def check_limit(value: float | None, name: str, *, positive: bool = True) -> None:
    """Refuses a limit that no figure could be compared with.

    Parameters
    ----------
    value
        The limit, in any units; ``None`` where none was stated.
    name
        Its name, for the message.
    positive
        Whether it must be above zero, or may be zero.

    Raises
    ------
    DatasetError
        It is not a positive number.
    """
    if value is not None and not (np.isfinite(value) and (value > 0 if positive else value >= 0)):
        raise DatasetError(f"{name}: expected a positive number, got {value}; correct the limit")


def read_rows(path: Path | str, required: Sequence[str]) -> list[dict[str, str]]:
    """Rows of a CSV file with a line of names, by these names.

    Parameters
    ----------
    path
        File in UTF-8, with commas, semicolons or tabulators between cells.
    required
        Names of columns that must be there.

    Raises
    ------
    DatasetError
        The file cannot be read, lacks a column, or a row has another number of cells.
    """
    source = Path(path)
    try:
        text = source.read_bytes().decode("utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DatasetError(f"{source}: expected a CSV file in UTF-8, got: {reason}; check the path") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    separator = next((mark for mark in "\t;" if lines and mark in lines[0]), ",")
    try:
        table = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    except csv.Error as error:
        raise DatasetError(f"{source}: expected a CSV file, got: {error}; export it again") from error
    names = table[0] if table else []
    missing = [name for name in required if name not in names]
    if missing or len(table) < 2 or len(set(names)) < len(names):
        got = f"{names}" + ("" if len(table) > 1 else " and no row below")
        raise DatasetError(
            f"{source}: expected columns {list(required)}, each name once, and rows below, got {got}; correct the file"
        )
    for number, row in enumerate(table[1:], start=1):
        if len(row) != len(names):
            raise DatasetError(
                f"{source}: expected {len(names)} cells in row {number} below the names, got {len(row)}; correct it"
            )
    return [dict(zip(names, row, strict=True)) for row in table[1:]]


def as_number(source: Path | str, row: Mapping[str, str], name: str) -> float:
    """The number in a cell, with a point or comma as decimal mark.

    Parameters
    ----------
    source
        The file, for the message.
    row
        A row of `read_rows`.
    name
        Name of the column.

    Raises
    ------
    DatasetError
        The cell holds no finite number.
    """
    text = row[name]
    try:
        value = float(text.replace(",", ".", 1))
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise DatasetError(f"{source}: expected a number in column {name!r}, got {text!r}; correct the cell")
    return value
