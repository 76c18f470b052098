"""The compiled loops behind `vfm_sdm.studies.synthetic.render`: nearest face on a ray, texture there, edges blended.

Faces are rows of two plain arrays, indexed by scalars only: passing tuples of arrays or rows between compiled functions
costs a reference count a ray, and with it 20 times the time.
"""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from vfm_sdm.core.arrays import BoolArray, FloatArray

__all__ = [
    "EDGE_PX",
    "MIXED",
    "MIXED_FRONT",
    "SLACK_PX",
    "TABLE_STEP_M",
    "TILE",
    "CastArrays",
    "mark_tiles",
    "move_pixels",
    "render_pixels",
    "smooth_edges",
]

BLUR_PX = 0.8
"""Standard deviation of the Gaussian point spread that edges are seen through [px]."""
EDGE_PX = 3
"""Reach of the point spread [px]."""
SLACK_PX = 1.5 * EDGE_PX + 1.5
"""How far beyond a face's edge a ray still counts as near it [px]: the diagonal of the reach and a little."""
_FAR = 4.0
"""Beyond this the error function is 1 to 2e-8."""
_SAMPLES = 64
"""Rays through the point spread where more than two faces meet."""
_GENERATOR = 19
TILE = 8
"""Side of the squares that share a list of faces to try [px]."""
TABLE_STEP_M = 0.02
"""Distance between entries of the tables of displacements, along the structure [m]."""

_Vector = tuple[float, float, float]
_Tile = tuple[int, int]
_Int64Array = npt.NDArray[np.int64]
_FaceImage = npt.NDArray[np.int16]
_LumaImage = npt.NDArray[np.float32]
_Coefficients = npt.NDArray[np.float32]
_Arrays = tuple[FloatArray, _Int64Array, _Coefficients, FloatArray, _Int64Array, float]

# What a neighbourhood of pixels shows at rest, where it is not one face alone: several faces, or several of which one
# stands still in front of what moves.
MIXED, MIXED_FRONT = -2, -3

_UNSIGNED = (np.uintp(0), np.uintp(1), np.uintp(2), np.uintp(3))
_FAST: Any = {"contract", "nsz", "arcp", "reassoc"}
"""What floating-point rules the compiler may bend: all but those for infinity and NaN."""

# Columns of `CastArrays.faces` and `CastArrays.layout`.
NORMAL, UNIT_U, UNIT_V, OFFSET, LENGTH, DENSITY, TABLE_START, REACH, GUARD, SLOPE = 0, 3, 6, 9, 12, 14, 16, 17, 18, 19
FIRST_TEXEL, TEXELS_U, TEXELS_V, TABLE_FIRST, TABLE_COUNT = 0, 1, 2, 3, 4


def _point_spread() -> FloatArray:
    """Places of equal weight under the point spread, shape (N, 2) [px].

    A rank-1 lattice, all of whose points differ in row and in column, drawn through the inverse of the distribution.
    """
    n = np.arange(_SAMPLES)
    lattice = np.column_stack([n, n * _GENERATOR % _SAMPLES])
    return np.asarray(BLUR_PX * ndtri((lattice + 0.5) / _SAMPLES))


_SPREAD_U, _SPREAD_V = (np.ascontiguousarray(places, np.float32) for places in _point_spread().T)


class CastArrays(NamedTuple):
    """A scene as one camera sees it; one row a face in the first two."""

    faces: FloatArray
    """Normal, unit vectors u and v in the camera's axes; the face's origin seen from the optical centre along these
    three [m]; lengths along u and v [m]; texels per metre along them; distance from the face's origin to the start of
    its table of displacements [m]; largest displacement plus `SLACK_PX` there [m]; texels before the origin;
    longitudinal components of the unit vectors u and v. Shape (F, 21)."""
    layout: _Int64Array
    """First texel and numbers of texels along u and v; first row and number of rows in the table of displacements,
    0 rows for what never moves. Shape (F, 5)."""
    coefficients: _Coefficients
    """Spline coefficients of all textures, one after the other."""
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
        return self.faces, self.layout, self.coefficients, self.rays, self.candidates, self.sky


@nb.njit(error_model="numpy", forceinline=True)
def _dot(faces: FloatArray, k: int, column: int, vector: _Vector) -> float:
    product: float = faces[k, column] * vector[0] + faces[k, column + 1] * vector[1] + faces[k, column + 2] * vector[2]
    return product


