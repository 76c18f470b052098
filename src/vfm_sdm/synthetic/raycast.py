"""The compiled loops behind `vfm_sdm.synthetic.render`: nearest face on a ray, texture there, edges blended.

Faces are rows of two plain arrays, indexed by scalars only: passing tuples of arrays or rows between compiled functions
costs a reference count a ray, and with it 20 times the time.
"""

import math
from typing import NamedTuple

import numba as nb
import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from vfm_sdm.arrays import BoolArray, FloatArray

__all__ = [
    "EDGE_PX",
    "KEEP",
    "SEARCH",
    "SLACK_PX",
    "TABLE_STEP_M",
    "TILE",
    "CastArrays",
    "mark_tiles",
    "render_pixels",
    "smooth_edges",
]

BLUR_PX = 0.8
"""Standard deviation of the Gaussian point spread that edges are seen through [px]."""
EDGE_PX = 3
"""Reach of the point spread [px]."""
SLACK_PX = 1.5 * EDGE_PX + 1.5
"""How far beyond a face's edge a ray still counts as near it [px]: the diagonal of the reach and a little."""
_SAMPLES = 64
"""Rays through the point spread where more than two faces meet."""
_GENERATOR = 19
TILE = 8
"""Side of the squares that share a list of faces to try [px]."""
TABLE_STEP_M = 0.02
"""Distance between entries of the tables of displacements, along the structure [m]."""
_FIXED_POINT_STEPS = 2

_Vector = tuple[float, float, float]
_Tile = tuple[int, int]
_Int64Array = npt.NDArray[np.int64]
_FaceImage = npt.NDArray[np.int16]
_LumaImage = npt.NDArray[np.float32]
_Coefficients = npt.NDArray[np.float32]
_Arrays = tuple[FloatArray, _Int64Array, _Coefficients, FloatArray, FloatArray, _Int64Array, float]

# What to do with a pixel, where it is not the index of a face.
KEEP, SEARCH = -2, -1

# Columns of `CastArrays.faces` and `CastArrays.layout`.
NORMAL, UNIT_U, UNIT_V, OFFSET, LENGTH, DENSITY, TABLE_START, REACH, GUARD = 0, 3, 6, 9, 12, 14, 16, 17, 18
FIRST_TEXEL, TEXELS_U, TEXELS_V, TABLE_FIRST, TABLE_COUNT = 0, 1, 2, 3, 4


def _point_spread() -> FloatArray:
    """Places of equal weight under the point spread, shape (N, 2) [px].

    A rank-1 lattice, all of whose points differ in row and in column, drawn through the inverse of the distribution.
    """
    n = np.arange(_SAMPLES)
    lattice = np.column_stack([n, n * _GENERATOR % _SAMPLES])
    return np.asarray(BLUR_PX * ndtri((lattice + 0.5) / _SAMPLES))


_POINT_SPREAD = _point_spread()


class CastArrays(NamedTuple):
    """A scene as one camera sees it; one row a face in the first two."""

    faces: FloatArray
    """Normal, unit vectors u and v; the face's origin seen from the optical centre along these three [m]; lengths
    along u and v [m]; texels per metre along them; distance from the face's origin to the start of its table of
    displacements [m]; largest displacement plus `SLACK_PX` there [m]; texels before the origin.
    Shape (F, 19)."""
    layout: _Int64Array
    """First texel and numbers of texels along u and v; first row and number of rows in the table of displacements,
    0 rows for what never moves. Shape (F, 5)."""
    coefficients: _Coefficients
    """Spline coefficients of all textures, one after the other."""
    rotation: FloatArray
    """world_from_cam, shape (3, 3)."""
    rays: FloatArray
    """Undistorted rays (x/z, y/z) of all pixel centres with a border of one pixel, shape (H + 2, W + 2, 2)."""
    candidates: _Int64Array
    """Faces to try in each tile, padded with -1, shape (tiles_v, tiles_u, most)."""
    sky: float
    """Luma where there is no face."""

    def plain(self) -> _Arrays:
        """The same as a tuple without names.

        For the compiled functions: numba's cache on disk cannot be read any more once a class named in a signature is
        renamed.
        """
        return self.faces, self.layout, self.coefficients, self.rotation, self.rays, self.candidates, self.sky


@nb.njit(error_model="numpy", forceinline=True)
def _dot(faces: FloatArray, k: int, column: int, vector: _Vector) -> float:
    product: float = faces[k, column] * vector[0] + faces[k, column + 1] * vector[1] + faces[k, column + 2] * vector[2]
    return product


