"""Recordings of reference sensors from CSV files: accelerometers, and displacement gauges (LVDT, laser).

The file may be of any usual dialect (`vfm_sdm.inputs.sensors.dialect`), its time of any usual kind
(`vfm_sdm.inputs.sensors.stamps`) and its stamps as far from even as `vfm_sdm.inputs.sensors.sensor_clock` can put right
without guessing. What had to be assumed is in the attribute ``notes``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STRUCTURE_AXES, convert_units
from vfm_sdm.core.sensor_datasets import (
    ACCELERATION_UNITS,
    SENSOR_UNITS,
    ReferenceFacts,
    make_acceleration,
    make_reference,
)
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.defects import find_defects
from vfm_sdm.inputs.sensors.dialect import Table, read_table
from vfm_sdm.inputs.sensors.numbers import parse_numbers
from vfm_sdm.inputs.sensors.readings import name_defects, reading_status
from vfm_sdm.inputs.sensors.sensor_clock import MOST_MISSING, EvenClock, find_even_clock
from vfm_sdm.inputs.sensors.stamps import Stamps, find_time_column, read_stamps
from vfm_sdm.inputs.sensors.units import find_units, split_name

__all__ = ["read_acceleration", "read_reference", "states_acceleration"]

_TIME, _NONE, _IN = "time", "none", " in "


@dataclass(frozen=True)
class _Column:
    """A column that is asked for.

    Parameters
    ----------
    index
        Its place in the file.
    sign
        Its sign along the axis.
    units
        Units stated beside its name, else those of the file's header.
    """

    index: int
    sign: float
    units: str | None


@dataclass(frozen=True, eq=False)
class _Recording:
    """A file's values (T, A) of its axes on an even clock, NaN or infinite where there is none, in its units."""

    clock: EvenClock
    stamps: Stamps | None
    axes: list[str]
    values: FloatArray
    units: str
    notes: list[str]


def read_acceleration(
    path: Path | str,
    *,
    sensor: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: str | None = None,
    sampling_rate_hz: float | None = None,
    start: datetime | None = None,
) -> xr.Dataset:
    r"""Acceleration dataset [m/s2] of one sensor's file.

    Parameters
    ----------
    path
        CSV file.
    sensor
        Name of the sensor; the name of the file without its suffix when left out.
    columns
        Column of the file for each of the A axes recorded, and for ``time`` if there is one; the name may leave out the
        units that the header states, and its case does not matter. A leading ``-`` reverses the sign, unless a column
        of just that name exists; `` in ms`` and the like behind it states its units; ``none`` for time leaves stamps
        out. Left out: those of ``lateral``, ``vertical`` and ``longitudinal`` that the file has, where it has all or no
        other columns, and the column of time where its name tells.
    units
        Units of the values, one of `vfm_sdm.core.sensor_datasets.ACCELERATION_UNITS`. Left out: those of the header,
        else g, which a note says.
    sampling_rate_hz
        Samples a second; needed without a time column, and must agree with one [Hz].
    start
        When the first sample was taken; becomes attribute ``start_utc``.

    Returns
    -------
    acceleration
        Acceleration dataset, shape (T, 1, A) [m/s2]; NaN where ``status`` (`vfm_sdm.core.statuses.ReadingStatus`) says
        ``missing``. ``notes`` say what was assumed or put right.

    Raises
    ------
    DatasetError
        The file cannot be read; a column is missing; a cell is no number, or more than a tenth are empty; units cannot
        be told or contradict each other; the clock is not even, or contradicts the sampling rate; ``start`` has no time
        zone.

    Notes
    -----
    Time stamps are usually rounded, so the dataset's clock is ``t0 + i / rate``, with the rate that the first and the
    last stamp give. Stamps of a calendar count from the first on, which ``first_stamp`` holds.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "midspan.csv")
    ...     _ = file.write_text("time,z\n0.00,0.5\n0.01,0.25\n0.02,0.0\n")
    ...     recorded = read_acceleration(file, columns={"vertical": "-z"})
    >>> recorded["acceleration"].values.ravel().round(3).tolist()
    [-4.903, -2.452, -0.0]
    """
    recording = _read_recording(path, columns, units, sampling_rate_hz)
    signal = convert_units(
        xr.DataArray(recording.values, dims=("time", "axis"), attrs={"units": recording.units}), "m/s2"
    )
    acceleration = make_acceleration(
        recording.clock.time_s,
        [_name_sensor(path, sensor)],
        recording.axes,
        np.where(np.isfinite(signal.values), signal.values, np.nan)[:, None],
        sampling_rate_hz=recording.clock.rate_hz,
        attrs=_make_attrs(path, start, recording),
    )
    return acceleration.assign(status=reading_status(find_defects(signal.values)[:, None]))


