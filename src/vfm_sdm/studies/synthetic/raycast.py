"""Compiled loops over the pixels of a picture: the nearest face on each ray, and the texture there."""

import math
from typing import Any

import numba as nb

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.studies.synthetic.cast_arrays import (
    FAST,
    MIXED,
    MIXED_FRONT,
    NORMAL,
    OFFSET,
    TILE,
    UNIT_U,
    UNIT_V,
    Coefficients,
    FaceImage,
    Int64Array,
    LumaImage,
    PlainArrays,
    Vector,
)
from vfm_sdm.studies.synthetic.rays import cast, displaced, dot, meet, ray_through, sample

__all__ = ["mark_tiles", "move_pixels", "render_pixels"]


@nb.njit(error_model="numpy", forceinline=True, fastmath=FAST)
def _sample_moved(
    faces: FloatArray,
    layout: Int64Array,
    values: FloatArray,
    coefficients: Coefficients,
    k: Any,
    ray: Vector,
) -> float:
    """Luma of a displaced face on a ray that is known to meet it: `meet` and `sample` without their checks."""
    inverse = 1.0 / dot(faces, k, NORMAL, ray)
    along_u, along_v = inverse * dot(faces, k, UNIT_U, ray), inverse * dot(faces, k, UNIT_V, ray)
    distance = faces[k, OFFSET]
    at_rest = distance * along_u - faces[k, OFFSET + 1], distance * along_v - faces[k, OFFSET + 2]
    _, a, b = displaced(faces, layout, values, k, at_rest, (inverse, along_u, along_v))
    return sample(faces, layout, coefficients, k, a, b)


# The arrays that the next ones fill are arguments of their own, because numba's parallel mode drops writes to arrays
# that it reaches through a tuple.
@nb.njit(cache=True, error_model="numpy", parallel=True)
@cached_by_code
def render_pixels(arrays: PlainArrays, luma: LumaImage, face: FaceImage) -> None:
    """Draws all pixels in place with one ray each: enough inside a face, because textures are band-limited.

    Parameters
    ----------
    arrays
        What to draw, of `vfm_sdm.studies.synthetic.cast_arrays.CastArrays`.
    luma, face
        What to fill, shape (H, W): luma and the index of the face seen, -1 for the sky.
    """
    faces, layout, coefficients, rays, candidates, sky, values = arrays
    height, width = face.shape
    for row in nb.prange(height):
        for column in range(width):
            ray = ray_through(rays, row, column)
            k, a, b = cast(faces, layout, values, candidates, (row // TILE, column // TILE), ray)
            face[row, column] = k
            luma[row, column] = sky[row, column] if k < 0 else sample(faces, layout, coefficients, k, a, b)


@nb.njit(cache=True, error_model="numpy", parallel=True, fastmath=FAST)
@cached_by_code
def move_pixels(
    arrays: PlainArrays,
    plan: tuple[BoolArray, FaceImage, FloatArray, BoolArray, BoolArray],
    luma: LumaImage,
    face: FaceImage,
    edges: BoolArray,
    rows: tuple[int, int],
) -> None:
    """Draws again, in place, the pixels of a picture at rest that a displacement changes.

    Where the neighbourhood that a pixel's content came from shows one face alone, that face is drawn without a search.

    Parameters
    ----------
    arrays
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
    faces, layout, coefficients, rays, candidates, sky, values = arrays
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
            ray = ray_through(rays, row, column)
            if there >= 0 and moving[there] and here != MIXED_FRONT and (here < 0 or not front[here]):
                face[row, column] = there
                luma[row, column] = _sample_moved(faces, layout, values, coefficients, nb.uintp(there), ray)
            elif here != there or here <= MIXED:
                k, a, b = cast(faces, layout, values, candidates, tile, ray)
                face[row, column] = k
                luma[row, column] = sky[row, column] if k < 0 else sample(faces, layout, coefficients, k, a, b)
                edges[row, column] = True


@nb.njit(cache=True, error_model="numpy", parallel=True)
@cached_by_code
def mark_tiles(arrays: PlainArrays, marks: BoolArray) -> None:
    """Sets ``marks[face, tile_v, tile_u]`` where a face comes near a pixel of the tile, hidden or not.

    Every other pixel is enough, because `meet` looks `SLACK_PX` beyond a face's edges.
    """
    faces, layout, _, rays, _, _, values = arrays
    height, width = rays.shape[0] - 2, rays.shape[1] - 2
    for tile_row in nb.prange(marks.shape[1]):
        for row in range(tile_row * TILE, min((tile_row + 1) * TILE, height), 2):
            for column in range(0, width, 2):
                ray = ray_through(rays, row, column)
                for k in range(marks.shape[0]):
                    if not marks[k, tile_row, column // TILE]:
                        marks[k, tile_row, column // TILE] = meet(faces, layout, values, k, ray)[0] > 0
