"""Points that belong to a grid, and those that have names of their own: ``grid`` (point) of a dataset tells which."""

import numpy as np
import xarray as xr

__all__ = ["grid_points", "without_grids"]


def grid_points(dataset: xr.Dataset) -> list[str]:
    """Names of the points that belong to a grid, in their order.

    Parameters
    ----------
    dataset
        Points, tracks or displacement of P points; with ``grid`` (point) where there are grids.

    Examples
    --------
    >>> grid_points(xr.Dataset({"grid": ("point", ["", "web"])}, coords={"point": ["mid", "web 01-01"]}))
    ['web 01-01']
    """
    if "grid" not in dataset:
        return []
    return [str(name) for name, grid in zip(dataset["point"].values, dataset["grid"].values, strict=True) if grid]


def without_grids(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with the points that have names of their own alone.

    Parameters
    ----------
    dataset
        Points, tracks or displacement of P points; with ``grid`` (point) where there are grids.

    Examples
    --------
    >>> found = xr.Dataset({"grid": ("point", ["", "web"])}, coords={"point": ["mid", "web 01-01"]})
    >>> without_grids(found)["point"].values.tolist()
    ['mid']
    """
    return dataset if "grid" not in dataset else dataset.isel(point=np.flatnonzero(dataset["grid"].values == ""))