def read_reference(
    path: Path | str,
    *,
    sensor: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: str | None = None,
    sampling_rate_hz: float | None = None,
    start: datetime | None = None,
) -> xr.Dataset:
    r"""Reference dataset [mm] of a displacement sensor's file, as it was recorded.

    Parameters
    ----------
    path
        CSV file.
    sensor
        Name of the sensor; the name of the file without its suffix when left out.
    columns
        Column of the file for each of the A axes recorded, and for ``time`` if there is one, as in `read_acceleration`.
    units
        Units of the values, a length. Left out: those of the header, else mm, which a note says.
    sampling_rate_hz
        Samples a second; needed without a time column, and must agree with one [Hz].
    start
        When the first sample was taken; becomes attribute ``start_utc``.

    Returns
    -------
    reference
        Reference dataset, shape (T, 1, A) [mm].

    Raises
    ------
    DatasetError
        As in `read_acceleration`.

    Notes
    -----
    A sample without a value, at the end of the gauge's range or stuck is NaN, and a note says so. Nothing is filtered:
    ``onset_s`` is the first sample, ``band_hz`` ends at half the sampling rate.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "gauge.csv")
    ...     _ = file.write_text("time,vertical\n0.0,1.5\n0.1,\n0.2,1.25\n")
    ...     print(read_reference(file)["displacement"].values.ravel().tolist())
    [1.5, nan, 1.25]
    """
    recording = _read_recording(path, columns, units, sampling_rate_hz, default="mm")
    signal = convert_units(
        xr.DataArray(recording.values, dims=("time", "axis"), attrs={"units": recording.units}), "mm"
    )
    clock, name = recording.clock, _name_sensor(path, sensor)
    status = find_defects(signal.values)
    recording.notes.extend(name_defects(status[:, None], clock.time_s, [name], recording.axes))
    return make_reference(
        clock.time_s,
        [name],
        recording.axes,
        np.where(status == 0, signal.values, np.nan)[:, None],
        facts=ReferenceFacts(clock.rate_hz, float(clock.time_s[0]), (0.0, clock.rate_hz / 2)),
        attrs=_make_attrs(path, start, recording),
    )


def states_acceleration(path: Path | str, columns: Mapping[str, str] | None = None) -> bool | None:
    """Whether a file's own words say that it holds acceleration; ``None`` where they state no units.

    Parameters
    ----------
    path
        CSV file.
    columns
        Columns that count, as in `read_acceleration`.

    Raises
    ------
    DatasetError
        The file cannot be read, or a column is missing.
    """
    wanted, _ = _find_axes(read_table(path), columns)
    units = {column.units for column in wanted.values() if column.units in SENSOR_UNITS}
    return bool(units & {*ACCELERATION_UNITS}) if units else None


def _read_recording(
    path: Path | str,
    columns: Mapping[str, str] | None,
    units: str | None,
    rate_hz: float | None,
    *,
    default: str = "g",
) -> _Recording:
    """The file as it is described, and as it describes itself."""
    table = read_table(path)
    wanted, time = _find_axes(table, columns)
    most = MOST_MISSING if default in ACCELERATION_UNITS else 1.0
    raw = np.column_stack([column.sign * _parse_column(table, column.index, most) for column in wanted.values()])
    units, notes = _find_units(table, list(wanted.values()), units, default)
    stamps = None if time is None else read_stamps(table, time.index, units=time.units, rate_hz=rate_hz)
    clock = find_even_clock(table, None if stamps is None else stamps.time_s, raw, sampling_rate_hz=rate_hz)
    notes = [*table.notes, *notes, *(() if stamps is None else stamps.notes), *clock.notes]
    return _Recording(clock, stamps, list(wanted), clock.put(raw), units, notes)