@nb.njit(error_model="numpy", forceinline=True)
def _minus(first: _Vector, second: _Vector) -> _Vector:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@nb.njit(error_model="numpy", forceinline=True)
def _displaced(
    faces: FloatArray, layout: _Int64Array, values: FloatArray, k: int, at_rest: tuple[float, float], ray: _Vector
) -> _Vector:
    """How much farther along a ray a displaced face is met, and where on it, along u and v.

    A point is displaced by the value at its own place at rest, which is not known before: the table is taken as a
    straight line about the place that the ray meets at rest, and the place solved for. Beyond its ends the table goes
    on as it ends.

    Parameters
    ----------
    at_rest
        Where the ray meets the face at rest, along u and v [m].
    ray
        Inverse of its component along the face's normal, and the components along u and v over that.
    """
    a, b = at_rest
    along_u, along_v = faces[k, SLOPE], faces[k, SLOPE + 1]
    place = (a * along_u + b * along_v - faces[k, TABLE_START]) * (1 / TABLE_STEP_M)
    count = layout[k, TABLE_COUNT]
    index = min(max(int(place), 0), max(count - 2, 0))
    weight = min(max(place - index, 0.0), 1.0)
    low = nb.uintp(layout[k, TABLE_FIRST] + index)
    high = nb.uintp(layout[k, TABLE_FIRST] + index + min(1, count - 1))
    step_n, step_u, step_v = (
        values[high, 0] - values[low, 0],
        values[high, 1] - values[low, 1],
        values[high, 2] - values[low, 2],
    )
    by_normal = values[low, 0] + weight * step_n
    shift_a = by_normal * ray[1] - values[low, 1] - weight * step_u
    shift_b = by_normal * ray[2] - values[low, 2] - weight * step_v
    slope_a, slope_b = step_n * ray[1] - step_u, step_n * ray[2] - step_v
    own = (along_u * slope_a + along_v * slope_b) * (1 / TABLE_STEP_M)
    cells = (along_u * shift_a + along_v * shift_b) * (1 / TABLE_STEP_M) * (1 + own * (1 + own))
    return (by_normal + cells * step_n) * ray[0], a + shift_a + cells * slope_a, b + shift_b + cells * slope_b


