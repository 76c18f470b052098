"""Pieces of a product in the making, kept so that a run that is cut short loses little."""

from contextlib import suppress
from pathlib import Path
from shutil import rmtree

import xarray as xr

from vfm_sdm.core.files import remove_orphans
from vfm_sdm.core.netcdf import read_dataset, write_dataset
from vfm_sdm.errors import ResultsError

__all__ = ["Pieces"]


class Pieces:
    """Files of pieces, in a folder that goes when the product is whole.

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
    ...     Pieces(Path(folder, "tracks"), "a1").write("left/0000", xr.Dataset({"status": ("time", [0, 1])}))
    ...     found = Pieces(Path(folder, "tracks"), "a1").read("left/0000")
    ...     print(found["status"].values.tolist(), Pieces(Path(folder, "tracks"), "b2").read("left/0000"))
    [0, 1] None
    """

    def __init__(self, folder: Path, key: str) -> None:
        self._folder, self._key = folder, key

    def read(self, name: str) -> xr.Dataset | None:
        """A piece; ``None`` where there is none of the same product, or a damaged one.

        Parameters
        ----------
        name
            Its name.
        """
        with suppress(ResultsError):
            found = read_dataset(self._path(name), _unchecked, kind="a part of a product", command="vfm-sdm measure")
            if found.attrs.pop("piece_of", None) == self._key:
                return found
        return None

    def write(self, name: str, piece: xr.Dataset) -> None:
        """Keeps a piece.

        Parameters
        ----------
        name
            Its name.
        piece
            Variables of any shape and unit, such as px.

        Raises
        ------
        ResultsError
            The file cannot be written.
        """
        write_dataset(self._path(name), piece.assign_attrs(piece_of=self._key))

    def tidy(self) -> None:
        """Removes what a run that was cut short had not finished writing."""
        for folder in self._folder.glob("*/"):
            remove_orphans(folder)

    def clear(self) -> None:
        """Removes all pieces."""
        rmtree(self._folder, ignore_errors=True)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.nc"


def _unchecked(found: xr.Dataset) -> xr.Dataset:
    return found
