"""What netCDF files hold beside arrays: attributes of any kind, and a seal that shows damage."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr

from vfm_sdm.core.files import file_hash
from vfm_sdm.errors import ResultsError

__all__ = ["JSON", "check_seal", "decoded", "restored", "seal_file", "sealed", "storable", "unsealed"]

JSON: Final = "json:"
"""Beginning of attributes that are tables, lists or nothing."""
_SEAL: Final = b"\nvfm-sdm sha256 "
_DIGITS: Final = 64
_READ_BYTES: Final = 1 << 22


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


def restored(dataset: xr.Dataset) -> xr.Dataset:
    """A copy with the attributes that `storable` was given.

    Parameters
    ----------
    dataset
        Dataset as it stands in a file; variables of any shape and unit.
    """
    copy = dataset.copy()
    copy.attrs = decoded(copy.attrs)
    for name in copy.variables:
        copy[name].attrs = decoded(copy[name].attrs)
    return copy


def _encode(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as netCDF knows them: text and numbers as they are, everything else as JSON text."""
    encoded: dict[str, Any] = {}
    for key, value in attrs.items():
        if (isinstance(value, str) and not value.startswith(JSON)) or _is_native_number(value):
            # As plain text: h5py knows no subclasses of it, such as statuses.
            encoded[str(key)] = str(value) if isinstance(value, str) else value
            continue
        try:
            encoded[str(key)] = JSON + json.dumps(value, default=_plain)
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


def decoded(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as `storable` was given them.

    Parameters
    ----------
    attrs
        Attributes as they stand in a file.
    """
    return {
        str(key): json.loads(value.removeprefix(JSON)) if isinstance(value, str) and value.startswith(JSON) else value
        for key, value in attrs.items()
    }


def sealed(content: bytes | memoryview) -> bytes:
    """A netCDF file with its SHA-256 behind its end, which readers of HDF5 do not look at.

    Parameters
    ----------
    content
        The file.
    """
    return bytes(content) + _SEAL + hashlib.sha256(content).hexdigest().encode()


def unsealed(content: bytes) -> bytes:
    """The netCDF file of a sealed one; of other programs' files, which have no seal, the file as it is.

    Parameters
    ----------
    content
        The sealed file.

    Raises
    ------
    ValueError
        Its content is not what was written.
    """
    inside, seal, digest = content[:-_DIGITS], content[-_DIGITS - len(_SEAL) : -_DIGITS], content[-_DIGITS:]
    if seal != _SEAL:
        return content
    inside = inside[: -len(_SEAL)]
    if hashlib.sha256(inside).hexdigest().encode() != digest:
        raise ValueError("its content is not what was written")
    return inside


def seal_file(path: Path) -> None:
    """Seals a file that is too large for memory, see `sealed`.

    Parameters
    ----------
    path
        The file.
    """
    digest = file_hash(path)
    with path.open("ab") as stream:
        stream.write(_SEAL + digest.encode())


def check_seal(path: Path) -> None:
    """Looks whether a sealed file is as it was written; one without a seal may be anything.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    ValueError
        Its content is not what was written.
    """
    size, end = path.stat().st_size, len(_SEAL) + _DIGITS
    with path.open("rb") as stream:
        stream.seek(max(size - end, 0))
        seal = stream.read()
    if not seal.startswith(_SEAL):
        return
    digest, left = hashlib.sha256(), size - end
    with path.open("rb") as stream:
        while left and (part := stream.read(min(_READ_BYTES, left))):
            digest.update(part)
            left -= len(part)
    if digest.hexdigest().encode() != seal[len(_SEAL) :]:
        raise ValueError("its content is not what was written")
