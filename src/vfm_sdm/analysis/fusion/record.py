"""A fusion as files of a run folder."""

from pathlib import Path

import xarray as xr

from vfm_sdm.analysis.fusion.result import FUSED_MEANINGS
from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.files import number_cell
from vfm_sdm.core.netcdf import read_if_there, write_with_table

__all__ = ["check_fusion", "read_fusion", "write_fusion"]

_FILE = "fused.nc"
_SAMPLES = ("displacement", "displacement_std", "combined_std")


def check_fusion(fused: xr.Dataset) -> xr.Dataset:
    """The dataset as given, after checking dims and units.

    Parameters
    ----------
    fused
        Of `vfm_sdm.analysis.fusion.fuse`, shape (N, A) [mm].

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units.
    """
    for name in _SAMPLES:
        check_variable(fused, name, ("time", "axis"), "mm")
    for name in ("gain", "gain_std", "lag", "lag_std", "innovation_rms", "video_std"):
        check_variable(fused, name, ("axis",), None)
    return fused


def read_fusion(folder: Path | str) -> xr.Dataset | None:
    """The fusion of a run folder; ``None`` where there is none.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_if_there(Path(folder) / _FILE, check_fusion, kind="a fusion", command="vfm-sdm fuse")


def write_fusion(folder: Path | str, fused: xr.Dataset) -> list[Path]:
    """Writes ``fused.nc`` and ``fused.csv``, a row a sample; returns their paths.

    Parameters
    ----------
    folder
        The run folder.
    fused
        Of `vfm_sdm.analysis.fusion.fuse`, shape (N, A) [mm].

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    check_fusion(fused)
    axes = [str(axis) for axis in fused["axis"].values]
    header = ["time_s"]
    columns: list[list[str]] = [[f"{time:.6f}" for time in fused["time"].values]]
    for axis in axes:
        one = fused.sel(axis=axis)
        header += [f"{axis}_mm", f"{axis}_std_mm", f"{axis}_combined_std_mm", f"{axis}_status"]
        for name in _SAMPLES:
            columns.append([number_cell(value) for value in one[name].values])
        columns.append([FUSED_MEANINGS[code] for code in one["status"].values.astype(int)])
    return write_with_table(Path(folder) / _FILE, fused, header, zip(*columns, strict=True))
