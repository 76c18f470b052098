"""Straight edges of a simulated structure as pictures would show them, with all that members differ by."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.matching.straight_edges import StraightEdges

__all__ = ["draw_directions", "draw_edges"]

_POINT_STD_PX, _CORRELATION = 0.15, 3.0
"""Of an edge point, and how many successive ones count as one."""
_TRIES = 40


def draw_directions(rng: np.random.Generator, out_of_square_deg: float, out_of_plumb_deg: float = 0.0) -> FloatArray:
    """Directions of lateral, vertical and longitudinal edges in the structure's axes, shape (3, 3): drawn off them."""
    along = np.eye(3)
    for axis in range(3):
        for towards in {0, 1, 2} - {axis}:
            along[axis, towards] = rng.normal(0, np.radians(out_of_square_deg) / np.sqrt(2))
    tilt = rng.normal(0, np.radians(out_of_plumb_deg), 3) * [1.0, 0.0, 1.0]
    return along + np.cross(tilt, along)


def draw_edges(
    rng: np.random.Generator,
    rig: Rig,
    directions: FloatArray,
    *,
    members: tuple[int, int, int] = (0, 60, 60),
    foreign: int = 20,
    slant_deg: float = 0.2,
    bow: float = 3e-4,
) -> tuple[StraightEdges, ...]:
    """Edges of every view: the same members in all, out of line and bent each in its way, and foreign ones.

    Parameters
    ----------
    rng
        Draws everything.
    rig
        True cameras.
    directions
        Directions of the members of each axis in the frame of the rig, shape (3, 3).
    members, foreign
        Number of members along each axis, and of edges of any direction.
    slant_deg, bow
        Standard deviations of a member's angle to its direction [deg], and of its middle from the chord, over its
        length [1].
    """
    camera = rig.cameras[0]
    size = np.array(camera.image_size)
    drawn: list[list[tuple[FloatArray, float, float]]] = [[] for _ in rig.cameras]
    kinds = [axis for axis, count in enumerate(members) for _ in range(count)] + [-1] * foreign
    for axis in kinds:
        for _ in range(_TRIES):
            direction = rng.normal(size=3) if axis < 0 else directions[axis] / np.linalg.norm(directions[axis])
            direction = direction / np.linalg.norm(direction)
            direction = direction + np.cross(rng.normal(0, np.radians(slant_deg), 3), direction)
            pixel, depth = rng.uniform(0, size), 20.0 * rng.uniform(0.8, 1.4)
            middle = depth * np.append(camera.normalize(pixel), 1.0)
            half = depth * rng.uniform(50, 400) / camera.focal_px
            bent = rng.normal(0, bow) * 2 * half * np.cross(direction, rng.normal(size=3))
            places = middle + np.array([[-half], [0.0], [half]]) * direction + [[0], [1], [0]] * bent
            seen = [c.project(places) for c in rig.cameras]
            if all(_is_seen(u, size) for u in seen):
                break
        else:
            continue
        for found, u in zip(drawn, seen, strict=True):
            found.append(_measure(rng, u))
    return tuple(
        StraightEdges(view, *(np.array(part) for part in zip(*found, strict=True))) for view, found in enumerate(drawn)
    )


def _is_seen(u: FloatArray, size: FloatArray) -> bool:
    inside = np.isfinite(u).all() and bool(((u >= 0) & (u <= size - 1)).all())
    return inside and float(np.linalg.norm(u[2] - u[0])) > 40


def _measure(rng: np.random.Generator, u: FloatArray) -> tuple[FloatArray, float, float]:
    """Places with errors of the edge points, and the standard deviations of slope and bow [px]."""
    along = u[2] - u[0]
    length = float(np.linalg.norm(along))
    normal = np.array([-along[1], along[0]]) / length
    count = length / _CORRELATION
    slope_std, bow_std = _POINT_STD_PX * np.sqrt(3 / count), 1.5 * _POINT_STD_PX * np.sqrt(5 / count)
    slope, bow = rng.normal(0, slope_std), rng.normal(0, bow_std)
    return u + np.outer([-slope, bow, slope], normal), float(slope_std), float(bow_std)
