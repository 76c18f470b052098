"""Compiled votes of matches on a face for poses of the second camera."""

import numpy as np
import numpy.typing as npt
from numba import njit

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.compiled import cached_by_code

__all__ = ["Integers", "count_votes"]

Integers = npt.NDArray[np.int64]
_LEAST_LENGTH, _LONGEST_PX = 1e-12, 1e6


@njit(nogil=True, cache=True, error_model="numpy")
@cached_by_code
def count_votes(
    rotations: FloatArray,
    points: tuple[FloatArray, FloatArray, FloatArray],
    scale: tuple[float, float],
    cells: tuple[Integers, Integers],
    places: Integers,
) -> None:
    """Counts the places in the images where matches agree with poses.

    Parameters
    ----------
    rotations
        From the second camera to the structure's axes, shape (K, 3, 3) [1].
    points
        Points on the face and a standard deviation behind it, as seen from the second camera's centre along the
        structure's axes, shape (N, 3) each [m], and where the second camera saw them, shape (N, 2) [1].
    scale
        Focal length of the second camera, and the tolerance [px].
    cells
        Numbers of the cells of both images where each match stands, shape (N,) each.
    places
        Receives the number of cells with a match that agrees, in the image where they are fewer, shape (K,).

    Notes
    -----
    The same test as `vfm_sdm.stages.cameras.face_poses._Ground.agree`, of a few hundred thousand pairs of pose and
    match without arrays between them.
    """
    near, far, rays = points
    focal, limit = scale
    seen_first, seen_second = np.full(cells[0].max() + 1, -1), np.full(cells[1].max() + 1, -1)
    for k in range(len(rotations)):
        R = rotations[k]
        first = second = 0
        for n in range(len(near)):
            depth = near[n, 0] * R[0, 2] + near[n, 1] * R[1, 2] + near[n, 2] * R[2, 2]
            if not depth > 0:
                continue
            beyond = far[n, 0] * R[0, 2] + far[n, 1] * R[1, 2] + far[n, 2] * R[2, 2]
            u = (near[n, 0] * R[0, 0] + near[n, 1] * R[1, 0] + near[n, 2] * R[2, 0]) / depth
            v = (near[n, 0] * R[0, 1] + near[n, 1] * R[1, 1] + near[n, 2] * R[2, 1]) / depth
            shift_u = (far[n, 0] * R[0, 0] + far[n, 1] * R[1, 0] + far[n, 2] * R[2, 0]) / beyond - u
            shift_v = (far[n, 0] * R[0, 1] + far[n, 1] * R[1, 1] + far[n, 2] * R[2, 1]) / beyond - v
            length = np.sqrt(shift_u * shift_u + shift_v * shift_v)
            unit_u, unit_v = shift_u / max(length, _LEAST_LENGTH), shift_v / max(length, _LEAST_LENGTH)
            off_u, off_v = rays[n, 0] - u, rays[n, 1] - v
            across = focal * (off_u * unit_v - off_v * unit_u)
            along = focal * (off_u * unit_u + off_v * unit_v)
            reach = 2 * min(focal * length, _LONGEST_PX)
            if abs(across) < limit and abs(along) < np.sqrt(limit * limit + reach * reach):
                if seen_first[cells[0][n]] != k:
                    seen_first[cells[0][n]] = k
                    first += 1
                if seen_second[cells[1][n]] != k:
                    seen_second[cells[1][n]] = k
                    second += 1
        places[k] = min(first, second)
