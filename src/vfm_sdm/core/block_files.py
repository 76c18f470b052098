"""Files of datasets that are longer than memory allows, written block by block along time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import h5netcdf
import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.stored import restored, storable
from vfm_sdm.errors import ResultsError

__all__ = ["BlockFile", "time_variables"]

_ENGINE: Final = "h5netcdf"
_CHUNK = 4096
"""Frames that are compressed together."""


def time_variables(dataset: xr.Dataset) -> list[str]:
    """Names of the variables that have a value for every frame.

    Parameters
    ----------
    dataset
        Dataset with a dim ``time``; variables of any unit.
    """
    return [str(name) for name, variable in dataset.variables.items() if "time" in variable.dims]


class BlockFile:
    """A netCDF file that grows by blocks of frames.

    Parameters
    ----------
    path
        The file to make; it is whole only after `finish`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> def block(first):
    ...     time_s = np.arange(first, first + 3) / 10
    ...     return xr.Dataset({"level": ("time", time_s**2, {"units": "mm"})}, coords={"time": time_s})
    >>> with TemporaryDirectory() as folder:
    ...     file = BlockFile(Path(folder, "levels.nc"))
    ...     for first in (0, 3):
    ...         file.append(block(first))
    ...     with file.finish(xr.Dataset(attrs={"gauge": "north"})) as found:
    ...         print(found.sizes["time"], found.attrs, float(found["level"][4].round(2)))
    6 {'gauge': 'north'} 0.16
    """

    def __init__(self, path: Path) -> None:
        self._path, self._frames = path, 0

    def append(self, block: xr.Dataset) -> None:
        """Writes the variables of a block that have the dim ``time``; all blocks have the same.

        Parameters
        ----------
        block
            Variables of any shape and unit.

        Raises
        ------
        ResultsError
            The file cannot be written, or the block has other variables than those before.
        """
        names = time_variables(block)
        frames = block.sizes["time"]
        try:
            if self._frames == 0:
                self._begin(block[[name for name in names if name != "time"]])
            else:
                self._extend(block, names)
        except OSError as error:
            raise _cannot_write(self._path, error) from error
        self._frames += frames

    def change(self, name: str, frames: slice, change: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> None:
        """Changes what was written.

        Parameters
        ----------
        name
            Name of the variable, whose first dim is ``time``.
        frames
            Frames to change.
        change
            Function from their old values to the new ones.

        Raises
        ------
        ResultsError
            The file cannot be written.
        """
        try:
            with h5netcdf.File(self._path, "a") as file:
                variable = file.variables[name]
                variable[frames] = change(variable[frames])
        except OSError as error:
            raise _cannot_write(self._path, error) from error

    def finish(self, rest: xr.Dataset) -> xr.Dataset:
        """The whole dataset, read from the file where it is looked at.

        Parameters
        ----------
        rest
            All variables without the dim ``time``, and the attributes.

        Raises
        ------
        ResultsError
            The file cannot be written.
        """
        stored = storable(rest)
        try:
            with h5netcdf.File(self._path, "r") as file:
                known = set(file.variables)
            stored = stored.drop_vars([name for name in stored.variables if name in known])
            stored.to_netcdf(self._path, mode="a", engine=_ENGINE)
        except OSError as error:
            raise _cannot_write(self._path, error) from error
        # Without a cache: what was looked at once need not stay in memory.
        return restored(xr.open_dataset(self._path, engine=_ENGINE, decode_times=False, cache=False))

    def _begin(self, block: xr.Dataset) -> None:
        stored = storable(block)
        stored.attrs = {}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        encoding = {name: _choose_layout(stored.variables[name]) for name in time_variables(stored)}
        stored.to_netcdf(self._path, engine=_ENGINE, encoding=encoding, unlimited_dims=["time"])

    def _extend(self, block: xr.Dataset, names: list[str]) -> None:
        frames = block.sizes["time"]
        with h5netcdf.File(self._path, "a") as file:
            known = {name for name, variable in file.variables.items() if "time" in variable.dimensions}
            if known != set(names):
                raise ResultsError(
                    f"{self._path}: expected the variables {sorted(known)} in every block, got {sorted(names)}"
                )
            file.resize_dimension("time", self._frames + frames)
            for name in names:
                variable = file.variables[name]
                axis = variable.dimensions.index("time")
                where = [slice(None)] * axis + [slice(self._frames, self._frames + frames)]
                variable[tuple(where)] = block[name].transpose(*variable.dimensions).values


def _cannot_write(path: Path, error: OSError) -> ResultsError:
    return ResultsError(f"{path}: expected to write it, got: {error}; make room, or use another disk")


def _choose_layout(variable: xr.Variable) -> dict[str, Any]:
    """Chunks in which the series of one point lies together, compressed as in every file."""
    sizes = {"time": _CHUNK, "point": 1}
    chunks = tuple(sizes.get(str(dim), size) for dim, size in variable.sizes.items())
    layout: dict[str, Any] = {"chunksizes": chunks}
    if variable.dtype.kind in "iufb":
        layout |= {"zlib": True, "complevel": 1, "shuffle": True}
    if np.issubdtype(variable.dtype, np.floating):
        layout["_FillValue"] = np.array(np.nan, dtype=variable.dtype)
    return layout
