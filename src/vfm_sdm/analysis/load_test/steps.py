"""Steps of a load test: the load of each, when it stood, and what was calculated for it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.dialect import Table, read_table
from vfm_sdm.inputs.sensors.numbers import parse_numbers

__all__ = ["LoadPlan", "LoadStep", "check_units", "read_columns", "read_steps"]

_OWN = ("step", "load", "begin_s", "end_s")
_NAMES = {*_OWN, "passage", "speed"}
"""Names of columns, whose letters may be capitals."""
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")
_FEWEST = 2


@dataclass(frozen=True)
class LoadStep:
    """One step.

    Parameters
    ----------
    load
        The load, in the plan's unit; 0 is the structure as it stands.
    begin_s, end_s
        When it stood, on the clock of the displacement [s]; ``None`` where that is to be found.
    calculated_mm
        Calculated displacement from the first step on, by point and axis [mm].
    """

    load: float
    begin_s: float | None
    end_s: float | None
    calculated_mm: Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class LoadPlan:
    """All steps in the order in which they were made.

    Parameters
    ----------
    steps
        At least two; the first is what all others are compared with.
    unit
        Unit of the loads, as the file has it.
    """

    steps: tuple[LoadStep, ...]
    unit: str

    @property
    def timed(self) -> bool:
        """Whether it is known when each step stood."""
        return all(step.begin_s is not None for step in self.steps)


def read_steps(path: Path | str) -> LoadPlan:
    r"""Steps of a load test from a table: a row a step, in the order in which they were made.

    Parameters
    ----------
    path
        Text file with a column ``load [UNIT]``; with ``begin_s`` and ``end_s``, unless stillness is to be found; and
        with a column ``POINT AXIS [mm]`` of each calculated displacement, empty (``-``) where nothing was calculated.

    Raises
    ------
    DatasetError
        The file is no such table, a unit is another one, fewer than two steps are in it, or their times overlap.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "steps.csv")
    ...     _ = file.write_text("load [kN],begin_s,end_s,mid vertical [mm]\n0,0,20,0\n300,40,70,-2.5\n")
    ...     plan = read_steps(file)
    >>> plan.unit, plan.steps[1].load, plan.steps[1].calculated_mm
    ('kN', 300.0, {('mid', 'vertical'): -2.5})
    """
    columns = read_columns(path)
    if "load" not in columns:
        raise DatasetError(f"{path}: expected a column load, got {', '.join(columns)}; name the loads' column so")
    if ("begin_s" in columns) != ("end_s" in columns):
        raise DatasetError(f"{path}: expected both begin_s and end_s, or none of them, got one; add the other one")
    load, unit = columns["load"]
    check_units(path, columns, {"begin_s": "s", "end_s": "s"})
    begin, end = (columns[name][0] if name in columns else None for name in ("begin_s", "end_s"))
    calculated = {}
    for name, (values, _) in columns.items():
        if name in _OWN:
            continue
        check_units(path, columns, {name: "mm"})
        key = _point_and_axis(path, name)
        if key in calculated:
            raise DatasetError(f"{path}: expected each column once, got several {' '.join(key)}; keep one of them")
        calculated[key] = values
    _check(path, load, begin, end)
    steps = tuple(
        LoadStep(
            load[i],
            None if begin is None else begin[i],
            None if end is None else end[i],
            {key: values[i] for key, values in calculated.items() if np.isfinite(values[i])},
        )
        for i in range(len(load))
    )
    return LoadPlan(steps, unit)


def read_columns(path: Path | str) -> dict[str, tuple[list[float], str]]:
    """Numbers and unit of every column of a table by its name without the unit; the table's own names in small letters.

    Parameters
    ----------
    path
        Text file in any usual dialect; ``-`` is no number.

    Raises
    ------
    DatasetError
        The file is no table of numbers, or has a column twice.
    """
    table = read_table(path, fewest=1)
    columns: dict[str, tuple[list[float], str]] = {}
    for number, heading in enumerate(table.names):
        found = _UNIT.match(heading)
        name = (heading if found is None else found["name"]).strip()
        name = name.casefold() if name.casefold() in _NAMES else name
        if name in columns:
            raise DatasetError(f"{path}: expected each column once, got several {name}; keep one of them")
        columns[name] = _numbers(table, number), "" if found is None else found["unit"].strip()
    return columns


def check_units(path: Path | str, columns: Mapping[str, tuple[list[float], str]], units: Mapping[str, str]) -> None:
    """Refuses columns in another unit than theirs; one that states none has its own.

    Parameters
    ----------
    path
        The file.
    columns
        Of `read_columns`.
    units
        Unit of each column that must be in one.

    Raises
    ------
    DatasetError
        A column is in another unit.
    """
    for name, unit in units.items():
        if name in columns and columns[name][1] not in ("", unit):
            raise DatasetError(
                f"{path}: expected {name} in {unit}, got {columns[name][1]}; convert the column, and write {name} "
                f"[{unit}]"
            )


def _numbers(table: Table, column: int) -> list[float]:
    values, wrong = parse_numbers([row[column] for row in table.rows], table.decimal)
    if wrong is not None:
        raise DatasetError(
            f"{table.path}: expected numbers below {table.names[column]!r}, got {table.rows[wrong][column]!r} in line "
            f"{table.lines[wrong]}; correct it"
        )
    return [float(value) for value in values]


def _point_and_axis(path: Path | str, name: str) -> tuple[str, str]:
    point, _, axis = name.strip().rpartition(" ")
    if not point or axis.casefold() not in STRUCTURE_AXES:
        raise DatasetError(
            f"{path}: expected columns load, begin_s, end_s and POINT AXIS [mm], got {name!r}; name a point and one of "
            f"{', '.join(STRUCTURE_AXES)}"
        )
    return point, axis.casefold()


def _check(path: Path | str, load: list[float], begin: list[float] | None, end: list[float] | None) -> None:
    if len(load) < _FEWEST:
        raise DatasetError(f"{path}: expected at least {_FEWEST} steps, got {len(load)}; begin with the unloaded one")
    if not np.isfinite(load).all():
        row = int(np.flatnonzero(~np.isfinite(load))[0]) + 1
        raise DatasetError(f"{path}: expected the load of every step, got none in row {row}; fill it in")
    if begin is None or end is None:
        return
    edges = np.column_stack([begin, end]).ravel()
    if not (np.isfinite(edges).all() and (np.diff(edges) >= 0).all() and (np.subtract(end, begin) > 0).all()):
        raise DatasetError(
            f"{path}: expected steps one after the other, each ending after it begins, got begin_s {begin} and end_s "
            f"{end}; correct the times"
        )
