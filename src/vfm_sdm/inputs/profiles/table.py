"""The table of lens profiles: calibrations of consumer cameras, grouped, as it comes with the package.

Made by ``tools/lens_profiles.py`` from 9,810 calibrations that users of a public program share under CC0. A group holds
what independent calibrators found for one camera, mode, picture format and state of stabilisation.
"""

import csv
import gzip
import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray

__all__ = ["SCATTER", "TABLE", "ProfileTable", "Scatter", "read_scatter", "read_table"]

TABLE, SCATTER = "profiles.csv.gz", "scatter.json"
_SHA256 = {
    TABLE: "025393e299f0ec31c911a2728485df88324652bb472e827486c693e26ecd6d54",
    SCATTER: "8c1f20852ad09e81018c96809ee8377295e96022acdb45b72d8be6dbc1f80b8f",
}
"""What the files hold; here, because the text of this module is part of the keys of what is made with them."""

_Words = npt.NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class ProfileTable:
    """Groups of calibrations, G of them, one a row.

    Parameters
    ----------
    kind, brand, model, mode, film, aspect, stabilised
        What the calibrations of a group share, shape (G,) each: `CameraClass`, names as
        `vfm_sdm.inputs.profiles.words.plain` gives them, words of `Setting` (``film`` in whole millimetres, ``0`` for
        none; ``stabilised`` is ``on``, ``off`` or empty).
    name
        Name of the camera as most calibrators wrote it, shape (G,).
    order
        Radial coefficients that describe the lens, 1 to 3, and 0 where three do not, shape (G,).
    calibrators
        Number of independent calibrators, shape (G,).
    log_focal, log_focal_squares
        Mean of the logarithm of focal length over longer side, and sum of the squared deviations of the calibrators
        from it, shape (G,) [1].
    corner, corner_squares
        Radial coefficients ``k_i c^2i`` at the radius c of the picture's corner over the focal length, shape (G, 3),
        and the sum of squared deviations of the first one, shape (G,) [1].
    residual
        Root mean square of what the coefficients leave over the picture, over its longer side, shape (G,) [1].
    readout_ms
        Time in which the sensor is read, shape (G,) [ms]; 0 where nobody says.
    """

    kind: _Words
    brand: _Words
    model: _Words
    name: _Words
    mode: _Words
    film: _Words
    aspect: _Words
    stabilised: _Words
    order: npt.NDArray[np.int64]
    calibrators: FloatArray
    log_focal: FloatArray
    log_focal_squares: FloatArray
    corner: FloatArray
    corner_squares: FloatArray
    residual: FloatArray
    readout_ms: FloatArray

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def film_mm(self) -> FloatArray:
        """Named focal length of each group, shape (G,) [mm]; 0 for none."""
        return self.film.astype(np.float64)

    def same(self, shared: Mapping[str, str]) -> npt.NDArray[np.bool_]:
        """Groups that have these words in these columns, shape (G,).

        Parameters
        ----------
        shared
            Words by the name of their column.

        Examples
        --------
        >>> bool(read_table().same({"brand": "gopro", "mode": "linear"}).sum() > 10)
        True
        """
        agree = np.ones(len(self), dtype=bool)
        for column, word in shared.items():
            agree &= getattr(self, column) == word
        return agree

    @classmethod
    def from_rows(cls, rows: Sequence[Mapping[str, Any]]) -> "ProfileTable":
        """The table of rows as they stand in the file.

        Parameters
        ----------
        rows
            Values by column, as text or numbers; the three coefficients in ``corner1`` to ``corner3``.
        """
        words = ("kind", "brand", "model", "name", "mode", "film", "aspect", "stabilised")
        columns: dict[str, Any] = {name: np.array([str(row[name]) for row in rows]) for name in words}
        columns["order"] = np.array([int(row["order"]) for row in rows])
        columns["corner"] = np.array([[float(row[f"corner{n}"]) for n in (1, 2, 3)] for row in rows])
        for field in fields(cls):
            if field.name not in columns:
                columns[field.name] = np.array([float(row[field.name]) for row in rows])
        return cls(**columns)


@dataclass(frozen=True)
class Scatter:
    """How much lenses of one kind differ, level by level, found by leaving calibrators out.

    Parameters
    ----------
    levels
        Standard deviation of the means of groups about that of the group above them, by the level's name [1].
    own
        Standard deviation of calibrators about the mean of their group [1].
    freedom
        Degrees of freedom with which `own` counts beside what a group itself shows.
    widen
        Factor on the standard deviation that makes 1.96 of them hold in 95 of 100, where the state of stabilisation is
        known (``known``), where not (``unknown``), and where the table does not have the model (``unseen``).
    """

    levels: Mapping[str, float]
    own: float
    freedom: float
    widen: Mapping[str, float]


def _read(name: str) -> bytes:
    content = files("vfm_sdm.inputs.profiles").joinpath(name).read_bytes()
    if hashlib.sha256(content).hexdigest() != _SHA256[name]:
        raise OSError(f"{name}: expected the file that this version was made with, got another; install it again")
    return content


@cache
def read_table() -> ProfileTable:
    """The table that comes with the package, read once.

    Raises
    ------
    OSError
        The file of the package is damaged.

    Examples
    --------
    >>> len(read_table()) > 1000
    True
    """
    text = gzip.decompress(_read(TABLE)).decode("utf-8")
    return ProfileTable.from_rows(list(csv.DictReader(io.StringIO(text))))


@cache
def read_scatter() -> dict[str, dict[str, Scatter]]:
    """Scatter of lenses by kind of camera and by what is known of the mode, as it comes with the package.

    Raises
    ------
    OSError
        The file of the package is damaged.

    Examples
    --------
    >>> sorted(read_scatter()["phone"])
    ['any', 'class', 'corner', 'film', 'mode']
    """
    found = json.loads(_read(SCATTER))
    return {kind: {name: Scatter(**one) for name, one in chains.items()} for kind, chains in found.items()}
