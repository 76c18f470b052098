"""Displacement of reference sensors on disk: netCDF of one sensor or several that share a clock."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import check_displacement
from vfm_sdm.core.netcdf import read_dataset, write_dataset
from vfm_sdm.core.sensor_datasets import check_reference
from vfm_sdm.errors import DatasetError

__all__ = ["join_sensors", "read_comparison", "write_reference"]


def join_sensors(recordings: Sequence[xr.Dataset]) -> xr.Dataset:
    """One dataset of S sensors that share a clock.

    Parameters
    ----------
    recordings
        Acceleration [m/s2] or reference [mm] datasets of different sensors with the same axes, shapes (T, 1, A).

    Returns
    -------
    joined
        The sensors in the same order, shape (T, S, A).

    Raises
    ------
    DatasetError
        There is no recording; stamps, axes or kinds differ; two sensors have the same name.

    Examples
    --------
    >>> from vfm_sdm.core.sensor_datasets import make_acceleration
    >>> quarter, middle = (
    ...     make_acceleration(np.arange(4) / 100, [name], ["vertical"], np.zeros((4, 1, 1)), sampling_rate_hz=100)
    ...     for name in ("quarter", "middle")
    ... )
    >>> join_sensors([quarter, middle])["sensor"].values.tolist()
    ['quarter', 'middle']
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
    starts = [recording.attrs.get("first_stamp") for recording in recordings]
    if len({*starts}) > 1:
        raise DatasetError(f"sensors {names}: expected one clock, got first stamps {starts}; convert each sensor apart")
    joined = xr.concat(recordings, "sensor", join="exact", combine_attrs="drop_conflicts")
    said = [(r["sensor"].values[0], note) for r in recordings for note in r.attrs.get("notes", ())]
    joined.attrs["notes"] = [note if len(recordings) == 1 else f"{name}: {note}" for name, note in said]
    return joined


def write_reference(path: Path | str, reference: xr.Dataset) -> Path:
    """Writes a reference dataset as netCDF; returns its path.

    Parameters
    ----------
    path
        File to write; replaced as a whole.
    reference
        Displacement of the sensors [mm] (`vfm_sdm.core.sensor_datasets.make_reference`), shape (T, S, A).

    Raises
    ------
    ResultsError
        The file cannot be written.
    DatasetError
        The dataset is not a reference dataset.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from vfm_sdm.core.sensor_datasets import ReferenceFacts, make_reference
    >>> facts = ReferenceFacts(sampling_rate_hz=10, onset_s=0, band_hz=(0, 5))
    >>> gauge = make_reference([0.0, 0.1], ["gauge"], ["vertical"], np.ones((2, 1, 1)), facts=facts)
    >>> with TemporaryDirectory() as folder:
    ...     print(read_comparison(write_reference(f"{folder}/gauge.nc", gauge))["displacement"].shape)
    (2, 1, 1)
    """
    band_hz = np.asarray(check_reference(reference).attrs["band_hz"])  # an array, which other programs can read
    return write_dataset(path, reference.assign_attrs(band_hz=band_hz))


def read_comparison(path: Path | str) -> xr.Dataset:
    """What a measurement can be compared with: displacement of reference sensors, or of another measurement [mm].

    Parameters
    ----------
    path
        A file of `write_reference`, or ``displacement.nc`` of a measurement.

    Returns
    -------
    comparison
        Reference dataset, shape (T, S, A), or displacement dataset, shape (T, P, A) [mm].

    Raises
    ------
    ResultsError
        The file is missing, damaged or holds something else.
    """
    return read_dataset(path, _check_comparison, kind="a reference or displacement", command="vfm-sdm reference")


def _check_comparison(dataset: xr.Dataset) -> xr.Dataset:
    return check_reference(dataset) if "sensor" in dataset.dims else check_displacement(dataset)
