"""Compiled loop over the edges of a picture: the faces around each blended as the point spread covers them."""

import math

import numba as nb
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.studies.synthetic.cast_arrays import (
    BLUR_PX,
    EDGE_PX,
    LENGTH,
    SPREAD_U,
    SPREAD_V,
    TILE,
    Coefficients,
    FaceImage,
    Int64Array,
    LumaImage,
    PlainArrays,
    Vector,
)
from vfm_sdm.studies.synthetic.rays import linearize, rays_about, sample

__all__ = ["smooth_edges"]

_FAR = 4.0
"""Beyond this the error function is 1 to 2e-8."""
_SAMPLES = SPREAD_U.size


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
def _neighbours(face: FaceImage, row: int, column: int) -> tuple[int, int]:
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
def _gather(face: FaceImage, listed: Int64Array, row: int, column: int, near: FloatArray) -> int:
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
@cached_by_code
def _blend_two(
    faces: FloatArray,
    layout: Int64Array,
    values: FloatArray,
    pair: tuple[int, int],
    rays: tuple[Vector, Vector, Vector],
) -> tuple[float, Vector, Vector]:
    """Share of the first of two faces in the point spread, and where the centre meets each (`meet`).

    The edge between them belongs to the one in front, or, where their planes cross nearby, to the one that ends there;
    the share is -1 where that is not clear. Exact for one straight edge, since the point spread is isotropic; near a
    corner the shares along u and v are multiplied, exact for a right angle.
    """
    first, second = (-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
    column_first, row_first = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    column_second, row_second = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    share_first, share_second = 0.0, 0.0
    if pair[0] >= 0:
        first, column_first, row_first = linearize(faces, layout, values, pair[0], rays)
        share_first = _share(first[1], faces[pair[0], LENGTH], column_first[1], row_first[1])
        share_first *= _share(first[2], faces[pair[0], LENGTH + 1], column_first[2], row_first[2])
    if pair[1] >= 0:
        second, column_second, row_second = linearize(faces, layout, values, pair[1], rays)
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
    layout: Int64Array,
    coefficients: Coefficients,
    near: FloatArray,
    rays: tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]],
    sky: float,
) -> float:
    """Mean luma under the point spread, each face's texture taken at the pixel's centre.

    Parameters
    ----------
    near
        A row a face: its index, and what `linearize` gives, shape (N, 10).
    rays
        Room for the distance to the nearest face on each ray of the point spread, and for its row in ``near``.

    Notes
    -----
    Face by face over all rays, without branches, so that the compiler takes several rays at once.
    """
    distance, nearest = rays
    for m in range(_SAMPLES):
        distance[m], nearest[m] = np.inf, -1
    for n in range(len(near)):
        k = int(near[n, 0])
        along, along_u, along_v = np.float32(near[n, 1]), np.float32(near[n, 4]), np.float32(near[n, 7])
        a, a_u, a_v = np.float32(near[n, 2]), np.float32(near[n, 5]), np.float32(near[n, 8])
        b, b_u, b_v = np.float32(near[n, 3]), np.float32(near[n, 6]), np.float32(near[n, 9])
        length_a, length_b = np.float32(faces[k, LENGTH]), np.float32(faces[k, LENGTH + 1])
        none = np.float32(0)
        for m in range(_SAMPLES):
            du, dv = SPREAD_U[m], SPREAD_V[m]
            far = along + du * along_u + dv * along_v
            at_a = a + du * a_u + dv * a_v
            at_b = b + du * b_u + dv * b_v
            hit = (far > none) & (far < distance[m])
            hit &= (at_a >= none) & (at_a <= length_a) & (at_b >= none) & (at_b <= length_b)
            distance[m] = far if hit else distance[m]
            nearest[m] = np.int32(n) if hit else nearest[m]
    total, seen = 0.0, 0
    for n in range(len(near)):
        hits = 0
        for m in range(_SAMPLES):
            hits += nearest[m] == n
        if hits > 0:
            total += hits * sample(faces, layout, coefficients, int(near[n, 0]), near[n, 2], near[n, 3])
            seen += hits
    return (total + (_SAMPLES - seen) * sky) / _SAMPLES


# The arrays that it fills are arguments of their own, because numba's parallel mode drops writes to arrays that it
# reaches through a tuple.
@nb.njit(cache=True, error_model="numpy", parallel=True)
@cached_by_code
def smooth_edges(
    arrays: PlainArrays,
    edges: BoolArray,
    luma: LumaImage,
    face: FaceImage,
    rows: tuple[int, int],
) -> None:
    """Blends the faces around an edge by how much of the pixel's point spread each covers, in place.

    A function of its own, because it needs the faces of the neighbouring rows complete. Two faces are blended in
    closed form, more by samples. Textures are taken at the pixel's centre, a little beyond the edge for some: they
    are what the camera makes of the surface, whereas an edge must still be blurred, or the image would alias.

    Parameters
    ----------
    arrays, luma, face
        As in `vfm_sdm.studies.synthetic.raycast.render_pixels`.
    edges
        Pixels that an edge may reach, shape (H, W).
    rows
        As in `vfm_sdm.studies.synthetic.raycast.move_pixels`.
    """
    faces, layout, coefficients, rays, candidates, sky, values = arrays
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
            three = rays_about(rays, row, column)
            if kinds == 2:
                here = int(face[row, column])
                share, _, second = _blend_two(faces, layout, values, (here, other), three)
                if share >= 0:
                    beyond = float(sky[row, column])
                    if other >= 0:
                        beyond = sample(faces, layout, coefficients, other, second[1], second[2])
                    luma[row, column] = share * luma[row, column] + (1 - share) * beyond
                    continue
            listed = _gather(face, candidates[row // TILE, column // TILE], row, column, near)
            count = 0
            for n in range(listed):
                k = int(near[n, 0])
                center, by_column, by_row = linearize(faces, layout, values, k, three)
                if center[0] > 0:
                    near[count, 0] = k
                    for m in range(3):
                        near[count, 1 + m], near[count, 4 + m], near[count, 7 + m] = center[m], by_column[m], by_row[m]
                    count += 1
            luma[row, column] = _blend_many(faces, layout, coefficients, near[:count], spread, float(sky[row, column]))
