"""A field as files of a run folder."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.files import number_cell
from vfm_sdm.core.netcdf import read_if_there, write_with_table

__all__ = ["check_field", "extreme_times", "read_field", "write_field"]

_FILE = "field.nc"
_DIMS = ("time", "station", "axis")


def check_field(field: xr.Dataset) -> xr.Dataset:
    """The dataset as given, after checking dims and units.

    Parameters
    ----------
    field
        Of `vfm_sdm.analysis.field.compute_field`, shape (T, S, 3) [mm].

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units.
    """
    for name in ("displacement", "displacement_std", "common_std"):
        check_variable(field, name, _DIMS, "mm")
    check_variable(field, "position", ("station", "axis"), "m")
    check_variable(field, "used", ("point", "axis"), None)
    check_variable(field, "reason", ("point",), None)
    check_variable(field, "shape", ("shape_number", "station", "axis"), "1")
    check_variable(field, "shape_frequency", ("shape_number", "axis"), "Hz")
    return field


def extreme_times(field: xr.Dataset, axis: str) -> list[float]:
    """Times of the largest positive and the largest negative displacement along an axis, in their order [s].

    Parameters
    ----------
    field
        Field dataset, shape (T, S, 3) [mm].
    axis
        Name of the axis.
    """
    values = field["displacement"].sel(axis=axis).values
    rows = {int(np.nanargmax(values) // values.shape[1]), int(np.nanargmin(values) // values.shape[1])}
    return [float(field["time"].values[row]) for row in sorted(rows)]


def read_field(folder: Path | str) -> xr.Dataset | None:
    """The field of a run folder; ``None`` where none was computed.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_if_there(Path(folder) / _FILE, check_field, kind="a field", command="vfm-sdm field")


def write_field(folder: Path | str, field: xr.Dataset, times_s: Sequence[float]) -> list[Path]:
    """Writes ``field.nc``, and ``field.csv`` with the line at some times, a row a station; returns their paths.

    Parameters
    ----------
    folder
        The run folder.
    field
        Field dataset, shape (T, S, 3) [mm].
    times_s
        Times of which the frames nearest to them are listed [s].

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    check_field(field)
    axes = [str(axis) for axis in field["axis"].values]
    rows = []
    for time_s in times_s:
        frame = field.sel(time=time_s, method="nearest")
        numbers = np.concatenate([frame["displacement"].values, frame["displacement_std"].values], axis=1)
        for station, line in zip(field["station"].values, numbers, strict=True):
            cells = (float(frame["time"]), station, *line)
            rows.append([number_cell(value) for value in cells])
    header = ["time_s", "station_m", *(f"{axis}_mm" for axis in axes), *(f"{axis}_std_mm" for axis in axes)]
    return write_with_table(Path(folder) / _FILE, field, header, rows)
