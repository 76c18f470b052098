"""References on disk: netCDF of one or several sensors on one clock, and what a measurement can be compared with."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import check_reference
from vfm_sdm.core.files import replace_file
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.errors import DatasetError, ResultsError

__all__ = ["join_sensors", "read_comparison", "write_reference"]

_ENGINE: Final = "h5netcdf"
_READ_ERRORS = (OSError, ValueError, KeyError, RuntimeError, TypeError)
"""What xarray, h5netcdf and HDF5 raise on files that are damaged or hold something else."""


def join_sensors(recordings: Sequence[xr.Dataset]) -> xr.Dataset:
    """One dataset of several sensors that share a clock.

    Parameters
    ----------
    recordings
        Acceleration or reference datasets of different sensors with the same axes.

    Raises
    ------
    DatasetError
        There is none; stamps, axes or kinds differ; two sensors have the same name.
    """
    if not recordings:
        raise DatasetError("sensors: expected one recording or more, got none; name a file")
    first = recordings[0]
    names = [str(name) for recording in recordings for name in recording["sensor"].values]
    if len({*names}) < len(names):
        raise DatasetError(f"sensors: expected different names, got {names}; name each with --sensor")
    for recording in recordings[1:]:
        if {*recording.data_vars} != {*first.data_vars} or not recording["axis"].equals(first["axis"]):
            raise DatasetError(
                f"sensors {names}: expected recordings of one kind and the same axes; convert them apart"
            )
        if not np.array_equal(recording["time"], first["time"]):
            clocks = [f"{r.sizes['time']} samples from {float(r['time'][0]):g} s on" for r in (first, recording)]
            raise DatasetError(
                f"sensors {names}: expected one clock, got {clocks[0]} and {clocks[1]}; convert each sensor apart"
            )
    return xr.concat(recordings, "sensor", join="exact", combine_attrs="drop_conflicts")


def write_reference(path: Path | str, reference: xr.Dataset) -> Path:
    """Writes a reference dataset as netCDF; returns its path.

    Raises
    ------
    ResultsError
        The file cannot be written.
    DatasetError
        The dataset does not hold a reference.
    """
    target = Path(path)
    check_reference(reference)
    try:
        with replace_file(target) as temporary:
            reference.drop_encoding().to_netcdf(temporary, engine=_ENGINE)
    except OSError as error:
        raise ResultsError(f"{target}: expected to write it, got: {error}; choose another folder") from error
    return target


def read_comparison(path: Path | str) -> xr.Dataset:
    """What a measurement can be compared with: a reference dataset (`write_reference`), or displacement.

    Raises
    ------
    ResultsError
        The file is missing, damaged or holds something else.
    """
    source = Path(path)
    if not source.is_file():
        raise ResultsError(f"{source}: expected a reference, got no such file; make it with `vfm-sdm reference`")
    try:
        with xr.open_dataset(source, engine=_ENGINE, decode_times=False) as dataset:
            if "sensor" not in dataset.dims:
                return read_displacement(source)
            reference = dataset.load()
    except ResultsError:
        raise
    except _READ_ERRORS as error:
        raise ResultsError(f"{source}: expected netCDF, got: {error}; run `vfm-sdm reference` again") from error
    try:
        return check_reference(reference)
    except DatasetError as error:
        raise ResultsError(
            f"{source}: expected a reference, got something else ({error}); run `vfm-sdm reference` again"
        ) from error
