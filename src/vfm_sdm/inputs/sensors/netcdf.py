"""References on disk: netCDF of one or several sensors on one clock, and what a measurement can be compared with."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import check_displacement, check_reference
from vfm_sdm.core.netcdf import read_dataset, write_dataset
from vfm_sdm.errors import DatasetError

__all__ = ["join_sensors", "read_comparison", "write_reference"]


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
    band_hz = np.asarray(check_reference(reference).attrs["band_hz"])  # an array, which other programs can read
    return write_dataset(path, reference.assign_attrs(band_hz=band_hz))


def read_comparison(path: Path | str) -> xr.Dataset:
    """What a measurement can be compared with: a reference dataset (`write_reference`), or displacement.

    Raises
    ------
    ResultsError
        The file is missing, damaged or holds something else.
    """
    return read_dataset(path, _check_comparison, kind="a reference or displacement", command="vfm-sdm reference")


def _check_comparison(dataset: xr.Dataset) -> xr.Dataset:
    return check_reference(dataset) if "sensor" in dataset.dims else check_displacement(dataset)
