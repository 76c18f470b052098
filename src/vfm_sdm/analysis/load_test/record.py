"""A load test as files of a run folder."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.files import number_cell
from vfm_sdm.core.netcdf import read_if_there, write_with_table

__all__ = [
    "check_load_test",
    "check_passages",
    "read_load_test",
    "read_passages_of_run",
    "write_load_test",
    "write_passages",
]

_STEPS, _PASSAGES = "load_test.nc", "passages.nc"
_BY_STEP = ("deflection", "expanded_uncertainty", "calculated", "ratio", "ratio_low", "ratio_high", "ratio_exceeded")
_BY_POINT = ("largest", "residual", "residual_share", "share_low", "share_high", "residual_exceeded")
_BY_PASSAGE = (
    *("largest_total", "total_uncertainty", "largest_static", "static_uncertainty"),
    *("amplification", "amplification_low", "amplification_high", "cutoff"),
)
_BY_POINT_OF_PASSAGES = ("frequency",)


def check_load_test(result: xr.Dataset) -> xr.Dataset:
    """The dataset as given, after checking dims.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test`.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims.
    """
    return _check(
        result, "step", {"step": (*_BY_STEP, "combined_std"), "": _BY_POINT, "of": ("load", "begin_s", "end_s")}
    )


def check_passages(result: xr.Dataset) -> xr.Dataset:
    """The dataset as given, after checking dims.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.load_test.judge_passages`.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims.
    """
    _check(
        result,
        "passage",
        {"passage": (*_BY_PASSAGE, "status"), "": _BY_POINT_OF_PASSAGES, "of": ("begin_s", "end_s", "speed_m_s")},
    )
    for name in ("static", "static_std"):
        check_variable(result, name, ("passage", "station", "point", "axis"), "mm")
    return result


def _check(result: xr.Dataset, dim: str, names: Mapping[str, Iterable[str]]) -> xr.Dataset:
    dims = {dim: (dim, "point", "axis"), "": ("point", "axis"), "of": (dim,)}
    for kind, of_kind in names.items():
        for name in of_kind:
            check_variable(result, name, dims[kind], None)
    return result


def read_load_test(folder: Path | str) -> xr.Dataset | None:
    """Steps of the load test of a run folder; ``None`` where none were judged.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_if_there(Path(folder) / _STEPS, check_load_test, kind="a load test", command="vfm-sdm load-test")


def read_passages_of_run(folder: Path | str) -> xr.Dataset | None:
    """Passages over the structure of a run folder; ``None`` where none were judged.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_if_there(Path(folder) / _PASSAGES, check_passages, kind="passages", command="vfm-sdm passages")


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
    return _write(Path(folder) / _STEPS, check_load_test(result), "step", ("load", "begin_s", "end_s"))


def write_passages(folder: Path | str, result: xr.Dataset) -> list[Path]:
    """Writes ``passages.nc`` and ``passages.csv``, a row a passage, point and axis; returns their paths.

    Parameters
    ----------
    folder
        The run folder.
    result
        Of `vfm_sdm.analysis.load_test.judge_passages`.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    return _write(Path(folder) / _PASSAGES, check_passages(result), "passage", ("begin_s", "end_s", "speed_m_s"))


def _write(file: Path, result: xr.Dataset, dim: str, of_dim: Sequence[str]) -> list[Path]:
    """The dataset, and its figures by point and axis as a table with the units in the names."""
    kept = (*_BY_STEP, *_BY_POINT, *_BY_PASSAGE, *_BY_POINT_OF_PASSAGES, "status")
    names = [name for name in kept if name in result]
    spread = result[names].broadcast_like(result[names[0]]).transpose(dim, "point", "axis")
    keys = [[str(value) for value in result[name].values] for name in (dim, "point", "axis")]
    rows = [
        [
            *(labels[i] for labels, i in zip(keys, at, strict=True)),
            *(_text(result[name].values[at[0]]) for name in of_dim),
            *(_text(spread[name].values[at]) for name in names),
        ]
        for at in np.ndindex(*(len(labels) for labels in keys))
    ]
    header = [dim, "point", "axis", *(_with_unit(result, name) for name in (*of_dim, *names))]
    return write_with_table(file, result, header, rows)


def _with_unit(result: xr.Dataset, name: str) -> str:
    unit = str(result[name].attrs.get("units", "1"))
    if name == "load":
        return f"load [{unit}]"
    return name if unit == "1" or name in ("begin_s", "end_s", "speed_m_s") else f"{name}_{unit.casefold()}"


def _text(value: object) -> str:
    return number_cell(value) if isinstance(value, float) else str(value)
