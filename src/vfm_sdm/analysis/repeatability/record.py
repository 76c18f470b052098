"""Repeatability and reproducibility as files of a run folder."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.analysis.repeatability.anova import Spread
from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.files import number_cell
from vfm_sdm.core.netcdf import read_if_there, write_with_table

__all__ = ["check_repeatability", "read_repeatability", "write_repeatability"]

_FILE = "repeatability.nc"
_NAMES = (*(one.name for one in fields(Spread)), "stated_std", "consistency")


def check_repeatability(result: xr.Dataset) -> xr.Dataset:
    """The dataset as given, after checking dims.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.repeatability.compare_runs`.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims.
    """
    for name in _NAMES:
        check_variable(result, name, ("quantity", "point", "axis"), None)
    check_variable(result, "value", ("run", "quantity", "point", "axis"), "mm")
    for name in ("person", "origin", "start"):
        check_variable(result, name, ("run",), None)
    check_variable(result, "first_frame_differs", ("point",), None)
    return result


def read_repeatability(folder: Path | str) -> xr.Dataset | None:
    """The comparison in a folder; ``None`` where there is none.

    Parameters
    ----------
    folder
        The folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_if_there(
        Path(folder) / _FILE, check_repeatability, kind="a comparison of runs", command="vfm-sdm repeat"
    )


def write_repeatability(folder: Path | str, result: xr.Dataset) -> list[Path]:
    """Writes ``repeatability.nc`` and ``repeatability.csv``, a row a quantity, point and axis; returns their paths.

    Parameters
    ----------
    folder
        The folder.
    result
        Of `vfm_sdm.analysis.repeatability.compare_runs`.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    check_repeatability(result)
    labels = [[str(value) for value in result[dim].values] for dim in ("quantity", "point", "axis")]
    runs = [f"{run}_mm" for run in result["run"].values]
    rows = []
    for at in np.ndindex(*(len(names) for names in labels)):
        numbers = [*(result[name].values[at] for name in _NAMES), *result["value"].values[:, *at]]
        cells = [number_cell(number) for number in numbers]
        rows.append([*(names[i] for names, i in zip(labels, at, strict=True)), *cells])
    plain = ("p_value", "consistency")
    header = ["quantity", "point", "axis", *(name if name in plain else f"{name}_mm" for name in _NAMES), *runs]
    return write_with_table(Path(folder) / _FILE, result, header, rows)
