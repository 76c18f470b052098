"""Pieces of a product in the making, kept so that a run that is cut short loses little."""

import json
import re
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.files import remove_orphans, write_file
from vfm_sdm.core.stored import sealed, unsealed

__all__ = ["Pieces"]

_PIECE = re.compile(r"\d+/\d{4,}\.npz")


class Pieces:
    """Files of pieces, in a folder that goes when the product is whole and nothing else is in it.

    Parameters
    ----------
    folder
        The folder; it need not exist.
    key
        Key of what the product is made of: pieces of others are not taken for its own.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     Pieces(Path(folder, "tracks"), "a1").write(0, 7, xr.Dataset({"status": ("time", [0, 1])}))
    ...     found = Pieces(Path(folder, "tracks"), "a1").read(0, 7)
    ...     print(found["status"].values.tolist(), Pieces(Path(folder, "tracks"), "b2").read(0, 7))
    [0, 1] None
    """

    def __init__(self, folder: Path, key: str) -> None:
        self._folder, self._key = folder, key

    def read(self, group: int, number: int) -> xr.Dataset | None:
        """A piece; ``None`` where there is none of the same product, or a damaged one.

        Parameters
        ----------
        group, number
            Number of the group, such as of a view, and of the piece in it.
        """
        with suppress(OSError, ValueError):
            content = self._path(group, number).read_bytes()
            inside = unsealed(content)
            return None if inside is content else _unpack(inside, self._key)
        return None

    def write(self, group: int, number: int, piece: xr.Dataset) -> None:
        """Keeps a piece.

        Parameters
        ----------
        group, number
            As of `read`.
        piece
            Variables of any shape and unit, such as px.

        Raises
        ------
        ResultsError
            The file cannot be written.
        """
        write_file(self._path(group, number), sealed(_pack(piece, self._key)))

    def tidy(self) -> None:
        """Removes what a run that was cut short had not finished writing."""
        for folder in self._folder.glob("*/"):
            remove_orphans(folder)

    def clear(self) -> None:
        """Removes all pieces, and the folder where there is nothing else in it."""
        for piece in [path for path in self._folder.glob("*/*.npz") if _PIECE.fullmatch("/".join(path.parts[-2:]))]:
            piece.unlink(missing_ok=True)
        for folder in (*self._folder.glob("*/"), self._folder):
            with suppress(OSError):  # somebody keeps something there
                folder.rmdir()

    def _path(self, group: int, number: int) -> Path:
        # Names, such as of views, may be no names of files, or one where case does not count.
        return self._folder / str(group) / f"{number:04d}.npz"


def _pack(piece: xr.Dataset, key: str) -> memoryview:
    """A piece as arrays of NumPy: netCDF takes many times as long for twenty small variables."""
    variables = {str(name): [one.dims, one.attrs] for name, one in piece.variables.items()}
    about = {"key": key, "variables": variables, "coords": list(piece.coords), "attrs": piece.attrs}
    arrays = {f"of {name}": piece[name].values for name in variables}
    content = BytesIO()
    np.savez(content, allow_pickle=False, about=np.array(json.dumps(about, default=_as_plain)), **arrays)
    return content.getbuffer()


def _unpack(content: bytes, key: str) -> xr.Dataset | None:
    """The piece of `_pack`; ``None`` where it is one of another product."""
    with np.load(BytesIO(content), allow_pickle=False) as arrays:
        about = json.loads(arrays["about"].item())
        if about["key"] != key:
            return None
        variables = {
            name: xr.Variable(dims, arrays[f"of {name}"], attrs) for name, (dims, attrs) in about["variables"].items()
        }
    return xr.Dataset(variables, attrs=about["attrs"]).set_coords(about["coords"])


def _as_plain(value: np.generic | np.ndarray) -> object:
    return value.tolist()
