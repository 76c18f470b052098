"""Displacement for other programs: a table (CSV) and MATLAB (MAT)."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.io import savemat
from scipy.io.matlab import MatWriteError

from vfm_sdm.core.arrays import time_blocks
from vfm_sdm.core.datasets import START, STATUS_MEANINGS, check_displacement
from vfm_sdm.core.files import replace_file
from vfm_sdm.core.netcdf import write_displacement as write_netcdf
from vfm_sdm.core.registry import find
from vfm_sdm.core.stored import storable
from vfm_sdm.errors import ResultsError

__all__ = ["Writer", "to_csv", "to_mat", "write_displacement", "write_export"]

_COLUMNS = {
    "displacement": "",
    "displacement_std": " std",
    "combined_std": " combined std",
    "expanded_uncertainty": " U(k=2)",
}
"""Variables of a table, and what stands behind the axis at the head of their columns."""

Writer = Callable[[Path, xr.Dataset], None]
"""Function that writes one file of displacement, see `write_export`."""


def write_displacement(folder: Path | str, displacement: xr.Dataset) -> Path:
    """Writes ``displacement.nc`` and, for spreadsheets, ``displacement.csv``; the path of the former.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    displacement
        Displacement dataset, shape (T, P, 3) [mm]. Attributes may be text, numbers, lists, ``None`` and tables of
        these.

    Raises
    ------
    ResultsError
        A file cannot be written, or an attribute cannot be stored.
    DatasetError
        The dataset does not hold displacement.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> displacement = make_displacement(
    ...     [0.0, 0.1],
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=[[[0.0, 0.0, 0.0]], [[0.5, 2.0, 0.1]]],
    ...         displacement_std_mm=np.full((2, 1, 3), 0.1),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((2, 1, 3)),
    ...         reprojection_error_px=np.zeros((2, 1)),
    ...         status=np.zeros((2, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> with TemporaryDirectory() as folder:
    ...     print(write_displacement(folder, displacement).name, len(list(Path(folder).iterdir())))
    displacement.nc 2
    """
    storable(displacement)  # before anything is written
    # The table first: a later run takes displacement.nc as the sign that the result is complete.
    _write(to_csv, "csv", folder, displacement)
    return write_netcdf(folder, displacement)


def write_export(name: str, folder: Path | str, displacement: xr.Dataset) -> Path:
    """Writes ``displacement.NAME`` for other programs, whole or not at all; its path.

    Parameters
    ----------
    name
        Name of the writer (``csv``, ``mat``, ``uff``, or another package's), which is also the file's suffix.
    folder
        The run folder; made when absent.
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Raises
    ------
    BackendUnavailableError
        There is no such writer, or it cannot run here.
    ResultsError
        There is no value to write, or the file cannot be written.
    DatasetError
        The dataset does not hold displacement.

    Notes
    -----
    A writer is a function of the path to write to and of the checked dataset, whose dims are in the order ``time,
    point, axis``. It writes one file, and raises `ResultsError` where the data do not allow one.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> displacement = make_displacement(
    ...     [0.0, 0.1],
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=[[[0.0, 0.0, 0.0]], [[0.5, 2.0, 0.1]]],
    ...         displacement_std_mm=np.full((2, 1, 3), 0.1),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((2, 1, 3)),
    ...         reprojection_error_px=np.zeros((2, 1)),
    ...         status=np.zeros((2, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> with TemporaryDirectory() as folder:
    ...     path = write_export("csv", folder, displacement)
    ...     print(path.name, len(path.read_text().splitlines()))
    displacement.csv 3
    """
    return _write(find("writers", name).load(), name, folder, displacement)


def _write(writer: Writer, name: str, folder: Path | str, displacement: xr.Dataset) -> Path:
    target = Path(folder) / f"displacement.{name}"
    data = check_displacement(displacement)
    try:
        with replace_file(target) as temporary:
            writer(temporary, data)
    except ResultsError as error:
        raise ResultsError(f"{target}: {error}") from error
    except (OSError, ValueError) as error:
        raise ResultsError(
            f"{target}: expected to write it, got: {error}; close it elsewhere, or choose another folder"
        ) from error
    return target


def to_csv(path: Path, displacement: xr.Dataset) -> None:
    """Writes a table: one row for each frame, units in the column names, empty cells where there is no value.

    Parameters
    ----------
    path
        File to write.
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Notes
    -----
    The columns are ``time_s``; for each point and axis ``<point> <axis> [mm]``, ``<point> <axis> std [mm]`` (random
    part) and, where the uncertainty has a budget, ``<point> <axis> combined std [mm]`` and ``<point> <axis> U(k=2)
    [mm]``; and ``<point> status`` in words.
    """
    columns = {name: part for name, part in _COLUMNS.items() if name in displacement}
    axes = _names(displacement, "axis")
    header = ["time_s"]
    for point in _names(displacement, "point"):
        header += [f"{point} {axis}{part} [mm]" for axis in axes for part in columns.values()] + [f"{point} status"]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        for frames in time_blocks(displacement.sizes["time"]):
            writer.writerows(_table_rows(displacement[[*columns, "status"]].isel(time=frames), list(columns)))


def _table_rows(block: xr.Dataset, columns: list[str]) -> Iterator[list[str]]:
    """Rows of the table of some frames."""
    dims = ("time", "point", "axis")
    # Shape (time, point, axis, column) so that a row reads in the order of the header.
    values = np.stack([block[name].transpose(*dims).values for name in columns], axis=-1)
    for time_s, of_points, codes in zip(block["time"].values, values, block["status"].values, strict=True):
        row = [repr(float(time_s))]
        for of_axes, code in zip(of_points, codes, strict=True):
            row += ["" if np.isnan(v) else f"{v:.9g}" for v in of_axes.ravel()] + [STATUS_MEANINGS[code]]
        yield row


def to_mat(path: Path, displacement: xr.Dataset) -> None:
    """Writes MATLAB's version 5 with the arrays, names and units of the dataset.

    Parameters
    ----------
    path
        File to write.
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Raises
    ------
    ResultsError
        An array is too large for the format.

    Notes
    -----
    The variables are ``time_s`` (T, 1), ``points`` and ``axes`` (cell arrays), ``displacement_mm``,
    ``displacement_std_mm`` and ``position_m`` (T, P, 3), ``scale_std`` (P, 3), ``reprojection_error_px`` and ``status``
    (T, P), ``status_meanings`` (cell array; code 0 is the first), ``frame`` and ``start`` (when time is zero; empty
    where nobody said). Where the uncertainty has a budget also ``combined_std_mm`` and ``expanded_uncertainty_mm``
    (T, P, 3; k = 2), ``uncertainty_mm`` (T, P, 3, C) and ``components`` (cell array), its sources.
    """
    content = {
        "time_s": displacement["time"].values,
        "points": np.array(_names(displacement, "point"), dtype=object),
        "axes": np.array(_names(displacement, "axis"), dtype=object),
        "displacement_mm": displacement["displacement"].values,
        "displacement_std_mm": displacement["displacement_std"].values,
        "scale_std": displacement["scale_std"].values,
        "position_m": displacement["position"].values,
        "reprojection_error_px": displacement["reprojection_error"].values,
        "status": displacement["status"].values,
        "status_meanings": np.array(STATUS_MEANINGS, dtype=object),
        "frame": str(displacement.attrs.get("frame", "")),
        "start": str(displacement.attrs.get(START, "")),
    }
    if "uncertainty" in displacement:
        dims = ("time", "point", "axis")
        for name in ("combined_std", "expanded_uncertainty"):
            content[f"{name}_mm"] = displacement[name].transpose(*dims).values
        content["uncertainty_mm"] = displacement["uncertainty"].transpose(*dims, "component").values
        content["components"] = np.array(_names(displacement, "component"), dtype=object)
    try:
        savemat(path, content, appendmat=False, long_field_names=True, oned_as="column", do_compression=True)
    except MatWriteError as error:
        raise ResultsError(
            "expected arrays below 4 GB, more than which MATLAB's version 5 cannot hold, got larger ones; MATLAB reads "
            "displacement.nc, too (ncread)"
        ) from error


def _names(data: xr.Dataset, dim: str) -> list[str]:
    return [str(name) for name in data[dim].values]
