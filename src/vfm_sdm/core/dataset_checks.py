"""Checks at the door of every stage: variables of a dataset, their dims and units, and its clock."""

import numpy as np
import xarray as xr

from vfm_sdm.errors import DatasetError

__all__ = ["check_clock", "check_codes", "check_variable"]


def check_variable(dataset: xr.Dataset, name: str, dims: tuple[str, ...], units: str | None) -> None:
    """Refuses a variable that is missing, or has other dims or units.

    Parameters
    ----------
    dataset
        What should hold the variable.
    name, dims, units
        What is expected; without units, any pass.

    Raises
    ------
    DatasetError
        The variable is not as expected.
    """
    if name not in dataset:
        raise DatasetError(f"dataset: expected a variable {name!r}, got {sorted(map(str, dataset.data_vars))}")
    variable = dataset[name]
    if variable.dims != dims:
        raise DatasetError(f"{name}: expected dims {dims}, got {variable.dims}; transpose or rename them")
    if units is not None and variable.attrs.get("units") != units:
        raise DatasetError(f"{name}: expected units {units!r}, got {variable.attrs.get('units')!r}; convert them")


def check_codes(dataset: xr.Dataset, name: str, count: int) -> None:
    """Refuses codes of which nobody knows the meaning, as a damaged file holds.

    Parameters
    ----------
    dataset
        What holds the variable.
    name
        Of the codes.
    count
        Number of codes with a meaning; they begin at 0.

    Raises
    ------
    DatasetError
        A code is negative or too large.
    """
    codes = dataset[name].values
    unknown = codes[(codes < 0) | (codes >= count)]
    if unknown.size:
        raise DatasetError(f"{name}: expected codes from 0 to {count - 1}, got {unknown[0]}; make the file again")


def check_clock(dataset: xr.Dataset) -> None:
    """Refuses time stamps that are not there, not in seconds, not finite or not increasing.

    Raises
    ------
    DatasetError
        The stamps are not as expected.
    """
    if "time" not in dataset.coords:
        raise DatasetError("time: expected a coordinate of time stamps in seconds, got none; write it with units 's'")
    units = dataset["time"].attrs.get("units")
    if units != "s":
        raise DatasetError(
            f"time: expected units 's', got {units!r}; convert the stamps to seconds and set units to 's'"
        )
    time_s = dataset["time"].values
    if not np.isfinite(time_s).all() or np.any(np.diff(time_s) <= 0):
        raise DatasetError("time: expected finite, increasing seconds, got repeated or falling stamps; sort the frames")