@nb.njit(error_model="numpy", forceinline=True)
def _minus(first: _Vector, second: _Vector) -> _Vector:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@nb.njit(error_model="numpy", forceinline=True)
def _shift_at(values: FloatArray, first: int, count: int, position: float) -> _Vector:
    """Displacement at a position in a table, linear between its rows, constant beyond them."""
    index = min(max(int(position), 0), max(count - 2, 0))
    weight = min(max(position - index, 0.0), 1.0)
    low = first + index
    high = low + min(1, count - 1)
    return (
        values[low, 0] + weight * (values[high, 0] - values[low, 0]),
        values[low, 1] + weight * (values[high, 1] - values[low, 1]),
        values[low, 2] + weight * (values[high, 2] - values[low, 2]),
    )


@nb.njit(error_model="numpy", forceinline=True)
def _meet(faces: FloatArray, layout: _Int64Array, values: FloatArray, k: int, ray: _Vector) -> _Vector:
    """Distance along a ray to a face's plane, and where it meets it at rest, along u and v.

    (-1, 0, 0) for a miss by more than the displacement and `SLACK_PX` explain.

    A point of a moving face is displaced by the value at its own place at rest, which a fixed-point iteration finds.
    Its error shrinks by the slope of the deflection curve (1e-3) a step, so that two steps leave 1e-8 m of a
    displacement of 1 cm.
    """
    inverse = 1.0 / _dot(faces, k, NORMAL, ray)
    along = faces[k, OFFSET] * inverse
    ray_u, ray_v = _dot(faces, k, UNIT_U, ray), _dot(faces, k, UNIT_V, ray)
    a, b = along * ray_u - faces[k, OFFSET + 1], along * ray_v - faces[k, OFFSET + 2]
    # A displacement moves the meeting point by itself and by its normal part times the tangent of the incidence.
    slack = faces[k, REACH] * (1 + abs(inverse) * (abs(ray_u) + abs(ray_v)))
    inside = -slack <= a <= faces[k, LENGTH] + slack and -slack <= b <= faces[k, LENGTH + 1] + slack
    if not (inside and along > 0):  # written so that infinity and NaN of a ray within the plane miss it
        return -1.0, 0.0, 0.0
    if layout[k, TABLE_COUNT] == 0:
        return along, a, b
    rest_a, rest_b, rest_along = a, b, along
    for _ in range(_FIXED_POINT_STEPS):
        longitudinal = a * faces[k, UNIT_U + 2] + b * faces[k, UNIT_V + 2] - faces[k, TABLE_START]
        shift = _shift_at(values, layout[k, TABLE_FIRST], layout[k, TABLE_COUNT], longitudinal * (1 / TABLE_STEP_M))
        farther = _dot(faces, k, NORMAL, shift) * inverse
        along = rest_along + farther
        a = rest_a + farther * ray_u - _dot(faces, k, UNIT_U, shift)
        b = rest_b + farther * ray_v - _dot(faces, k, UNIT_V, shift)
    return along, a, b


@nb.njit(error_model="numpy", forceinline=True)
def _cast(
    faces: FloatArray, layout: _Int64Array, values: FloatArray, candidates: _Int64Array, tile: _Tile, ray: _Vector
) -> tuple[int, float, float]:
    """Nearest face on a ray (-1: none), and where on it, along u and v."""
    best, best_a, best_b, nearest = -1, 0.0, 0.0, np.inf
    for n in range(candidates.shape[2]):
        k = candidates[tile[0], tile[1], n]
        if k < 0:
            break
        along, a, b = _meet(faces, layout, values, k, ray)
        if 0 < along < nearest and 0 <= a <= faces[k, LENGTH] and 0 <= b <= faces[k, LENGTH + 1]:
            best, best_a, best_b, nearest = k, a, b, along
    return best, best_a, best_b


@nb.njit(error_model="numpy", forceinline=True)
def _weights(t: float) -> tuple[float, float, float, float]:
    """Cubic B-spline at t + 1, t, t - 1 and t - 2, for t in [0, 1)."""
    s = 1 - t
    return s * s * s / 6, 2 / 3 - 0.5 * t * t * (2 - t), 2 / 3 - 0.5 * s * s * (2 - s), t * t * t / 6


