"""Labelled data to netCDF and back without loss: any dataset, ``tracks.nc`` and ``displacement.nc``."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import check_displacement, check_points, check_tracks
from vfm_sdm.core.files import write_file
from vfm_sdm.errors import DatasetError, ResultsError

__all__ = [
    "read_dataset",
    "read_displacement",
    "read_points",
    "read_tracks",
    "storable",
    "write_dataset",
    "write_displacement",
    "write_points",
    "write_tracks",
]

_ENGINE: Final = "h5netcdf"
_JSON = "json:"
_SEAL: Final = b"\nvfm-sdm sha256 "
_DIGITS: Final = 64
_READ_ERRORS = (OSError, ValueError, LookupError, RuntimeError, TypeError, AttributeError, AssertionError)
"""Errors of xarray, h5netcdf and HDF5 on files that are damaged or hold something else."""


def write_dataset(path: Path | str, dataset: xr.Dataset) -> Path:
    """Writes any labelled dataset as compressed netCDF; returns its path.

    Parameters
    ----------
    path
        The file to make or replace; its folder is made when absent.
    dataset
        Dataset with variables of any shape and unit, such as px or mm. Attributes may be text, numbers, lists, ``None``
        and tables of these; see `storable`.

    Raises
    ------
    ResultsError
        The file cannot be written, or an attribute cannot be stored.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> dataset = xr.Dataset({"length": ("bay", [2.4, 2.4], {"units": "m"})}, attrs={"notes": ["measured", None]})
    >>> with TemporaryDirectory() as folder:
    ...     path = write_dataset(f"{folder}/lengths.nc", dataset)
    ...     print(read_dataset(path, lambda found: found, kind="lengths", command="make").attrs)
    {'notes': ['measured', None]}
    """
    stored = storable(dataset)
    content = stored.to_netcdf(engine=_ENGINE, encoding=_choose_compression(stored))
    return write_file(path, _sealed(content))


def read_dataset(path: Path | str, check: Callable[[xr.Dataset], xr.Dataset], *, kind: str, command: str) -> xr.Dataset:
    """A dataset as written by `write_dataset`, fully loaded and checked.

    Parameters
    ----------
    path
        The file.
    check
        Function that returns the dataset, or raises a `DatasetError` where it is not of the expected kind.
    kind, command
        Kind of the dataset, and the command that makes it; for messages.

    Raises
    ------
    ResultsError
        The file is missing, damaged or holds something else.
    """
    with (
        _open_sealed(Path(path), kind, command) as stream,
        xr.open_dataset(stream, engine=_ENGINE, decode_times=False) as dataset,
    ):
        return check(_restore(dataset.load()))


def write_tracks(folder: Path | str, tracks_by_view: Mapping[str, xr.Dataset]) -> Path:
    """Writes ``tracks.nc`` with one netCDF group for each view, in the order given.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    tracks_by_view
        Tracks by view, shape (T, P, 2) [px], each with its own clock.

    Raises
    ------
    ResultsError
        The file cannot be written, a view's name holds a slash, or an attribute cannot be stored.
    DatasetError
        A dataset does not hold tracks.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> tracks = make_tracks([0.0, 0.1], ["mid"], np.zeros((2, 1, 2)), np.zeros((2, 1, 2, 2)), [[0], [0]], attrs={})
    >>> with TemporaryDirectory() as folder:
    ...     print(list(read_tracks(write_tracks(folder, {"left": tracks, "right": tracks}))))
    ['left', 'right']
    """
    target = Path(folder) / "tracks.nc"
    if not tracks_by_view:
        raise ResultsError(f"{target}: expected tracks of at least one view, got none; track a view first")
    for name in tracks_by_view:
        if not name or "/" in name or name == ".":
            raise ResultsError(f"{target}: expected view names without slashes, got {name!r}; rename the view")
    groups = {f"/{name}": storable(check_tracks(tracks)) for name, tracks in tracks_by_view.items()}
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"views": _JSON + json.dumps(list(tracks_by_view))}), **groups})
    encoding: dict[str, Any] = {name: _choose_compression(group) for name, group in groups.items()}
    return write_file(target, _sealed(tree.to_netcdf(engine=_ENGINE, encoding=encoding)))


def read_tracks(path: Path | str) -> dict[str, xr.Dataset]:
    """Tracks by view name, as written by `write_tracks`, fully loaded.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Returns
    -------
    tracks
        Tracks by view, shape (T, P, 2) [px].

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold tracks.
    """
    file = _find_file(path, "tracks.nc")
    with (
        _open_sealed(file, "tracks", "vfm-sdm track") as stream,
        xr.open_datatree(stream, engine=_ENGINE, decode_times=False) as tree,
    ):
        views = _decode(tree.attrs).get("views", list(tree.children))
        return {name: check_tracks(_restore(tree.children[name].to_dataset().load())) for name in views}


def write_points(folder: Path | str, points: xr.Dataset) -> Path:
    """Writes ``points.nc``; returns its path.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    points
        Points dataset, shape (V, P, 2) [px].

    Raises
    ------
    ResultsError
        The file cannot be written.
    DatasetError
        The dataset does not hold points.
    """
    return write_dataset(Path(folder) / "points.nc", check_points(points))


def read_points(path: Path | str) -> xr.Dataset:
    """The points dataset as written by `write_points`, fully loaded.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Returns
    -------
    points
        Points dataset, shape (V, P, 2) [px].

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold points.
    """
    return read_dataset(_find_file(path, "points.nc"), check_points, kind="points", command="vfm-sdm cameras")


def write_displacement(folder: Path | str, displacement: xr.Dataset) -> Path:
    """Writes ``displacement.nc``; returns its path.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    displacement
        Displacement dataset, shape (T, P, 3) [mm]. Attributes may be text, numbers, lists, ``None`` and tables of
        these.

    Raises
    ------
    ResultsError
        The file cannot be written, or an attribute cannot be stored.
    DatasetError
        The dataset does not hold displacement.
    """
    return write_dataset(Path(folder) / "displacement.nc", check_displacement(displacement))


def read_displacement(path: Path | str) -> xr.Dataset:
    """The displacement dataset as written by `write_displacement`, fully loaded.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Returns
    -------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold displacement.
    """
    file = _find_file(path, "displacement.nc")
    return read_dataset(file, check_displacement, kind="displacement", command="vfm-sdm measure")


def _find_file(path: Path | str, name: str) -> Path:
    return Path(path) / name if Path(path).is_dir() else Path(path)


@contextmanager
def _open_sealed(file: Path, kind: str, command: str) -> Iterator[BytesIO]:
    """A whole file in memory; errors of reading it become errors of the result that it should hold.

    HDF5 can loop for ever on a file of which a page was lost, so nothing is given to it that is not as it was written.
    """
    try:
        content = file.read_bytes()
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise ResultsError(f"{file}: expected {kind}, got no such file; check the folder or run `{command}`") from None
    except (OSError, ValueError) as error:
        raise ResultsError(f"{file}: expected {kind} that can be read, got: {error}; check the path") from error
    try:
        with BytesIO(_unsealed(content)) as stream:
            yield stream
    except DatasetError as error:
        raise ResultsError(f"{file}: expected {kind}, got something else ({error}); run `{command}` again") from error
    except _READ_ERRORS as error:
        raise ResultsError(f"{file}: expected {kind}, got a damaged file ({error}); run `{command}` again") from error


def _sealed(content: bytes | memoryview) -> bytes:
    """A netCDF file with its SHA-256 behind its end, which readers of HDF5 do not look at."""
    return bytes(content) + _SEAL + hashlib.sha256(content).hexdigest().encode()


def _unsealed(content: bytes) -> bytes:
    """The netCDF file of a sealed one; of other programs' files, which have no seal, the file as it is."""
    inside, seal, digest = content[:-_DIGITS], content[-_DIGITS - len(_SEAL) : -_DIGITS], content[-_DIGITS:]
    if seal != _SEAL:
        return content
    inside = inside[: -len(_SEAL)]
    if hashlib.sha256(inside).hexdigest().encode() != digest:
        raise ValueError("its content is not what was written")
    return inside


