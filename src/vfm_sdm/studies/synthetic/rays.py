"""Compiled steps of one ray: where it meets a face, which face is the nearest, and the texture there.

Faces are rows of two plain arrays, indexed by scalars only: passing tuples of arrays or rows between compiled functions
costs a reference count a ray, and with it 20 times the time.
"""

from typing import Any

import numba as nb
import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.studies.synthetic.cast_arrays import (
    DENSITY,
    FIRST_TEXEL,
    GUARD,
    LENGTH,
    NORMAL,
    OFFSET,
    REACH,
    SLOPE,
    TABLE_COUNT,
    TABLE_FIRST,
    TABLE_START,
    TABLE_STEP_M,
    TEXELS_U,
    TEXELS_V,
    UNIT_U,
    UNIT_V,
    Coefficients,
    Int64Array,
    Tile,
    Vector,
)

__all__ = ["cast", "displaced", "dot", "linearize", "meet", "ray_through", "rays_about", "sample"]

_UNSIGNED = (np.uintp(0), np.uintp(1), np.uintp(2), np.uintp(3))


@nb.njit(error_model="numpy", forceinline=True)
def dot(faces: FloatArray, k: int, column: int, vector: Vector) -> float:
    """Product of a vector with the one that three columns of a face's row hold."""
    product: float = faces[k, column] * vector[0] + faces[k, column + 1] * vector[1] + faces[k, column + 2] * vector[2]
    return product


@nb.njit(error_model="numpy", forceinline=True)
def _minus(first: Vector, second: Vector) -> Vector:
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


@nb.njit(error_model="numpy", forceinline=True)
def displaced(
    faces: FloatArray, layout: Int64Array, values: FloatArray, k: int, at_rest: tuple[float, float], ray: Vector
) -> Vector:
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
def meet(faces: FloatArray, layout: Int64Array, values: FloatArray, k: int, ray: Vector) -> Vector:
    """Distance along a ray to a face's plane, and where it meets it at rest, along u and v.

    (-1, 0, 0) for a miss by more than the displacement and `SLACK_PX` explain.
    """
    inverse = 1.0 / dot(faces, k, NORMAL, ray)
    along = faces[k, OFFSET] * inverse
    # A displacement moves the meeting point by itself and by its normal part times the tangent of the incidence. The
    # conditions are written so that infinity and NaN of a ray within the plane miss it.
    ray_u = dot(faces, k, UNIT_U, ray)
    a = along * ray_u - faces[k, OFFSET + 1]
    slack = faces[k, REACH] * (1 + abs(inverse * ray_u))
    if not (along > 0 and -slack <= a <= faces[k, LENGTH] + slack):
        return -1.0, 0.0, 0.0
    ray_v = dot(faces, k, UNIT_V, ray)
    b = along * ray_v - faces[k, OFFSET + 2]
    slack = faces[k, REACH] * (1 + abs(inverse * ray_v))
    if not -slack <= b <= faces[k, LENGTH + 1] + slack:
        return -1.0, 0.0, 0.0
    if layout[k, TABLE_COUNT] == 0:
        return along, a, b
    farther, a, b = displaced(faces, layout, values, k, (a, b), (inverse, inverse * ray_u, inverse * ray_v))
    return along + farther, a, b


@nb.njit(error_model="numpy", forceinline=True)
def cast(
    faces: FloatArray, layout: Int64Array, values: FloatArray, candidates: Int64Array, tile: Tile, ray: Vector
) -> tuple[int, float, float]:
    """Nearest face on a ray (-1: none), and where on it, along u and v."""
    best, best_a, best_b, nearest = -1, 0.0, 0.0, np.inf
    for n in range(candidates.shape[2]):
        k = candidates[tile[0], tile[1], n]
        if k < 0:
            break
        along, a, b = meet(faces, layout, values, k, ray)
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
def sample(faces: FloatArray, layout: Int64Array, coefficients: Coefficients, k: int, a: float, b: float) -> float:
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
def ray_through(rays: FloatArray, row: int, column: int) -> Vector:
    """Direction of the ray through a pixel's centre, camera's axes."""
    return rays[row + 1, column + 1, 0], rays[row + 1, column + 1, 1], 1.0


@nb.njit(error_model="numpy", forceinline=True)
def rays_about(rays: FloatArray, row: int, column: int) -> tuple[Vector, Vector, Vector]:
    """Rays through a pixel's centre, and one pixel to the right and below; distortion is linear enough over one."""
    i, j = row + 1, column + 1
    x, y = rays[i, j, 0], rays[i, j, 1]
    right = x + 0.5 * (rays[i, j + 1, 0] - rays[i, j - 1, 0]), y + 0.5 * (rays[i, j + 1, 1] - rays[i, j - 1, 1]), 1.0
    below = x + 0.5 * (rays[i + 1, j, 0] - rays[i - 1, j, 0]), y + 0.5 * (rays[i + 1, j, 1] - rays[i - 1, j, 1]), 1.0
    return (x, y, 1.0), right, below


@nb.njit(cache=True, error_model="numpy")
@cached_by_code
def linearize(
    faces: FloatArray, layout: Int64Array, values: FloatArray, k: int, rays: tuple[Vector, Vector, Vector]
) -> tuple[Vector, Vector, Vector]:
    """What `meet` gives at a pixel's centre, and its derivatives by column and by row [1/px].

    Parameters
    ----------
    rays
        Through the centre, and one pixel to the right and below.
    """
    along, a, b = meet(faces, layout, values, k, rays[0])
    inverse = 1.0 / dot(faces, k, NORMAL, rays[0])
    ray_u, ray_v = dot(faces, k, UNIT_U, rays[0]), dot(faces, k, UNIT_V, rays[0])
    by_column, by_row = _minus(rays[1], rays[0]), _minus(rays[2], rays[0])
    farther = -along * inverse * dot(faces, k, NORMAL, by_column)
    further = -along * inverse * dot(faces, k, NORMAL, by_row)
    return (
        (along, a, b),
        (
            farther,
            farther * ray_u + along * dot(faces, k, UNIT_U, by_column),
            farther * ray_v + along * dot(faces, k, UNIT_V, by_column),
        ),
        (
            further,
            further * ray_u + along * dot(faces, k, UNIT_U, by_row),
            further * ray_v + along * dot(faces, k, UNIT_V, by_row),
        ),
    )