def _find_axes(table: Table, columns: Mapping[str, str] | None) -> tuple[dict[str, _Column], _Column | None]:
    """The column of each axis, and that of time."""
    bare = table.bare_names()
    place = find_time_column(table)
    time = None if place is None else _Column(place, 1.0, table.units[place])
    if columns is None:
        columns = {axis: axis for axis in STRUCTURE_AXES if axis in bare}
        others = [name for n, name in enumerate(table.names) if bare[n] not in STRUCTURE_AXES and n != place]
        if not columns or (others and len(columns) < len(STRUCTURE_AXES)):
            missing = next(axis for axis in STRUCTURE_AXES if axis not in columns)
            such = [f"--column {axis}={axis!r}" for axis in columns] or [f"--column vertical={[*others, 'NAME'][0]!r}"]
            raise DatasetError(
                f"{table.path}: expected a column {missing!r}, got {list(table.names)}; name in columns which of them "
                f"is along which axis, such as {' '.join(such)}{''.join(f'; {note}' for note in table.notes)}"
            )
    unknown = sorted(set(columns) - {_TIME, *STRUCTURE_AXES})
    axes = [axis for axis in STRUCTURE_AXES if axis in columns]
    if unknown or not axes:
        raise DatasetError(
            f"{table.path}: expected columns for some of {list(STRUCTURE_AXES)}, and for time, got {sorted(columns)} "
            f"and a file with {list(table.names)}; name them"
        )
    if _TIME in columns:
        none = columns[_TIME] == _NONE and _NONE not in table.names
        time = None if none else _find_column(table, columns[_TIME])
    return {axis: _find_column(table, columns[axis]) for axis in axes}, time


def _find_column(table: Table, wanted: str) -> _Column:
    """A column by its name as written, or without units and in any case; a sign may be before it, units after it."""
    name, joined, units = wanted.rpartition(_IN)
    stated = find_units(units) if joined else None
    for text, own in ((wanted, None), (name, stated)) if stated else ((wanted, None),):
        for plain, sign in ((text, 1.0), (text[1:], -1.0)) if text.startswith("-") else ((text, 1.0),):
            index = _place_of(table, plain)
            if index is None:
                continue
            header = table.units[index]
            if own is not None and header is not None and own != header:
                raise DatasetError(
                    f"{table.path}: expected {plain!r} in {own}, as stated, got a header that says {header}; correct "
                    "one of them"
                )
            return _Column(index, sign, own or header)
    raise DatasetError(f"{table.path}: expected a column {wanted!r}, got {list(table.names)}; name it in columns")


def _place_of(table: Table, name: str) -> int | None:
    bare = table.bare_names()
    if name in table.names:
        return table.names.index(name)
    return bare.index(name.casefold()) if bare.count(name.casefold()) == 1 else None


def _find_units(table: Table, wanted: Sequence[_Column], stated: str | None, default: str) -> tuple[str, list[str]]:
    """Units of the values, those stated and those of the header being the same, and what was assumed."""
    if stated is not None and stated not in SENSOR_UNITS:
        raise DatasetError(f"units: expected one of {list(SENSOR_UNITS)}, got {stated!r}; use one of them")
    named = {table.names[column.index]: column.units for column in wanted if column.units in SENSOR_UNITS}
    found = {str(units) for units in named.values()}
    if len(found) > 1 or (stated is not None and found - {stated}):
        expected = "columns of one unit," if stated is None else f"values in {stated}, as stated,"
        raise DatasetError(f"{table.path}: expected {expected} got {named} in its header; correct one of them")
    if stated is not None or found:
        return stated or found.pop(), []
    return default, [f"no units are stated: values are taken as {default}; state them with --units"]


def _parse_column(table: Table, index: int, most: float) -> FloatArray:
    """A column's values; NaN where there is none, infinity for an overload; that share of them at most."""
    cells = [row[index] for row in table.rows]
    values, wrong = parse_numbers(cells, table.decimal)
    if wrong is None:
        without = np.flatnonzero(~np.isfinite(values))
        if without.size <= most * len(values):
            return values
        wrong = int(without[0])
    some = "correct it" if wrong is not None and cells[wrong] else "give one"
    raise DatasetError(
        f"{table.path}: expected a number in row {table.lines[wrong]}, column {split_name(table.names[index])[0]!r}, "
        f"got {cells[wrong]!r}; {some}, or cut the file where too few cells are filled"
    )


def _name_sensor(path: Path | str, sensor: str | None) -> str:
    return Path(path).stem if sensor is None else sensor


def _make_attrs(path: Path | str, start: datetime | None, recording: _Recording) -> dict[str, Any]:
    attrs: dict[str, Any] = {"file": Path(path).name, "notes": recording.notes}
    if start is not None:
        if start.tzinfo is None:
            raise DatasetError(f"start: expected a time with its time zone, got {start.isoformat()}; add it")
        attrs["start_utc"] = start.astimezone(UTC).isoformat()
    elif recording.stamps is not None and recording.stamps.start is not None:
        attrs["start_utc"] = recording.stamps.start.astimezone(UTC).isoformat()
    if recording.stamps is not None and recording.stamps.first is not None:
        attrs["first_stamp"] = recording.stamps.first
    return attrs