@nb.njit(error_model="numpy", forceinline=True)
def _meet(faces: FloatArray, layout: _Int64Array, values: FloatArray, k: int, ray: _Vector) -> _Vector:
    """Distance along a ray to a face's plane, and where it meets it at rest, along u and v.

    (-1, 0, 0) for a miss by more than the displacement and `SLACK_PX` explain.
    """
    inverse = 1.0 / _dot(faces, k, NORMAL, ray)
    along = faces[k, OFFSET] * inverse
    # A displacement moves the meeting point by itself and by its normal part times the tangent of the incidence. The
    # conditions are written so that infinity and NaN of a ray within the plane miss it.
    ray_u = _dot(faces, k, UNIT_U, ray)
    a = along * ray_u - faces[k, OFFSET + 1]
    slack = faces[k, REACH] * (1 + abs(inverse * ray_u))
    if not (along > 0 and -slack <= a <= faces[k, LENGTH] + slack):
        return -1.0, 0.0, 0.0
    ray_v = _dot(faces, k, UNIT_V, ray)
    b = along * ray_v - faces[k, OFFSET + 2]
    slack = faces[k, REACH] * (1 + abs(inverse * ray_v))
    if not -slack <= b <= faces[k, LENGTH + 1] + slack:
        return -1.0, 0.0, 0.0
    if layout[k, TABLE_COUNT] == 0:
        return along, a, b
    farther, a, b = _displaced(faces, layout, values, k, (a, b), (inverse, inverse * ray_u, inverse * ray_v))
    return along + farther, a, b


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
def _weights(t: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Cubic B-spline at t + 1, t, t - 1 and t - 2, for t in [0, 1), in single precision as the coefficients."""
    one, half, sixth = np.float32(1), np.float32(0.5), np.float32(1 / 6)
    s = one - t
    inner, outer = np.float32(2 / 3) - half * t * t * (s + one), np.float32(2 / 3) - half * s * s * (t + one)
    return s * s * s * sixth, inner, outer, t * t * t * sixth


@nb.njit(error_model="numpy", forceinline=True)
def _sample(faces: FloatArray, layout: _Int64Array, coefficients: _Coefficients, k: int, a: float, b: float) -> float:
    """Luma of a face's texture at distances a and b along its edges; a little beyond them, too."""
    n_u, n_v = layout[k, TEXELS_U], layout[k, TEXELS_V]
    x = min(max(a * faces[k, DENSITY] + faces[k, GUARD], 1.0), n_u - 3.0)
    y = min(max(b * faces[k, DENSITY + 1] + faces[k, GUARD], 1.0), n_v - 3.0)
    i, j = int(x), int(y)
    wx, wy = _weights(np.float32(x - i)), _weights(np.float32(y - j))
    total: Any = np.float32(0)
    for q in range(4):
        # Unsigned, because a signed index is checked for being negative at every one of 16 reads.
        n = nb.uintp(layout[k, FIRST_TEXEL] + (j - 1 + q) * n_u + i - 1)
        line = wx[0] * coefficients[n] + wx[1] * coefficients[n + _UNSIGNED[1]]
        total += wy[q] * (line + wx[2] * coefficients[n + _UNSIGNED[2]] + wx[3] * coefficients[n + _UNSIGNED[3]])
    return total  # type: ignore[no-any-return]


@nb.njit(error_model="numpy", forceinline=True)
def _ray(rays: FloatArray, row: int, column: int) -> _Vector:
    """Direction of the ray through a pixel's centre, camera's axes."""
    return rays[row + 1, column + 1, 0], rays[row + 1, column + 1, 1], 1.0


@nb.njit(error_model="numpy", forceinline=True)
def _rays_about(rays: FloatArray, row: int, column: int) -> tuple[_Vector, _Vector, _Vector]:
    """Rays through a pixel's centre, and one pixel to the right and below; distortion is linear enough over one."""
    i, j = row + 1, column + 1
    x, y = rays[i, j, 0], rays[i, j, 1]
    right = x + 0.5 * (rays[i, j + 1, 0] - rays[i, j - 1, 0]), y + 0.5 * (rays[i, j + 1, 1] - rays[i, j - 1, 1]), 1.0
    below = x + 0.5 * (rays[i + 1, j, 0] - rays[i - 1, j, 0]), y + 0.5 * (rays[i + 1, j, 1] - rays[i - 1, j, 1]), 1.0
    return (x, y, 1.0), right, below


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
    before, after = place * scale, (place - length) * scale
    # Most pixels are far from one or both edges, and the error function is what costs most.
    first = math.copysign(1.0, before) if abs(before) > _FAR else math.erf(before)
    second = math.copysign(1.0, after) if abs(after) > _FAR else math.erf(after)
    return 0.5 * (first - second)


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


@nb.njit(error_model="numpy", forceinline=True)
def _gather(face: _FaceImage, listed: _Int64Array, row: int, column: int, near: FloatArray) -> int:
    """Lists the faces seen within the reach of the point spread in the first column of ``near``; returns how many.

    At the border of the image any of the faces ``listed`` for the tile may be.
    """
    height, width = face.shape
    count = 0
    if min(row, column, height - 1 - row, width - 1 - column) < EDGE_PX:
        for n in range(listed.shape[0]):
            if listed[n] < 0:
                break
            near[count, 0] = listed[n]
            count += 1
        return count
    last = -1
    for i in range(row - EDGE_PX, row + EDGE_PX + 1):
        for j in range(column - EDGE_PX, column + EDGE_PX + 1):
            k = face[i, j]
            if k < 0 or k == last:
                continue
            last, known = k, False
            for n in range(count):
                known = known or near[n, 0] == k
            if not known and count < near.shape[0]:
                near[count, 0] = k
                count += 1
    return count


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
def _blend_many(
    faces: FloatArray,
    layout: _Int64Array,
    coefficients: _Coefficients,
    near: FloatArray,
    count: int,
    rays: tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]],
    sky: float,
) -> float:
    """Mean luma under the point spread, each face's texture taken at the pixel's centre.

    Parameters
    ----------
    near
        A row a face: its index, and what `_linearize` gives.
    rays
        Room for the distance to the nearest face on each ray of the point spread, and for its row in ``near``.

    Notes
    -----
    Face by face over all rays, without branches, so that the compiler takes several rays at once.
    """
    distance, nearest = rays
    for m in range(_SAMPLES):
        distance[m], nearest[m] = np.inf, -1
    for n in range(count):
        k = int(near[n, 0])
        along, along_u, along_v = np.float32(near[n, 1]), np.float32(near[n, 4]), np.float32(near[n, 7])
        a, a_u, a_v = np.float32(near[n, 2]), np.float32(near[n, 5]), np.float32(near[n, 8])
        b, b_u, b_v = np.float32(near[n, 3]), np.float32(near[n, 6]), np.float32(near[n, 9])
        length_a, length_b = np.float32(faces[k, LENGTH]), np.float32(faces[k, LENGTH + 1])
        none = np.float32(0)
        for m in range(_SAMPLES):
            du, dv = _SPREAD_U[m], _SPREAD_V[m]
            far = along + du * along_u + dv * along_v
            at_a = a + du * a_u + dv * a_v
            at_b = b + du * b_u + dv * b_v
            hit = (far > none) & (far < distance[m])
            hit &= (at_a >= none) & (at_a <= length_a) & (at_b >= none) & (at_b <= length_b)
            distance[m] = far if hit else distance[m]
            nearest[m] = np.int32(n) if hit else nearest[m]
    total, seen = 0.0, 0
    for n in range(count):
        hits = 0
        for m in range(_SAMPLES):
            hits += nearest[m] == n
        if hits > 0:
            total += hits * _sample(faces, layout, coefficients, int(near[n, 0]), near[n, 2], near[n, 3])
            seen += hits
    return (total + (_SAMPLES - seen) * sky) / _SAMPLES


