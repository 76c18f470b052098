"""Files of datasets that are longer than memory allows, written block by block along time."""

import os
from collections.abc import Callable
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Any, Final

import h5netcdf
import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import time_blocks
from vfm_sdm.core.stored import restored, storable
from vfm_sdm.errors import ResultsError

__all__ = ["LONG_BYTES", "BlockFile", "JoinedBlocks", "ScratchFile", "cannot_write", "time_variables"]

LONG_BYTES: Final = 1 << 25
"""Size from which on a dataset is written, and read, part by part."""

_ENGINE: Final = "h5netcdf"
_SCRATCH: Final = ".scratch-"
_CHUNK = 4096
"""Frames that are compressed together."""
_BLOCK = 65536
"""Frames that are in memory at a time where a whole dataset is written."""


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
    group
        Group of the file that holds the dataset; the file itself when left out.

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

    def __init__(self, path: Path, group: str | None = None) -> None:
        self._path, self._group, self._frames = path, group, 0

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
            raise cannot_write(self._path, error) from error
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
                variable = self._inside(file).variables[name]
                variable[frames] = change(variable[frames])
        except OSError as error:
            raise cannot_write(self._path, error) from error

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
                known = set(self._inside(file).variables)
            stored = stored.drop_vars([name for name in stored.variables if name in known])
            stored.to_netcdf(self._path, mode="a", engine=_ENGINE, group=self._group)
        except OSError as error:
            raise cannot_write(self._path, error) from error
        # Without a cache: what was looked at once need not stay in memory.
        return restored(xr.open_dataset(self._path, engine=_ENGINE, decode_times=False, cache=False, group=self._group))

    def write(self, dataset: xr.Dataset) -> xr.Dataset:
        """The dataset, written block by block and read from the file where it is looked at.

        Parameters
        ----------
        dataset
            Variables of any shape and unit, which may lie in another file.

        Raises
        ------
        ResultsError
            The file cannot be written.
        """
        along = time_variables(dataset)
        for block in time_blocks(dataset.sizes["time"], size=_BLOCK):
            self.append(dataset[along].isel(time=block).load())
        return self.finish(dataset.drop_vars(along))

    def _inside(self, file: h5netcdf.File) -> h5netcdf.Group:
        return file if self._group is None else file[self._group]

    def _begin(self, block: xr.Dataset) -> None:
        stored = storable(block)
        stored.attrs = {}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        encoding = {name: _choose_layout(stored.variables[name]) for name in time_variables(stored)}
        stored.to_netcdf(
            self._path,
            mode="a",
            engine=_ENGINE,
            encoding=encoding,
            unlimited_dims=["time"],
            group=self._group,
        )

    def _extend(self, block: xr.Dataset, names: list[str]) -> None:
        frames = block.sizes["time"]
        with h5netcdf.File(self._path, "a") as whole:
            file = self._inside(whole)
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


class ScratchFile(BlockFile):
    """A file of blocks that nobody keeps: it goes when the dataset that is read from it does.

    Parameters
    ----------
    folder
        Folder in which it lies; that for temporary files when ``None``.
    """

    def __init__(self, folder: Path | None) -> None:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        self._place = TemporaryDirectory(prefix=f"{_SCRATCH}{os.getpid()}-", dir=folder)
        super().__init__(Path(self._place.name, "blocks.nc"))

    @staticmethod
    def clear(folder: Path) -> None:
        """Removes the files of other processes, which were cut short.

        Parameters
        ----------
        folder
            A folder that this process has for itself.
        """
        for left in folder.glob(f"{_SCRATCH}*"):
            if not left.name.startswith(f"{_SCRATCH}{os.getpid()}-"):
                rmtree(left, ignore_errors=True)

    def finish(self, rest: xr.Dataset) -> xr.Dataset:
        """The whole dataset; see `BlockFile.finish`.

        Parameters
        ----------
        rest
            As there.
        """
        whole = super().finish(rest).assign_attrs(rest.attrs)  # which a file gives back as plain lists and text
        whole.encoding["place"] = self._place
        return whole


class JoinedBlocks:
    """Blocks of frames as one dataset: in memory, or in a `ScratchFile` where they are long.

    Parameters
    ----------
    folder
        Where that file lies, as there.

    Examples
    --------
    >>> joined = JoinedBlocks(None)
    >>> for begin_s in (0.0, 2.0):
    ...     time_s = begin_s + np.arange(2)
    ...     joined.append(xr.Dataset({"level": ("time", time_s**2)}, coords={"time": time_s}))
    >>> joined.finish(xr.Dataset(attrs={"gauge": "north"}))["level"].values.tolist()
    [0.0, 1.0, 4.0, 9.0]
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._open: list[xr.Dataset] = []
        self._bytes = 0
        self._file: ScratchFile | None = None

    def append(self, block: xr.Dataset) -> None:
        """Adds the variables of a block that have the dim ``time``; see `BlockFile.append`.

        Parameters
        ----------
        block
            As there.
        """
        along = block[time_variables(block)]
        if self._file is None:
            self._open.append(along)
            self._bytes += along.nbytes
            if self._bytes > LONG_BYTES:
                self._file = ScratchFile(self._folder)
                for one in self._open:
                    self._file.append(one)
                self._open.clear()
        else:
            self._file.append(along)

    def finish(self, rest: xr.Dataset) -> xr.Dataset:
        """The whole dataset.

        Parameters
        ----------
        rest
            All variables without the dim ``time``, and the attributes.
        """
        if self._file is not None:
            return self._file.finish(rest)
        joined, first = {}, self._open[0]
        for name in time_variables(first):
            one = first[name]
            parts = [block[name].values for block in self._open]
            joined[name] = (one.dims, np.concatenate(parts, axis=one.dims.index("time")), one.attrs)
        return rest.assign(joined).set_coords(list(first.coords))


def cannot_write(path: Path, error: OSError) -> ResultsError:
    """The error of a file that cannot be written, in words.

    Parameters
    ----------
    path
        The file.
    error
        What the system said.
    """
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
