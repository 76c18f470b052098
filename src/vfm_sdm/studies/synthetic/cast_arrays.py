"""A scene as one camera sees it, in the plain arrays that the compiled loops read, and the constants they share."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from vfm_sdm.core.arrays import FloatArray

__all__ = [
    "BLUR_PX",
    "EDGE_PX",
    "FAST",
    "MIXED",
    "MIXED_FRONT",
    "SLACK_PX",
    "SPREAD_U",
    "SPREAD_V",
    "TABLE_STEP_M",
    "TILE",
    "CastArrays",
]

BLUR_PX = 0.8
"""Standard deviation of the Gaussian point spread that edges are seen through [px]."""
EDGE_PX = 3
"""Reach of the point spread [px]."""
SLACK_PX = 1.5 * EDGE_PX + 1.5
"""How far beyond a face's edge a ray still counts as near it [px]: the diagonal of the reach and a little."""
TILE = 8
"""Side of the squares that share a list of faces to try [px]."""
TABLE_STEP_M = 0.02
"""Distance between entries of the tables of displacements, along the structure [m]."""
MIXED, MIXED_FRONT = -2, -3
"""What a neighbourhood of pixels shows at rest, where it is not one face alone: several faces, or several of which one
stands still in front of what moves."""
FAST: Any = {"contract", "nsz", "arcp", "reassoc"}
"""What floating-point rules the compiler may bend: all but those for infinity and NaN."""
_SAMPLES = 64
"""Rays through the point spread where more than two faces meet."""
_GENERATOR = 19

Vector = tuple[float, float, float]
Tile = tuple[int, int]
Int64Array = npt.NDArray[np.int64]
FaceImage = npt.NDArray[np.int16]
LumaImage = npt.NDArray[np.float32]
Coefficients = npt.NDArray[np.float32]
PlainArrays = tuple[FloatArray, Int64Array, Coefficients, FloatArray, Int64Array, LumaImage, FloatArray]

# Columns of `CastArrays.faces` and `CastArrays.layout`.
NORMAL, UNIT_U, UNIT_V, OFFSET, LENGTH, DENSITY, TABLE_START, REACH, GUARD, SLOPE = 0, 3, 6, 9, 12, 14, 16, 17, 18, 19
FIRST_TEXEL, TEXELS_U, TEXELS_V, TABLE_FIRST, TABLE_COUNT = 0, 1, 2, 3, 4


class CastArrays(NamedTuple):
    """A scene as one camera sees it; one row a face in the first two."""

    faces: FloatArray
    """Normal, unit vectors u and v in the camera's axes; the face's origin seen from the optical centre along these
    three [m]; lengths along u and v [m]; texels per metre along them; distance from the face's origin to the start of
    its table of displacements [m]; largest displacement plus `SLACK_PX` there [m]; texels before the origin;
    longitudinal components of the unit vectors u and v. Shape (F, 21)."""
    layout: Int64Array
    """First texel and numbers of texels along u and v; first row and number of rows in the table of displacements,
    0 rows for what never moves. Shape (F, 5)."""
    coefficients: Coefficients
    """Spline coefficients of all textures, one after the other."""
    rays: FloatArray
    """Undistorted rays (x/z, y/z) of all pixel centres with a border of one pixel, shape (H + 2, W + 2, 2)."""
    candidates: Int64Array
    """Faces to try in each tile, padded with -1, shape (tiles_v, tiles_u, most)."""
    sky: LumaImage
    """Luma where there is no face, shape (H, W)."""

    def plain(self, values: FloatArray) -> PlainArrays:
        """The same as a tuple without names, with displacements in the tables.

        For the compiled functions: numba's cache on disk cannot be read any more once a class named in a signature is
        renamed.

        Parameters
        ----------
        values
            Displacement in the tables, shape (N, 3) [m].
        """
        return self.faces, self.layout, self.coefficients, self.rays, self.candidates, self.sky, values


def _point_spread() -> FloatArray:
    """Places of equal weight under the point spread, shape (N, 2) [px].

    A rank-1 lattice, all of whose points differ in row and in column, drawn through the inverse of the distribution.
    """
    n = np.arange(_SAMPLES)
    lattice = np.column_stack([n, n * _GENERATOR % _SAMPLES])
    return np.asarray(BLUR_PX * ndtri((lattice + 0.5) / _SAMPLES))


SPREAD_U, SPREAD_V = (np.ascontiguousarray(places, np.float32) for places in _point_spread().T)
