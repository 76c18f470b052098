"""Labelled data to netCDF and back without loss: any dataset, ``tracks.nc`` and ``displacement.nc``."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import xarray as xr

from vfm_sdm.core.block_files import LONG_BYTES, BlockFile, cannot_write
from vfm_sdm.core.cf import CONVENTIONS, described, undescribed
from vfm_sdm.core.datasets import check_displacement, check_points, check_tracks
from vfm_sdm.core.files import csv_text, replace_file, write_file
from vfm_sdm.core.stored import JSON, check_seal, decoded, restored, seal_file, sealed, storable, unsealed
from vfm_sdm.errors import DatasetError, ResultsError

__all__ = [
    "open_displacement",
    "open_tracks",
    "read_dataset",
    "read_displacement",
    "read_if_there",
    "read_points",
    "read_tracks",
    "write_dataset",
    "write_displacement",
    "write_points",
    "write_tracks",
    "write_with_table",
]

_ENGINE: Final = "h5netcdf"
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
    dataset = described(dataset)
    stored = storable(dataset)
    if stored.nbytes > LONG_BYTES and "time" in stored.dims:
        return _write_in_blocks(Path(path), xr.Dataset(), {None: dataset})
    content = stored.to_netcdf(engine=_ENGINE, encoding=_choose_compression(stored))
    return write_file(path, sealed(content))


def write_with_table(
    path: Path | str, dataset: xr.Dataset, header: Sequence[str], rows: Iterable[Sequence[object]]
) -> list[Path]:
    """Writes a dataset, and beside it a table of it for people as ``.csv``; returns both paths.

    Parameters
    ----------
    path
        The netCDF file to make or replace; see `write_dataset`.
    dataset
        The dataset.
    header, rows
        Names of the columns, and cells of each row; see `vfm_sdm.core.files.csv_text`.

    Raises
    ------
    ResultsError
        A file cannot be written, or an attribute cannot be stored.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> dataset = xr.Dataset({"length": ("bay", [2.4], {"units": "m"})})
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_with_table(f"{folder}/lengths.nc", dataset, ["bay", "length_m"], [[1, 2.4]])]
    ['lengths.nc', 'lengths.csv']
    """
    return [write_dataset(path, dataset), write_file(Path(path).with_suffix(".csv"), csv_text(header, rows))]


def _write_in_blocks(path: Path, head: xr.Dataset, groups: Mapping[str | None, xr.Dataset]) -> Path:
    """Writes groups of which only a part is in memory at a time, and the attributes of the whole."""
    try:
        with replace_file(path) as temporary:
            head.to_netcdf(temporary, engine=_ENGINE)
            for group, dataset in groups.items():
                BlockFile(temporary, group).write(dataset).close()
            seal_file(temporary)
    except OSError as error:
        raise cannot_write(path, error) from error
    return path


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
        return check(undescribed(restored(dataset.load())))


def read_if_there(
    path: Path | str, check: Callable[[xr.Dataset], xr.Dataset], *, kind: str, command: str
) -> xr.Dataset | None:
    """As `read_dataset`; ``None`` where there is no such file.

    Parameters
    ----------
    path, check, kind, command
        As of `read_dataset`.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    return read_dataset(path, check, kind=kind, command=command) if Path(path).exists() else None


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
    >>> import numpy as np
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
    views: dict[str | None, xr.Dataset] = {
        f"/{name}": described(check_tracks(tracks)) for name, tracks in tracks_by_view.items()
    }
    head = xr.Dataset(attrs={"Conventions": CONVENTIONS, "views": JSON + json.dumps(list(tracks_by_view))})
    if max(one.nbytes for one in views.values()) > LONG_BYTES:
        return _write_in_blocks(target, head, views)
    groups = {str(name): storable(one) for name, one in views.items()}
    encoding: dict[str, Any] = {name: _choose_compression(group) for name, group in groups.items()}
    tree = xr.DataTree.from_dict({"/": head, **groups})
    return write_file(target, sealed(tree.to_netcdf(engine=_ENGINE, encoding=encoding)))


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
        views = decoded(tree.attrs).get("views", list(tree.children))
        return {name: check_tracks(undescribed(restored(tree.children[name].to_dataset().load()))) for name in views}


def open_tracks(path: Path | str) -> dict[str, xr.Dataset]:
    """Tracks by view name, as of `read_tracks`, of which only what is looked at is read; for long recordings.

    Parameters
    ----------
    path
        A run folder or the file itself.

    Returns
    -------
    tracks
        Tracks by view, shape (T, P, 2) [px]; those of a small file are in memory.

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold tracks.
    """
    file = _find_file(path, "tracks.nc")
    if not file.is_file() or file.stat().st_size < LONG_BYTES:
        return read_tracks(file)
    with _errors_of(file, "tracks", "vfm-sdm track"):
        check_seal(file)
        with xr.open_datatree(file, engine=_ENGINE, decode_times=False) as tree:
            views = decoded(tree.attrs).get("views", list(tree.children))
        return {name: check_tracks(_open(file, f"/{name}")) for name in views}
    raise AssertionError


def open_displacement(path: Path | str) -> xr.Dataset:
    """Displacement as of `read_displacement`, of which only what is looked at is read; for long recordings.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    ResultsError
        The file is missing, damaged or does not hold displacement.
    """
    with _errors_of(Path(path), "displacement", "vfm-sdm measure"):
        return check_displacement(_open(Path(path), "/"))
    raise AssertionError


def _open(file: Path, group: str) -> xr.Dataset:
    # Without a cache: what was looked at once need not stay in memory.
    return undescribed(restored(xr.open_dataset(file, group=group, engine=_ENGINE, decode_times=False, cache=False)))


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
    with _errors_of(file, kind, command), BytesIO(unsealed(content)) as stream:
        yield stream


@contextmanager
def _errors_of(file: Path, kind: str, command: str) -> Iterator[None]:
    """Errors of reading a file become errors of the result that it should hold."""
    try:
        yield
    except DatasetError as error:
        raise ResultsError(f"{file}: expected {kind}, got something else ({error}); run `{command}` again") from error
    except _READ_ERRORS as error:
        raise ResultsError(f"{file}: expected {kind}, got a damaged file ({error}); run `{command}` again") from error


def _choose_compression(dataset: xr.Dataset) -> dict[str, dict[str, Any]]:
    return {
        str(name): {"zlib": True, "complevel": 1, "shuffle": True}
        for name, variable in dataset.data_vars.items()
        if variable.size > 1 and variable.dtype.kind in "iufb"
    }