def _choose_compression(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    return {
        str(name): {"zlib": True, "complevel": 1, "shuffle": True}
        for name, variable in dataset.data_vars.items()
        if variable.size > 1 and variable.dtype.kind in "iufb"
    }


def storable(dataset: xr.Dataset) -> xr.Dataset:
    """A copy whose attributes netCDF can hold, without the encoding of an earlier file.

    Parameters
    ----------
    dataset
        Dataset with variables of any shape.

    Raises
    ------
    ResultsError
        An attribute cannot be stored.

    Examples
    --------
    >>> storable(xr.Dataset(attrs={"weights": None})).attrs
    {'weights': 'json:null'}
    """
    copy = dataset.drop_encoding().copy()
    copy.attrs = _encode(dataset.attrs)
    for name in copy.variables:
        copy[name].attrs = _encode(dataset[name].attrs)
    return copy


def _restore(dataset: xr.Dataset) -> xr.Dataset:
    copy = dataset.copy()
    copy.attrs = _decode(copy.attrs)
    for name in copy.variables:
        copy[name].attrs = _decode(copy[name].attrs)
    return copy


def _encode(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as netCDF knows them: text and numbers as they are, everything else as JSON text."""
    encoded: dict[str, Any] = {}
    for key, value in attrs.items():
        if (isinstance(value, str) and not value.startswith(_JSON)) or _is_native_number(value):
            # As plain text: h5py knows no subclasses of it, such as statuses.
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


def _decode(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    return {
        str(key): json.loads(value.removeprefix(_JSON)) if isinstance(value, str) and value.startswith(_JSON) else value
        for key, value in attrs.items()
    }