@nb.njit(error_model="numpy", forceinline=True)
def _sample(faces: FloatArray, layout: _Int64Array, coefficients: _Coefficients, k: int, a: float, b: float) -> float:
    """Luma of a face's texture at distances a and b along its edges; a little beyond them, too."""
    n_u, n_v = layout[k, TEXELS_U], layout[k, TEXELS_V]
    x = min(max(a * faces[k, DENSITY] + faces[k, GUARD], 1.0), n_u - 3.0)
    y = min(max(b * faces[k, DENSITY + 1] + faces[k, GUARD], 1.0), n_v - 3.0)
    i, j = int(x), int(y)
    wx, wy = _weights(x - i), _weights(y - j)
    total = 0.0
    for q in range(4):
        n = layout[k, FIRST_TEXEL] + (j - 1 + q) * n_u + i - 1
        line = wx[0] * coefficients[n] + wx[1] * coefficients[n + 1]
        total += wy[q] * (line + wx[2] * coefficients[n + 2] + wx[3] * coefficients[n + 3])
    return total


@nb.njit(error_model="numpy", forceinline=True)
def _ray(R: FloatArray, rays: FloatArray, row: int, column: int, du: float, dv: float) -> _Vector:
    """World direction of a ray near a pixel's centre; distortion is linear enough over one pixel."""
    i, j = row + 1, column + 1
    x = rays[i, j, 0]
    y = rays[i, j, 1]
    x += 0.5 * (du * (rays[i, j + 1, 0] - rays[i, j - 1, 0]) + dv * (rays[i + 1, j, 0] - rays[i - 1, j, 0]))
    y += 0.5 * (du * (rays[i, j + 1, 1] - rays[i, j - 1, 1]) + dv * (rays[i + 1, j, 1] - rays[i - 1, j, 1]))
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2],
        R[1, 0] * x + R[1, 1] * y + R[1, 2],
        R[2, 0] * x + R[2, 1] * y + R[2, 2],
    )


@nb.njit(cache=True, error_model="numpy")
def _linearize(
    faces: FloatArray, layout: _Int64Array, values: FloatArray, k: int, rays: tuple[_Vector, _Vector, _Vector]
) -> tuple[_Vector, _Vector, _Vector]:
    """What `_meet` gives at a pixel's centre, and its derivatives by column and by row [1/px].

    Parameters
    ----------
    rays
        Through the centre, and one pixel to the right and below.
    """
    along, a, b = _meet(faces, layout, values, k, rays[0])
    inverse = 1.0 / _dot(faces, k, NORMAL, rays[0])
    ray_u, ray_v = _dot(faces, k, UNIT_U, rays[0]), _dot(faces, k, UNIT_V, rays[0])
    by_column, by_row = _minus(rays[1], rays[0]), _minus(rays[2], rays[0])
    farther = -along * inverse * _dot(faces, k, NORMAL, by_column)
    further = -along * inverse * _dot(faces, k, NORMAL, by_row)
    return (
        (along, a, b),
        (
            farther,
            farther * ray_u + along * _dot(faces, k, UNIT_U, by_column),
            farther * ray_v + along * _dot(faces, k, UNIT_V, by_column),
        ),
        (
            further,
            further * ray_u + along * _dot(faces, k, UNIT_U, by_row),
            further * ray_v + along * _dot(faces, k, UNIT_V, by_row),
        ),
    )


@nb.njit(error_model="numpy", forceinline=True)
def _share(place: float, length: float, by_column: float, by_row: float) -> float:
    """Share of the point spread between two parallel edges at 0 and ``length``, for a pixel's centre at ``place``."""
    scale = math.sqrt(0.5) / (BLUR_PX * math.sqrt(by_column * by_column + by_row * by_row))
    return 0.5 * (math.erf(place * scale) - math.erf((place - length) * scale))


@nb.njit(error_model="numpy", forceinline=True)
def _neighbours(face: _FaceImage, row: int, column: int) -> tuple[int, int]:
    """How many different faces are within the reach of the point spread (3 for more), and the second of them.

    3 at the border of the image, too, beyond which another face may be.
    """
    height, width = face.shape
    here, other, count = face[row, column], face[row, column], 1
    if min(row, column, height - 1 - row, width - 1 - column) < EDGE_PX:
        return 3, int(other)
    for i in range(row - EDGE_PX, row + EDGE_PX + 1):
        for j in range(column - EDGE_PX, column + EDGE_PX + 1):
            k = face[i, j]
            if k not in (here, other):
                if count == 2:
                    return 3, int(other)
                other, count = k, 2
    return count, int(other)


