"""A load test as files of a run folder."""

from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.files import csv_text, write_file
from vfm_sdm.core.netcdf import read_dataset, write_dataset

__all__ = ["check_load_test", "read_load_test", "write_load_test"]

_FILE = "load_test.nc"
_BY_STEP = ("deflection", "expanded_uncertainty", "calculated", "ratio", "ratio_low", "ratio_high", "ratio_exceeded")
_BY_POINT = ("largest", "residual", "residual_share", "share_low", "share_high", "residual_exceeded")


def check_load_test(result: xr.Dataset) -> xr.Dataset:
    """The dataset as given, after checking dims and units.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test`.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units.
    """
    for name in _BY_STEP:
        check_variable(result, name, ("step", "point", "axis"), None)
    for name in _BY_POINT:
        check_variable(result, name, ("point", "axis"), None)
    for name in ("load", "begin_s", "end_s"):
        check_variable(result, name, ("step",), None)
    return result


def read_load_test(folder: Path | str) -> xr.Dataset | None:
    """The load test of a run folder; ``None`` where none was judged.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    file = Path(folder) / _FILE
    return (
        read_dataset(file, check_load_test, kind="a load test", command="vfm-sdm load-test") if file.exists() else None
    )


def write_load_test(folder: Path | str, result: xr.Dataset) -> list[Path]:
    """Writes ``load_test.nc`` and ``load_test.csv``, a row a step, point and axis; returns their paths.

    Parameters
    ----------
    folder
        The run folder.
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test`.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    check_load_test(result)
    rows = []
    unit = str(result["load"].attrs.get("units") or "1")
    for step in result["step"].values:
        of_step = result.sel(step=step)
        for point in result["point"].values:
            for axis in result["axis"].values:
                one = of_step.sel(point=point, axis=axis)
                numbers = [float(one[name]) for name in (*_BY_STEP, *_BY_POINT)]
                edges = [float(of_step[name]) for name in ("load", "begin_s", "end_s")]
                cells = [f"{value:.6g}" if np.isfinite(value) else "" for value in (*edges, *numbers)]
                rows.append([int(step), str(point), str(axis), *cells])
    units = {"deflection", "expanded_uncertainty", "calculated", "largest", "residual"}
    names = [f"{name}_mm" if name in units else name for name in (*_BY_STEP, *_BY_POINT)]
    header = ["step", "point", "axis", f"load [{unit}]", "begin_s", "end_s", *names]
    file = Path(folder) / _FILE
    return [write_dataset(file, result), write_file(file.with_suffix(".csv"), csv_text(header, rows))]
