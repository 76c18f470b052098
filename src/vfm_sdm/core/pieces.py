"""Pieces of a product in the making, kept so that a run that is cut short loses little."""

import re
from contextlib import suppress
from pathlib import Path

import xarray as xr

from vfm_sdm.core.files import remove_orphans
from vfm_sdm.core.netcdf import read_dataset, write_dataset
from vfm_sdm.errors import ResultsError

__all__ = ["Pieces"]

_PIECE = re.compile(r"\d+/\d{4,}\.nc")


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
        with suppress(ResultsError):
            found = read_dataset(
                self._path(group, number), _unchecked, kind="a part of a product", command="vfm-sdm measure"
            )
            if found.attrs.pop("piece_of", None) == self._key:
                return found
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
        write_dataset(self._path(group, number), piece.assign_attrs(piece_of=self._key))

    def tidy(self) -> None:
        """Removes what a run that was cut short had not finished writing."""
        for folder in self._folder.glob("*/"):
            remove_orphans(folder)

    def clear(self) -> None:
        """Removes all pieces, and the folder where there is nothing else in it."""
        for piece in [path for path in self._folder.glob("*/*.nc") if _PIECE.fullmatch("/".join(path.parts[-2:]))]:
            piece.unlink(missing_ok=True)
        for folder in (*self._folder.glob("*/"), self._folder):
            with suppress(OSError):  # somebody keeps something there
                folder.rmdir()

    def _path(self, group: int, number: int) -> Path:
        # Names, such as of views, may be no names of files, or one where case does not count.
        return self._folder / str(group) / f"{number:04d}.nc"


def _unchecked(found: xr.Dataset) -> xr.Dataset:
    return found
