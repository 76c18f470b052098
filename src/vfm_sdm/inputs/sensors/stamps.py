"""Time stamps as instruments write them: seconds or parts of them, dates, times of day, Unix and Excel time."""

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.dialect import Table
from vfm_sdm.inputs.sensors.numbers import is_clock_time, parse_numbers
from vfm_sdm.inputs.sensors.units import TIME_UNITS

__all__ = ["Stamps", "find_time_column", "read_stamps"]

_NAMES = (
    "time",
    "timestamp",
    "time stamp",
    "time_stamp",
    "elapsed time",
    "elapsed",
    "seconds_elapsed",
    "datetime",
    "date time",
    "date/time",
    "date & time",
    "date and time",
    "t",
    "seconds",
    "milliseconds",
    "zeit",
    "temps",
    "tiempo",
    "tempo",
)
_TIME_OF_DAY = re.compile(
    r"(?P<a>\d{1,2}):(?P<b>\d{2})(?::(?P<c>\d{2}))?(?P<rest>[.,:]\d+)?\s*(?P<half>[AaPp])?\.?(?:[Mm]\.?)?"
    r"\s*(?:Z|UTC|GMT|[+-]\d{2}:?\d{2})?$"
)
_DAY_S = 86400.0
_UNIX_S = (0.5e9, 4.2e9)
"""Seconds since 1970 of the years 1985 to 2103."""
_EXCEL_DAYS = (29221.0, 73415.0)
"""Days since 1900 of the years 1980 to 2100."""
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 3e3
"""Outside, numbers without a unit are no seconds for sure: nobody records a vibration so slowly, and faster than the
second, they could be minutes of a sensor of 50 Hz."""
_AGREE = 2e-3
_SPAN = 64
"""Samples over which a step is averaged."""


@dataclass(frozen=True, eq=False)
class Stamps:
    """Time stamps of a file's rows.

    Parameters
    ----------
    time_s
        Stamps, shape (T,) [s]; from the first on where they are of a calendar or a time of day.
    first
        The first cell where it is such a stamp; ``None`` where the stamps are seconds on the sensor's own clock.
    start
        When the first sample was taken, where the stamps say it with their offset from UTC.
    notes
        What was assumed, a sentence each.
    """

    time_s: FloatArray
    first: str | None = None
    start: datetime | None = None
    notes: tuple[str, ...] = ()


def find_time_column(table: Table) -> int | None:
    """Place of the column of time stamps that its name gives away; ``None`` where there is none.

    Examples
    --------
    >>> from pathlib import Path
    >>> find_time_column(Table(Path("a.csv"), ("ax (g)", "Time (s)"), ("g", "s"), [["1", "0"]], [2], "."))
    1
    """
    names = table.bare_names()
    return next((names.index(name) for name in _NAMES if name in names), None)


def read_stamps(table: Table, column: int, *, units: str | None = None, rate_hz: float | None = None) -> Stamps:
    """Time stamps of a column [s].

    Parameters
    ----------
    table
        The file.
    column
        Place of the column.
    units
        Unit of its numbers, one of `TIME_UNITS`; when left out, what the numbers themselves or the sampling rate show.
    rate_hz
        Samples a second, where they are known [Hz].

    Raises
    ------
    DatasetError
        A cell holds no time; the unit is none of time, or cannot be told.

    Notes
    -----
    Numbers without a unit count as seconds if they then are between one and three thousand samples a second.
    Unix time in parts of a second and days since 1900 are known by their size. Other numbers could be anything, and the
    unit is asked for.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = [["1778746951000"], ["1778746951005"], ["1778746951010"]]
    >>> stamps = read_stamps(Table(Path("a.csv"), ("time",), (None,), rows, [2, 3, 4], "."), 0)
    >>> stamps.time_s.tolist(), str(stamps.start)
    ([0.0, 0.005, 0.01], '2026-05-14 08:22:31+00:00')
    """
    cells = [row[column] for row in table.rows]
    if units is not None and units not in TIME_UNITS:
        raise DatasetError(
            f"{table.path}: expected column {table.names[column]!r} in one of {list(TIME_UNITS)}, got {units!r}; use "
            "one"
        )
    if is_clock_time(cells[0]):
        return _read_calendar(table, column, cells)
    values, wrong = parse_numbers(cells, table.decimal)
    if wrong is None and not np.isfinite(values).all():
        wrong = int(np.flatnonzero(~np.isfinite(values))[0])
    if wrong is not None:
        raise DatasetError(
            f"{table.path}: expected a number in row {table.lines[wrong]}, column {table.names[column]!r}, got "
            f"{cells[wrong]!r}; correct it"
        )
    return _to_seconds(table, column, values, units=units, rate_hz=rate_hz)


