"""Modes as files of a run folder."""

from pathlib import Path

import xarray as xr

from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.files import number_cell
from vfm_sdm.core.netcdf import read_if_there, write_with_table

__all__ = ["check_modes", "read_modes", "write_modes"]

_FILE = "modes.nc"
_NUMBERS = ("frequency", "damping_ratio")
_COLUMNS = tuple(name + ending for name in _NUMBERS for ending in ("", "_low", "_high", "_std"))


def check_modes(modes: xr.Dataset) -> xr.Dataset:
    """The modes as given, after checking dims and units.

    Parameters
    ----------
    modes
        Dataset with ``frequency`` [Hz], ``damping_ratio`` [1] (mode) and ``shape`` [1] (mode, point, axis).

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units.
    """
    check_variable(modes, "frequency", ("mode",), "Hz")
    check_variable(modes, "damping_ratio", ("mode",), "1")
    check_variable(modes, "shape", ("mode", "point", "axis"), "1")
    return modes


def read_modes(folder: Path | str) -> xr.Dataset | None:
    """The modes of a run folder; ``None`` where none were identified.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_if_there(Path(folder) / _FILE, check_modes, kind="modes", command="vfm-sdm modes")


def write_modes(folder: Path | str, modes: xr.Dataset) -> list[Path]:
    """Writes ``modes.nc`` and ``modes.csv``, a row a mode, point and axis; returns their paths.

    Parameters
    ----------
    folder
        The run folder.
    modes
        Of `vfm_sdm.analysis.modal.identify_modes`.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    check_modes(modes)
    rows = []
    for mode in modes["mode"].values:
        of_mode = modes.sel(mode=mode)
        head = [f"{float(of_mode[name]):.6g}" for name in _COLUMNS]
        for point in modes["point"].values:
            for axis in modes["axis"].values:
                one = of_mode.sel(point=point, axis=axis)
                value, std = complex(one["shape"]), float(one["shape_std"])
                cells = [number_cell(number) for number in (value.real, value.imag, std)]
                rows.append([int(mode), *head, str(of_mode["status"].item()), str(point), str(axis), *cells])
    units = [f"{name}_hz" if name.startswith("frequency") else name for name in _COLUMNS]
    header = ["mode", *units, "status", "point", "axis", "shape_real", "shape_imaginary", "shape_std"]
    return write_with_table(Path(folder) / _FILE, modes, header, rows)
