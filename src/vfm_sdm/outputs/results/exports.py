"""Displacement for other programs: a table (CSV), MATLAB (MAT) and modal analysis (universal file, dataset 58)."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.io import savemat

from vfm_sdm.core.arrays import FloatArray, is_even_clock, time_blocks
from vfm_sdm.core.datasets import STATUS_MEANINGS, check_displacement, convert_units
from vfm_sdm.core.files import replace_file
from vfm_sdm.core.netcdf import write_displacement as write_netcdf
from vfm_sdm.core.registry import find
from vfm_sdm.core.stored import storable
from vfm_sdm.errors import ResultsError
from vfm_sdm.signals.clocks import ROUNDED_STAMPS

__all__ = ["Writer", "to_csv", "to_mat", "to_uff", "write_displacement", "write_export"]

Writer = Callable[[Path, xr.Dataset], None]
"""Function that writes one file of displacement, see `write_export`."""

# Codes of the universal file format, datasets 58 and 164.
_TIME_RESPONSE = 1
_DOUBLE = 4
_AXIS_TIME = 17
_AXIS_DISPLACEMENT = 8
_UNITS_SI = 1
_RELATIVE_TEMPERATURE = 2


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
    The columns are ``time_s``; for each point ``<point> <axis> [mm]`` and ``<point> <axis> std [mm]`` (random part) for
    each axis, and ``<point> status`` in words.
    """
    points, axes = _names(displacement, "point"), _names(displacement, "axis")
    header = ["time_s"]
    for point in points:
        header += [f"{point} {axis}{part} [mm]" for axis in axes for part in ("", " std")] + [f"{point} status"]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        for frames in time_blocks(displacement.sizes["time"]):
            writer.writerows(
                _table_rows(displacement[["displacement", "displacement_std", "status"]].isel(time=frames))
            )


def _table_rows(block: xr.Dataset) -> Iterator[list[str]]:
    """Rows of the table of some frames."""
    # Shape (time, point, axis, value and std) so that a row reads in the order of the header.
    values = np.stack([block["displacement"].values, block["displacement_std"].values], axis=-1)
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

    Notes
    -----
    The variables are ``time_s`` (T, 1), ``points`` and ``axes`` (cell arrays), ``displacement_mm``,
    ``displacement_std_mm`` and ``position_m`` (T, P, 3), ``scale_std`` (P, 3), ``reprojection_error_px`` and ``status``
    (T, P), ``status_meanings`` (cell array; code 0 is the first) and ``frame``.
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
    }
    savemat(path, content, appendmat=False, long_field_names=True, oned_as="column", do_compression=True)


def to_uff(path: Path, displacement: xr.Dataset) -> None:
    """Writes the universal file format: one dataset 58 for each point and axis, in SI units (metres).

    Parameters
    ----------
    path
        File to write.
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Raises
    ------
    ResultsError
        There is no value to write.

    Notes
    -----
    Nodes are the points in their order, from 1; directions 1, 2, 3 are the axes in their order. Samples without a
    value are left out; such a series, or one whose frames are unevenly spaced, is written with its time stamps, which
    the format keeps to six digits. A series without any value is left out. Letters outside ASCII become ``?``, line
    breaks in names blanks.

    References
    ----------
    .. [1] Structural Dynamics Research Laboratory, University of Cincinnati, "Universal File Formats", datasets
       58 (function at nodal degree of freedom) and 164 (units).
    """
    metres = convert_units(displacement["displacement"], "m").values
    time_s = displacement["time"].values
    records: list[str] = []
    for node, point in enumerate(_names(displacement, "point"), start=1):
        for direction, axis in enumerate(_names(displacement, "axis"), start=1):
            series = metres[:, node - 1, direction - 1]
            found = np.isfinite(series)
            if found.any():
                label = (point, axis)
                records += _dataset_58(time_s[found], series[found], label=label, node=node, direction=direction)
    if not records:
        raise ResultsError("expected at least one value, got none; look at the tracks' status first")
    text = "\n".join([*_dataset_164(), *records]) + "\n"
    path.write_bytes(text.encode("ascii", errors="replace"))


def _dataset_164() -> list[str]:
    """Units of the file: metre, newton, kelvin."""
    factors = "".join(_fortran(value, 25, 17) for value in (1.0, 1.0, 1.0))
    return [
        "    -1",
        "   164",
        f"{_UNITS_SI:10d}{'SI: Meter (newton)':<20s}{_RELATIVE_TEMPERATURE:10d}",
        factors,
        _fortran(273.15, 25, 17),
        "    -1",
    ]


def _dataset_58(
    time_s: FloatArray, metres: FloatArray, *, label: tuple[str, str], node: int, direction: int
) -> list[str]:
    """One function: heading, degree of freedom, abscissa, axes and values."""
    interval = (time_s[-1] - time_s[0]) / (time_s.size - 1) if time_s.size > 1 else 0.0
    even = time_s.size > 1 and is_even_clock(time_s, interval, tolerance=ROUNDED_STAMPS)
    dof = f" {'NONE':<10s}{node:10d}{direction:4d} {'NONE':<10s}{0:10d}{0:4d}"
    return [
        "    -1",
        "    58",
        "".join(letter if letter.isprintable() else " " for letter in " ".join(label))[:80],
        f"displacement along {label[1]}"[:80],
        "NONE",
        "vfm-sdm",
        "NONE",
        f"{_TIME_RESPONSE:5d}{0:10d}{1:5d}{0:10d}{dof}",
        f"{_DOUBLE:10d}{time_s.size:10d}{int(even):10d}{time_s[0]:13.5E}{interval if even else 0.0:13.5E}{0.0:13.5E}",
        _axis_record(_AXIS_TIME, "Time", "s"),
        _axis_record(_AXIS_DISPLACEMENT, "Displacement", "m"),
        _axis_record(0, "NONE", "NONE"),
        _axis_record(0, "NONE", "NONE"),
        *(_even_values(metres) if even else _uneven_values(time_s, metres)),
        "    -1",
    ]


def _axis_record(kind: int, label: str, units: str) -> str:
    length = 1 if kind == _AXIS_DISPLACEMENT else 0  # displacement is a length to the power of one
    return f"{kind:10d}{length:5d}{0:5d}{0:5d} {label:<20s} {units:<20s}"


def _even_values(values: FloatArray) -> Iterator[str]:
    for start in range(0, values.size, 4):
        yield "".join(f"{value:20.12E}" for value in values[start : start + 4])


def _uneven_values(time_s: FloatArray, values: FloatArray) -> Iterator[str]:
    pairs = [f"{time:13.5E}{value:20.12E}" for time, value in zip(time_s, values, strict=True)]
    for start in range(0, len(pairs), 2):
        yield "".join(pairs[start : start + 2])


def _fortran(value: float, width: int, digits: int) -> str:
    """A number as FORTRAN's D format writes it."""
    return f"{value:{width}.{digits}E}".replace("E", "D")


def _names(data: xr.Dataset, dim: str) -> list[str]:
    return [str(name) for name in data[dim].values]