def _to_seconds(table: Table, column: int, values: FloatArray, *, units: str | None, rate_hz: float | None) -> Stamps:
    """Numbers in seconds, by the unit that is stated, or that size or rate show."""
    step = _typical_step(values)
    if (of_calendar := _count_from_an_epoch(table.rows[0][column], values, units, step)) is not None:
        return of_calendar
    if units is not None or np.median(np.diff(values)) < 0:  # falling stamps are refused by whoever makes a clock
        return Stamps(values * TIME_UNITS[units or "s"])
    name = table.names[column]
    if rate_hz is not None and step > 0 and abs(step * rate_hz - 1) > _AGREE:
        factors = {f"in {n}": f for n, f in TIME_UNITS.items() if abs(step * f * rate_hz - 1) < _AGREE}
        if step == 1 and np.all(values == np.rint(values)):
            factors = {"as numbers of samples": 1 / rate_hz}
        for how, factor in factors.items():
            return Stamps(values * factor, notes=(f"{name!r} is read {how}: the stated {rate_hz:g} Hz say so",))
    if step > 0 and not _SLOWEST_HZ < 1 / step < _FASTEST_HZ and rate_hz is None:
        rates = {unit: 1 / (step * factor) for unit, factor in TIME_UNITS.items()}
        rates = {unit: rate for unit, rate in rates.items() if _SLOWEST_HZ * 10 <= rate <= _FASTEST_HZ}
        likely, meant = [f"{rate:.4g} Hz if in {unit}" for unit, rate in rates.items()], next(iter(rates), "ms")
        raise DatasetError(
            f"{table.path}: expected time in seconds, got numbers {step:.6g} apart in column {name!r}, which is "
            f"{1 / step:.4g} Hz ({', or '.join(likely) or 'in no unit a rate of vibrations'}); state the unit beside "
            f"its name, such as --column 'time={name} in {meant}', or, where they number the samples, give --rate"
        )
    return Stamps(values)


def _count_from_an_epoch(first: str, values: FloatArray, units: str | None, step: float) -> Stamps | None:
    """Unix time in seconds or parts of them, and days since 1900, which their size gives away."""
    size = abs(float(values[0]))
    for name in ("s", "ms", "us", "ns"):
        factor = TIME_UNITS[name]
        if units in (None, name) and _UNIX_S[0] < size * factor < _UNIX_S[1] and step * factor < 1 / _SLOWEST_HZ:
            start = datetime.fromtimestamp(float(values[0]) * factor, UTC)
            said = () if units else (f"time is read as Unix time in {name}, from {start.isoformat()} on",)
            return Stamps((values - values[0]) * factor, first, start, said)
    if units in (None, "d") and _EXCEL_DAYS[0] < size < _EXCEL_DAYS[1] and 0 < step < 1 / _SLOWEST_HZ / _DAY_S:
        said = () if units else ("time is read as days since 1900, as in spreadsheets",)
        return Stamps((values - values[0]) * _DAY_S, first, None, said)
    return None


def _typical_step(values: FloatArray) -> float:
    """Step between samples, whether stamps are rounded, come in bursts or have gaps: the median of means over some."""
    span = min(_SPAN, len(values) - 1)
    return abs(float(np.median(values[span:] - values[:-span]))) / span


def _read_calendar(table: Table, column: int, cells: list[str]) -> Stamps:
    """Dates with times of day, or the latter alone: seconds since the first, through midnight."""
    seconds = np.empty(len(cells))
    parts = "hms"
    for number, cell in enumerate(cells):
        found = _TIME_OF_DAY.search(cell)
        if found is None:
            raise DatasetError(
                f"{table.path}: expected a time of day in row {table.lines[number]}, column {table.names[column]!r}, "
                f"got {cell!r}; where date and time are two columns, name the second with --column time=NAME"
            )
        a, b, c = float(found["a"]), float(found["b"]), found["c"]
        rest = float("0." + found["rest"][1:]) if found["rest"] else 0.0
        if c is None and found["rest"]:
            parts = "ms"  # 02:31.5 are minutes and seconds, as stop watches write
        if found["half"]:
            a = a % 12 + (12 if found["half"] in "pP" else 0)
        seconds[number] = (60 * a + b if parts == "ms" else 3600 * a + 60 * b + float(c or 0)) + rest
    period = 3600.0 if parts == "ms" else _DAY_S
    fallen = np.diff(seconds) < -period / 2
    seconds[1:] += period * np.cumsum(fallen)
    start = _start_of(cells[0])
    notes = (f"time of day passes midnight {int(fallen.sum())} times",) if fallen.any() else ()
    return Stamps(seconds - seconds[0], cells[0], start, notes)


def _start_of(cell: str) -> datetime | None:
    """The moment that a stamp in ISO 8601 with an offset from UTC states."""
    try:
        moment = datetime.fromisoformat(cell.replace(",", "."))
    except ValueError:
        return None
    return moment if moment.tzinfo is not None and math.isfinite(moment.timestamp()) else None
