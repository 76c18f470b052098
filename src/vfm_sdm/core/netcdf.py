"""Labelled data to netCDF and back without loss: any dataset, ``tracks.nc`` and ``displacement.nc``."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import check_displacement, check_points, check_tracks
from vfm_sdm.core.files import replace_file
from vfm_sdm.errors import DatasetError, ResultsError

__all__ = [
    "read_displacement",
    "read_points",
    "read_tracks",
    "storable",
    "write_displacement",
    "write_points",
    "write_tracks",
]

_ENGINE: Final = "h5netcdf"
_JSON = "json:"
_READ_ERRORS = (OSError, ValueError, KeyError, RuntimeError, TypeError)
"""What xarray, h5netcdf and HDF5 raise on files that are damaged or hold something else."""


def write_tracks(folder: Path | str, tracks_by_view: Mapping[str, xr.Dataset]) -> Path:
    """Writes ``tracks.nc`` with one netCDF group a view, in the order given.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    tracks_by_view
        One tracks dataset a view (see `vfm_sdm.core.datasets`), each with its own clock.

    Raises
    ------
    ResultsError
        The file cannot be written, a view's name holds a slash, or an attribute cannot be stored.
    DatasetError
        A dataset does not hold tracks.
    """
    target = Path(folder) / "tracks.nc"
    if not tracks_by_view:
        raise ResultsError(f"{target}: expected tracks of at least one view, got none; track a view first")
    for name in tracks_by_view:
        if not name or "/" in name or name == ".":
            raise ResultsError(f"{target}: expected view names without slashes, got {name!r}; rename the view")
    groups = {f"/{name}": storable(check_tracks(tracks)) for name, tracks in tracks_by_view.items()}
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"views": _JSON + json.dumps(list(tracks_by_view))}), **groups})
    encoding: dict[str, Any] = {name: _compression(group) for name, group in groups.items()}
    _write(target, lambda path: tree.to_netcdf(path, engine=_ENGINE, encoding=encoding))
    return target


def read_tracks(path: Path | str) -> dict[str, xr.Dataset]:
    """Tracks by view name, as written by `write_tracks`, fully loaded.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold tracks.
    """
    source = _file_in(path, "tracks.nc", "vfm-sdm track")
    try:
        with xr.open_datatree(source, engine=_ENGINE, decode_times=False) as tree:
            views = _decoded(tree.attrs).get("views", list(tree.children))
            return {name: check_tracks(_restored(tree.children[name].to_dataset().load())) for name in views}
    except DatasetError as error:
        raise ResultsError(f"{source}: expected tracks, got something else ({error}); run `vfm-sdm track`") from error
    except _READ_ERRORS as error:
        raise ResultsError(f"{source}: expected tracks, got a damaged file ({error}); run `vfm-sdm track`") from error


def write_points(folder: Path | str, points: xr.Dataset) -> Path:
    """Writes ``points.nc``; returns its path.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    points
        See `vfm_sdm.core.datasets`.

    Raises
    ------
    ResultsError
        The file cannot be written.
    DatasetError
        The dataset does not hold points.
    """
    target = Path(folder) / "points.nc"
    dataset = storable(check_points(points))
    _write(target, lambda path: dataset.to_netcdf(path, engine=_ENGINE))
    return target


def read_points(path: Path | str) -> xr.Dataset:
    """The points dataset as written by `write_points`, fully loaded.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold points.
    """
    source = _file_in(path, "points.nc", "vfm-sdm cameras")
    again = "run `vfm-sdm cameras` again"
    try:
        with xr.open_dataset(source, engine=_ENGINE, decode_times=False) as dataset:
            return check_points(_restored(dataset.load()))
    except DatasetError as error:
        raise ResultsError(f"{source}: expected points, got something else ({error}); {again}") from error
    except _READ_ERRORS as error:
        raise ResultsError(f"{source}: expected points, got a damaged file ({error}); {again}") from error


def write_displacement(folder: Path | str, displacement: xr.Dataset) -> Path:
    """Writes ``displacement.nc``; returns its path.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    displacement
        See `vfm_sdm.core.datasets`. Attributes may be text, numbers, lists, ``None`` and tables of these.

    Raises
    ------
    ResultsError
        The file cannot be written, or an attribute cannot be stored.
    DatasetError
        The dataset does not hold displacement.
    """
    target = Path(folder) / "displacement.nc"
    dataset = storable(check_displacement(displacement))
    _write(target, lambda path: dataset.to_netcdf(path, engine=_ENGINE, encoding=_compression(dataset)))
    return target


def read_displacement(path: Path | str) -> xr.Dataset:
    """The displacement dataset as written by `write_displacement`, fully loaded.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold displacement.
    """
    source = _file_in(path, "displacement.nc", "vfm-sdm measure")
    again = "run `vfm-sdm measure` again"
    try:
        with xr.open_dataset(source, engine=_ENGINE, decode_times=False) as dataset:
            return check_displacement(_restored(dataset.load()))
    except DatasetError as error:
        raise ResultsError(f"{source}: expected displacement, got something else ({error}); {again}") from error
    except _READ_ERRORS as error:
        raise ResultsError(f"{source}: expected displacement, got a damaged file ({error}); {again}") from error


def _file_in(path: Path | str, name: str, command: str) -> Path:
    source = Path(path) / name if Path(path).is_dir() else Path(path)
    if not source.is_file():
        raise ResultsError(f"{source}: expected a result, got no such file; check the folder or run `{command}`")
    return source


def _write(target: Path, write: Callable[[Path], object]) -> None:
    try:
        with replace_file(target) as temporary:
            write(temporary)
    except OSError as error:
        raise ResultsError(f"{target}: expected to write it, got: {error}; free space or choose a folder") from error


def _compression(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    return {
        str(name): {"zlib": True, "complevel": 1, "shuffle": True}
        for name, variable in dataset.data_vars.items()
        if variable.ndim and variable.size and variable.dtype.kind != "O"
    }


def storable(dataset: xr.Dataset) -> xr.Dataset:
    """A copy whose attributes netCDF can hold, without hints from an earlier file.

    Raises
    ------
    ResultsError
        An attribute cannot be stored.
    """
    copy = dataset.drop_encoding().copy()
    copy.attrs = _encoded(dataset.attrs)
    for name in copy.variables:
        copy[name].attrs = _encoded(dataset[name].attrs)
    return copy


def _restored(dataset: xr.Dataset) -> xr.Dataset:
    copy = dataset.copy()
    copy.attrs = _decoded(copy.attrs)
    for name in copy.variables:
        copy[name].attrs = _decoded(copy[name].attrs)
    return copy


def _encoded(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as netCDF knows them: text and numbers as they are, everything else as JSON text."""
    encoded: dict[str, Any] = {}
    for key, value in attrs.items():
        if (isinstance(value, str) and not value.startswith(_JSON)) or _is_native_number(value):
            # A member of a StrEnum is text, but HDF5 does not know it as such.
            encoded[str(key)] = str(value) if isinstance(value, str) else value
            continue
        try:
            encoded[str(key)] = _JSON + json.dumps(value, default=_plain)
        except (TypeError, ValueError) as error:
            raise ResultsError(
                f"attribute {key!r}: expected text, a number or a list of them, got {type(value).__name__}; convert it"
            ) from error
    return encoded


def _is_native_number(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        # A single-element array would come back as a scalar.
        return value.ndim == 1 and value.size > 1 and value.dtype.kind in "iuf"
    if isinstance(value, int) and not isinstance(value, bool):
        return bool(np.iinfo(np.int64).min <= value <= np.iinfo(np.int64).max)
    return isinstance(value, float | np.integer | np.floating)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(type(value).__name__)


def _decoded(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    return {
        str(key): json.loads(value.removeprefix(_JSON)) if isinstance(value, str) and value.startswith(_JSON) else value
        for key, value in attrs.items()
    }
