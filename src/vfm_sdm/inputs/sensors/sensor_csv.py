"""Recordings of reference sensors from CSV files: accelerometers, and displacement gauges (LVDT, laser).

A file has one line of column names, then numbers with a decimal point, separated by commas. Its time is in seconds;
without a time column the sampling rate says it.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, clock_departure
from vfm_sdm.core.datasets import STRUCTURE_AXES, convert_units
from vfm_sdm.core.sensor_datasets import ReferenceFacts, make_acceleration, make_reference
from vfm_sdm.errors import DatasetError

__all__ = ["read_acceleration", "read_reference"]

_TIME = "time"
_UNEVEN = 0.2
"""Share of the sampling interval by which an interval between time stamps may be off: what rounding to milliseconds
does at 200 Hz, and far from a lost sample."""
_RATES_AGREE = 1e-3


def read_acceleration(
    path: Path | str,
    *,
    sensor: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: str = "g",
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
        Column of the file for each of the A axes recorded, and for ``time`` if there is one. A leading ``-`` reverses
        the sign, unless a column of just that name exists. Left out: ``lateral``, ``vertical`` and ``longitudinal``,
        and ``time`` where present.
    units
        Units of the file, ``g`` or ``m/s2``.
    sampling_rate_hz
        Samples a second; needed without a time column, and must agree with one [Hz].
    start
        When the first sample was taken; becomes attribute ``start_utc``.

    Returns
    -------
    acceleration
        Acceleration dataset, shape (T, 1, A) [m/s2].

    Raises
    ------
    DatasetError
        The file cannot be read; a column is missing; a cell is no number; the clock is not even, or contradicts the
        sampling rate; ``start`` has no time zone.

    Notes
    -----
    Time stamps are usually rounded, so the dataset's clock is ``t0 + i / rate``, with the rate that the first and the
    last stamp give. A sample more or less in between is an error.

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
    columns = {axis: axis for axis in STRUCTURE_AXES} if columns is None else columns
    time_s, rate_hz, axes, values = _read_columns(path, columns, sampling_rate_hz, gaps=False)
    signal = convert_units(xr.DataArray(values, dims=("time", "axis"), attrs={"units": units}), "m/s2")
    return make_acceleration(
        time_s,
        [_name_sensor(path, sensor)],
        axes,
        signal.values[:, None],
        sampling_rate_hz=rate_hz,
        attrs=_make_attrs(path, start),
    )


def read_reference(
    path: Path | str,
    *,
    sensor: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: str = "mm",
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
        Left out: those of ``lateral``, ``vertical`` and ``longitudinal`` that the file has, and ``time`` where present.
    units
        Units of the file, ``mm`` or ``m``.
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
    An empty cell is a sample without a value (NaN). Nothing is filtered: ``onset_s`` is the first sample, ``band_hz``
    ends at half the sampling rate.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "gauge.csv")
    ...     _ = file.write_text("time,vertical\n0.0,1.5\n0.1,\n0.2,1.25\n")
    ...     print(read_reference(file)["displacement"].values.ravel().tolist())
    [1.5, nan, 1.25]
    """
    time_s, rate_hz, axes, values = _read_columns(path, columns, sampling_rate_hz, gaps=True)
    signal = convert_units(xr.DataArray(values, dims=("time", "axis"), attrs={"units": units}), "mm")
    return make_reference(
        time_s,
        [_name_sensor(path, sensor)],
        axes,
        signal.values[:, None],
        facts=ReferenceFacts(rate_hz, float(time_s[0]), (0.0, rate_hz / 2)),
        attrs=_make_attrs(path, start),
    )


def _read_columns(
    path: Path | str, columns: Mapping[str, str] | None, sampling_rate_hz: float | None, *, gaps: bool
) -> tuple[FloatArray, float, list[str], FloatArray]:
    """Clock, sampling rate, axes and values (T, A) of a file; of its own axes when no columns are named."""
    header, rows = _read_rows(Path(path))
    if columns is None:
        columns = {axis: axis for axis in STRUCTURE_AXES if axis in header}
    unknown = sorted(set(columns) - {_TIME, *STRUCTURE_AXES})
    axes = [axis for axis in STRUCTURE_AXES if axis in columns]
    if unknown or not axes:
        raise DatasetError(
            f"{path}: expected columns for some of {list(STRUCTURE_AXES)}, and for time, got {sorted(columns)} and a "
            f"file with {header}; name them"
        )
    time_column = columns.get(_TIME, _TIME if _TIME in header else None)
    wanted = [_find_column(path, header, columns[axis]) for axis in axes]
    values = np.column_stack([sign * _parse_column(path, header, rows, index, gaps=gaps) for index, sign in wanted])
    stamps = None
    if time_column is not None:
        index, sign = _find_column(path, header, time_column)
        stamps = sign * _parse_column(path, header, rows, index, gaps=False)
    time_s, rate_hz = _make_even_clock(path, stamps, len(rows), sampling_rate_hz)
    return time_s, rate_hz, axes, values