@nb.njit(error_model="numpy", forceinline=True, fastmath=_FAST)
def _sample_moved(
    faces: FloatArray,
    layout: _Int64Array,
    values: FloatArray,
    coefficients: _Coefficients,
    k: Any,
    ray: _Vector,
) -> float:
    """Luma of a displaced face on a ray that is known to meet it: `_meet` and `_sample` without their checks."""
    inverse = 1.0 / _dot(faces, k, NORMAL, ray)
    along_u, along_v = inverse * _dot(faces, k, UNIT_U, ray), inverse * _dot(faces, k, UNIT_V, ray)
    distance = faces[k, OFFSET]
    at_rest = distance * along_u - faces[k, OFFSET + 1], distance * along_v - faces[k, OFFSET + 2]
    _, a, b = _displaced(faces, layout, values, k, at_rest, (inverse, along_u, along_v))
    return _sample(faces, layout, coefficients, k, a, b)


# The arrays that the next ones fill are arguments of their own, because numba's parallel mode drops writes to arrays
# that it reaches through a tuple.
@nb.njit(cache=True, error_model="numpy", parallel=True)
def render_pixels(arrays: _Arrays, values: FloatArray, luma: _LumaImage, face: _FaceImage) -> None:
    """Draws all pixels in place with one ray each: enough inside a face, because textures are band-limited.

    Parameters
    ----------
    arrays
        What to draw.
    values
        Displacement in the tables, shape (N, 3) [m].
    luma, face
        What to fill, shape (H, W): luma and the index of the face seen, -1 for the sky.
    """
    faces, layout, coefficients, rays, candidates, sky = arrays
    height, width = face.shape
    for row in nb.prange(height):
        for column in range(width):
            ray = _ray(rays, row, column)
            k, a, b = _cast(faces, layout, values, candidates, (row // TILE, column // TILE), ray)
            face[row, column] = k
            luma[row, column] = sky if k < 0 else _sample(faces, layout, coefficients, k, a, b)


@nb.njit(cache=True, error_model="numpy", parallel=True, fastmath=_FAST)
def move_pixels(
    arrays: _Arrays,
    values: FloatArray,
    plan: tuple[BoolArray, _FaceImage, FloatArray, BoolArray, BoolArray],
    luma: _LumaImage,
    face: _FaceImage,
    edges: BoolArray,
    rows: tuple[int, int],
) -> None:
    """Draws again, in place, the pixels of a picture at rest that a displacement changes.

    Where the neighbourhood that a pixel's content came from shows one face alone, that face is drawn without a search.

    Parameters
    ----------
    arrays, values
        As in `render_pixels`.
    plan
        Pixels that may change, shape (H, W); the face that each one's neighbourhood shows at rest, or `MIXED` or
        `MIXED_FRONT`, shape (H, W); shift of moving points in each tile, shape (tiles_v, tiles_u, 2) [px]; which
        faces move, and which stand still in front of what moves, shape (F + 1,), the last for the sky.
    luma, face
        The picture at rest, shape (H, W).
    edges
        Filled with where an edge may be, shape (H, W).
    rows
        First row to draw, and the one after the last.
    """
    faces, layout, coefficients, rays, candidates, sky = arrays
    reached, alone, shifts, moving, front = plan
    height, width = face.shape
    for row in nb.prange(rows[0], rows[1]):
        for column in range(width):
            edges[row, column] = False
            if not reached[row, column]:
                continue
            tile = (row // TILE, column // TILE)
            from_row = math.floor(row - shifts[tile[0], tile[1], 1] + 0.5)
            from_column = math.floor(column - shifts[tile[0], tile[1], 0] + 0.5)
            here, there = int(alone[row, column]), MIXED
            if 0 <= from_row < height and 0 <= from_column < width:
                there = int(alone[from_row, from_column])
            ray = _ray(rays, row, column)
            if there >= 0 and moving[there] and here != MIXED_FRONT and (here < 0 or not front[here]):
                face[row, column] = there
                luma[row, column] = _sample_moved(faces, layout, values, coefficients, nb.uintp(there), ray)
            elif here != there or here <= MIXED:
                k, a, b = _cast(faces, layout, values, candidates, tile, ray)
                face[row, column] = k
                luma[row, column] = sky if k < 0 else _sample(faces, layout, coefficients, k, a, b)
                edges[row, column] = True


@nb.njit(cache=True, error_model="numpy", parallel=True)
def smooth_edges(
    arrays: _Arrays,
    values: FloatArray,
    edges: BoolArray,
    luma: _LumaImage,
    face: _FaceImage,
    rows: tuple[int, int],
) -> None:
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
    rows
        As in `move_pixels`.
    """
    faces, layout, coefficients, rays, candidates, sky = arrays
    width = edges.shape[1]
    for row in nb.prange(rows[0], rows[1]):
        near = np.empty((candidates.shape[2], 10))
        spread = np.empty(_SAMPLES, np.float32), np.empty(_SAMPLES, np.int32)
        for column in range(width):
            if not edges[row, column]:
                continue
            kinds, other = _neighbours(face, row, column)
            if kinds == 1:
                continue
            three = _rays_about(rays, row, column)
            if kinds == 2:
                here = int(face[row, column])
                share, _, second = _blend_two(faces, layout, values, (here, other), three)
                if share >= 0:
                    beyond = sky
                    if other >= 0:
                        beyond = _sample(faces, layout, coefficients, other, second[1], second[2])
                    luma[row, column] = share * luma[row, column] + (1 - share) * beyond
                    continue
            listed = _gather(face, candidates[row // TILE, column // TILE], row, column, near)
            count = 0
            for n in range(listed):
                k = int(near[n, 0])
                center, by_column, by_row = _linearize(faces, layout, values, k, three)
                if center[0] > 0:
                    near[count, 0] = k
                    for m in range(3):
                        near[count, 1 + m], near[count, 4 + m], near[count, 7 + m] = center[m], by_column[m], by_row[m]
                    count += 1
            luma[row, column] = _blend_many(faces, layout, coefficients, near, count, spread, sky)


@nb.njit(cache=True, error_model="numpy")
def mark_tiles(arrays: _Arrays, values: FloatArray, marks: BoolArray) -> None:
    """Sets ``marks[face, tile_v, tile_u]`` where a face comes near a pixel of the tile, hidden or not.

    Every other pixel is enough, because `_meet` looks `SLACK_PX` beyond a face's edges.
    """
    faces, layout, _, rays, _, _ = arrays
    height, width = rays.shape[0] - 2, rays.shape[1] - 2
    for tile_row in range(marks.shape[1]):
        for row in range(tile_row * TILE, min((tile_row + 1) * TILE, height), 2):
            for column in range(0, width, 2):
                ray = _ray(rays, row, column)
                for k in range(marks.shape[0]):
                    if not marks[k, tile_row, column // TILE]:
                        marks[k, tile_row, column // TILE] = _meet(faces, layout, values, k, ray)[0] > 0