@nb.njit(cache=True, error_model="numpy")
def _blend_two(
    faces: FloatArray,
    layout: _Int64Array,
    values: FloatArray,
    pair: tuple[int, int],
    rays: tuple[_Vector, _Vector, _Vector],
) -> tuple[float, _Vector, _Vector]:
    """Share of the first of two faces in the point spread, and where the centre meets each (`_meet`).

    The edge between them belongs to the one in front, or, where their planes cross nearby, to the one that ends there;
    the share is -1 where that is not clear. Exact for one straight edge, since the point spread is isotropic; near a
    corner the shares along u and v are multiplied, exact for a right angle.
    """
    first, second = (-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
    column_first, row_first = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    column_second, row_second = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    share_first, share_second = 0.0, 0.0
    if pair[0] >= 0:
        first, column_first, row_first = _linearize(faces, layout, values, pair[0], rays)
        share_first = _share(first[1], faces[pair[0], LENGTH], column_first[1], row_first[1])
        share_first *= _share(first[2], faces[pair[0], LENGTH + 1], column_first[2], row_first[2])
    if pair[1] >= 0:
        second, column_second, row_second = _linearize(faces, layout, values, pair[1], rays)
        share_second = _share(second[1], faces[pair[1], LENGTH], column_second[1], row_second[1])
        share_second *= _share(second[2], faces[pair[1], LENGTH + 1], column_second[2], row_second[2])
    if pair[0] < 0 or pair[1] < 0:
        return (share_first if pair[1] < 0 else 1 - share_second), first, second
    slope = math.hypot(column_first[0] - column_second[0], row_first[0] - row_second[0])
    first_in_front = first[0] < second[0]
    if abs(first[0] - second[0]) > (EDGE_PX + 1) * slope:
        return (share_first if first_in_front else 1 - share_second), first, second
    if abs(share_first + share_second - 1) < 1e-3:  # two sides of a box, or two plates of one plane
        return share_first, first, second
    first_ends = share_first < share_second
    ending = share_first if first_ends else share_second
    if max(share_first, share_second) < 0.999 or abs(ending - 0.5) < 0.02:
        return -1.0, first, second
    # One ends at the plane of the other: it shows only if what there is of it lies in front.
    shows = (ending > 0.5) == (first_in_front == first_ends)
    return (share_first if first_ends == shows else 1 - share_second), first, second


@nb.njit(error_model="numpy", forceinline=True)
def _nearest(faces: FloatArray, near: FloatArray, count: int, du: float, dv: float) -> int:
    """Row of ``near`` of the nearest face on a ray beside a pixel's centre, -1 for none.

    A row holds a face's index and what `_linearize` gives.
    """
    best, nearest = -1, np.inf
    for n in range(count):
        k = int(near[n, 0])
        along = near[n, 1] + du * near[n, 4] + dv * near[n, 7]
        a = near[n, 2] + du * near[n, 5] + dv * near[n, 8]
        b = near[n, 3] + du * near[n, 6] + dv * near[n, 9]
        if 0 < along < nearest and 0 <= a <= faces[k, LENGTH] and 0 <= b <= faces[k, LENGTH + 1]:
            best, nearest = n, along
    return best


@nb.njit(error_model="numpy", forceinline=True)
def _blend_many(
    faces: FloatArray,
    layout: _Int64Array,
    coefficients: _Coefficients,
    near: FloatArray,
    count: int,
    sky: float,
) -> float:
    """Mean luma under the point spread, each face's texture taken at the pixel's centre.

    Parameters
    ----------
    near
        A row a face: its index, what `_linearize` gives, and room for a number.
    """
    for n in range(count):
        near[n, 10] = 0
    total = 0.0
    for n in range(_SAMPLES):
        hit = _nearest(faces, near, count, _POINT_SPREAD[n, 0], _POINT_SPREAD[n, 1])
        if hit < 0:
            total += sky
        else:
            near[hit, 10] += 1
    for n in range(count):
        if near[n, 10] > 0:
            total += near[n, 10] * _sample(faces, layout, coefficients, int(near[n, 0]), near[n, 2], near[n, 3])
    return total / _SAMPLES


# The arrays that the next three fill are arguments of their own, because numba's parallel mode drops writes to arrays
# that it reaches through a tuple.
@nb.njit(cache=True, error_model="numpy", parallel=True)
def render_pixels(arrays: _Arrays, values: FloatArray, plan: _FaceImage, luma: _LumaImage, face: _FaceImage) -> None:
    """Draws pixels in place with one ray each: enough inside a face, because textures are band-limited.

    Parameters
    ----------
    arrays
        What to draw.
    values
        Displacement in the tables, shape (N, 3) [m].
    plan
        What to do with each pixel, shape (H, W): `KEEP` it, `SEARCH` for the face, or the index of the only face that
        it can show.
    luma, face
        What to fill, shape (H, W): luma and the index of the face seen, -1 for the sky.
    """
    faces, layout, coefficients, R, rays, candidates, sky = arrays
    height, width = plan.shape
    for row in nb.prange(height):
        for column in range(width):
            k = int(plan[row, column])
            if k == KEEP:
                continue
            ray = _ray(R, rays, row, column, 0.0, 0.0)
            if k == SEARCH:
                k, a, b = _cast(faces, layout, values, candidates, (row // TILE, column // TILE), ray)
            else:
                _, a, b = _meet(faces, layout, values, k, ray)
            face[row, column] = k
            luma[row, column] = sky if k < 0 else _sample(faces, layout, coefficients, k, a, b)


@nb.njit(cache=True, error_model="numpy", parallel=True)
def smooth_edges(arrays: _Arrays, values: FloatArray, edges: BoolArray, luma: _LumaImage, face: _FaceImage) -> None:
    """Blends the faces around an edge by how much of the pixel's point spread each covers, in place.

    A function of its own, because it needs the faces of the neighbouring rows complete. Two faces are blended in
    closed form, more by samples. Textures are taken at the pixel's centre, a little beyond the edge for some: they
    are what the camera makes of the surface, whereas an edge must still be blurred, or the image would alias.

    Parameters
    ----------
    arrays, values, luma, face
        As in `render_pixels`.
    edges
        Pixels that an edge may reach, shape (H, W).
    """
    faces, layout, coefficients, R, rays, candidates, sky = arrays
    height, width = edges.shape
    for row in nb.prange(height):
        near = np.empty((candidates.shape[2], 11))
        for column in range(width):
            if not edges[row, column]:
                continue
            kinds, other = _neighbours(face, row, column)
            if kinds == 1:
                continue
            three = (
                _ray(R, rays, row, column, 0.0, 0.0),
                _ray(R, rays, row, column, 1.0, 0.0),
                _ray(R, rays, row, column, 0.0, 1.0),
            )
            if kinds == 2:
                here = int(face[row, column])
                share, _, second = _blend_two(faces, layout, values, (here, other), three)
                if share >= 0:
                    beyond = sky
                    if other >= 0:
                        beyond = _sample(faces, layout, coefficients, other, second[1], second[2])
                    luma[row, column] = share * luma[row, column] + (1 - share) * beyond
                    continue
            count = 0
            for n in range(candidates.shape[2]):
                k = candidates[row // TILE, column // TILE, n]
                if k < 0:
                    break
                center, by_column, by_row = _linearize(faces, layout, values, k, three)
                if center[0] > 0:
                    near[count, 0] = k
                    for m in range(3):
                        near[count, 1 + m], near[count, 4 + m], near[count, 7 + m] = center[m], by_column[m], by_row[m]
                    count += 1
            luma[row, column] = _blend_many(faces, layout, coefficients, near, count, sky)


@nb.njit(cache=True, error_model="numpy")
def mark_tiles(arrays: _Arrays, values: FloatArray, marks: BoolArray) -> None:
    """Sets ``marks[face, tile_v, tile_u]`` where a face comes near a pixel of the tile, hidden or not.

    Every other pixel is enough, because `_meet` looks `SLACK_PX` beyond a face's edges.
    """
    faces, layout, _, R, rays, _, _ = arrays
    height, width = rays.shape[0] - 2, rays.shape[1] - 2
    for tile_row in range(marks.shape[1]):
        for row in range(tile_row * TILE, min((tile_row + 1) * TILE, height), 2):
            for column in range(0, width, 2):
                ray = _ray(R, rays, row, column, 0.0, 0.0)
                for k in range(marks.shape[0]):
                    if not marks[k, tile_row, column // TILE]:
                        marks[k, tile_row, column // TILE] = _meet(faces, layout, values, k, ray)[0] > 0