def _read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Column names, and the cells of every row under them; blank rows at the end are left out."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path}: expected a CSV file in UTF-8, got: {error}; check the path and export") from error
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if len(rows) < 3:
        raise DatasetError(f"{path}: expected a line of names and at least two samples, got {len(rows)} lines")
    header = [name.strip() for name in rows[0]]
    repeated = sorted({name for name in header if name and header.count(name) > 1})
    if repeated:
        raise DatasetError(f"{path}: expected column names once each, got {repeated} more than once; rename them")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise DatasetError(
                f"{path}: expected {len(header)} cells in row {number}, got {len(row)}; separate columns by commas"
            )
    return header, rows[1:]


def _find_column(path: Path | str, header: Sequence[str], column: str) -> tuple[int, float]:
    """Place and sign of a column."""
    if column in header:
        return header.index(column), 1.0
    if column.startswith("-") and column[1:] in header:
        return header.index(column[1:]), -1.0
    raise DatasetError(f"{path}: expected a column {column!r}, got {list(header)}; name it in columns")


def _parse_column(
    path: Path | str, header: Sequence[str], rows: Sequence[Sequence[str]], index: int, *, gaps: bool
) -> FloatArray:
    """A column's values; empty cells are NaN where gaps are allowed."""
    values = np.empty(len(rows))
    for number, row in enumerate(rows):
        cell = row[index].strip()
        try:
            value = math.nan if gaps and not cell else float(cell)
        except ValueError:
            value = math.inf
        if not (math.isfinite(value) or (gaps and math.isnan(value))):
            raise DatasetError(
                f"{path}: expected a number in row {number + 2}, column {header[index]!r}, got {cell!r}; correct it"
            )
        values[number] = value
    return values


def _make_even_clock(
    path: Path | str, stamps: FloatArray | None, samples: int, sampling_rate_hz: float | None
) -> tuple[FloatArray, float]:
    """Time stamps without their rounding, and the sampling rate."""
    if sampling_rate_hz is not None and not (sampling_rate_hz > 0 and math.isfinite(sampling_rate_hz)):
        raise DatasetError(f"sampling_rate_hz: expected a number > 0, got {sampling_rate_hz}; correct it")
    if stamps is None:
        if sampling_rate_hz is None:
            raise DatasetError(f"{path}: expected a time column or sampling_rate_hz, got neither; state one of them")
        return np.arange(samples) / sampling_rate_hz, sampling_rate_hz
    intervals = np.diff(stamps)
    interval = float(np.median(intervals))
    if not interval > 0:
        raise DatasetError(f"{path}: expected rising time stamps, got {interval:g} s between samples; sort the rows")
    uneven = np.abs(np.diff(clock_departure(stamps, interval))) > _UNEVEN
    if uneven.any():
        row = int(np.flatnonzero(uneven)[0]) + 3
        raise DatasetError(
            f"{path}: expected samples {interval:g} s apart, got {intervals[uneven][0]:g} s before row {row}; cut the "
            "recording at the gap, or resample it"
        )
    rate_hz = (samples - 1) / float(stamps[-1] - stamps[0])
    if sampling_rate_hz is not None and abs(rate_hz / sampling_rate_hz - 1) > _RATES_AGREE:
        raise DatasetError(
            f"{path}: expected a time column of {sampling_rate_hz:g} Hz, got {rate_hz:g} Hz; correct sampling_rate_hz"
        )
    return stamps[0] + np.arange(samples) / rate_hz, rate_hz


def _name_sensor(path: Path | str, sensor: str | None) -> str:
    return Path(path).stem if sensor is None else sensor


def _make_attrs(path: Path | str, start: datetime | None) -> dict[str, Any]:
    attrs: dict[str, Any] = {"file": Path(path).name}
    if start is not None:
        if start.tzinfo is None:
            raise DatasetError(f"start: expected a time with its time zone, got {start.isoformat()}; add it")
        attrs["start_utc"] = start.astimezone(UTC).isoformat()
    return attrs
