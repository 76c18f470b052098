"""What of a point's motion two views see alike: the channels that are compared to find the lag between them."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, mean_of_known
from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.synchronize.search import Group

__all__ = ["compare_points"]

_HELD = 10.0
"""A position that scatters less than its stated standard deviation over this is held, not measured: an edge tells
nothing of motion along itself."""
_STEP = 1e-4
"""Length of the small motion that shows how two cameras see motion across the epipolar plane, in baselines."""


def compare_points(
    tracks_a: xr.Dataset, tracks_b: xr.Dataset, points: Sequence[str], rig: Rig | None
) -> tuple[FloatArray, FloatArray, list[Group]]:
    """Channels of both views, and which of them belong to each point.

    Parameters
    ----------
    tracks_a, tracks_b
        Tracks of the two views, shapes (Ta, P, 2) and (Tb, P, 2) [px].
    points
        Names of N points that both have.
    rig
        The cameras of the two views; with them only the motion across the epipolar plane is compared, which is one and
        the same in both. ``None`` compares u and v with u and v.

    Returns
    -------
    values_a, values_b
        Positions along the compared directions, shapes (Ta, C) and (Tb, C) [px]; NaN where not ok.
    groups
        Channels of every point, length N.

    Notes
    -----
    A point on an edge is measured across it alone, in either view; then that one direction is compared. Its sign is
    that of the other view's direction nearest to it, which holds for cameras that stand upright.
    """
    columns: list[tuple[FloatArray, FloatArray]] = []
    groups: list[Group] = []
    for name in points:
        a, b = (trusted_values(t.sel(point=[name]), "position")[:, 0] for t in (tracks_a, tracks_b))
        edges = [_edge_direction(t.sel(point=name), p) for t, p in ((tracks_a, a), (tracks_b, b))]
        across = None if rig is None else _across(rig, mean_of_known(a), mean_of_known(b))
        directions = _shared_directions(edges, across)
        first = sum(pair[0].shape[1] for pair in columns)
        columns.append((a @ directions[0].T, b @ directions[1].T))
        channels = tuple(range(first, first + len(directions[0])))
        groups.append((channels, channels))
    return np.hstack([pair[0] for pair in columns]), np.hstack([pair[1] for pair in columns]), groups


def _edge_direction(track: xr.Dataset, position: FloatArray) -> FloatArray | None:
    """Direction (2,) across the edge that a point lies on; ``None`` where it is measured in both or in none.

    Parameters
    ----------
    track
        Track of one point; its covariances (T, 2, 2) [px2] say in which direction it is held.
    position
        Its positions, shape (T, 2) [px]; NaN where not ok.
    """
    known = np.isfinite(position).all(axis=1)
    if not known.any():
        return None
    covariance = np.median(track["position_covariance"].values[known], axis=0)
    if not np.isfinite(covariance).all():
        return None
    variances, axes = np.linalg.eigh(covariance)
    measured = _HELD * (position[known] @ axes).std(axis=0) >= np.sqrt(np.maximum(variances, 0.0))
    across: FloatArray = axes[:, 0]
    return across if measured.tolist() == [True, False] else None


def _shared_directions(
    edges: Sequence[FloatArray | None], across: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray]:
    """Directions in two views along which a point's motion is compared, shapes (D, 2) [1]."""
    known = [edge for edge in edges if edge is not None]
    if not known:
        return (np.eye(2), np.eye(2)) if across is None else (across[0][None], across[1][None])
    # With an edge in one view alone, the other is compared along the same direction.
    one, other = known[0], known[-1]
    return one[None], (other if one @ other >= 0 else -other)[None]


def _across(rig: Rig, place_a: FloatArray, place_b: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Unit vectors (2,) across the epipolar lines of a point in both views; ``None`` where its rays do not meet.

    Motion in the epipolar plane has no part along them, and motion across it the same sign in both.
    """
    point = triangulate(np.stack([place_a, place_b]), rig)
    normal = np.cross(point - rig.cameras[0].center, point - rig.cameras[1].center)
    size = float(np.linalg.norm(normal))
    if not size > 0:
        return None
    normal = normal / size
    step = _STEP * rig.baseline()
    found = []
    for camera in rig.cameras:
        ray = (point - camera.center) / np.linalg.norm(point - camera.center)
        along = _seen(camera, point, step * np.cross(normal, ray))
        upright = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        found.append(upright if upright @ _seen(camera, point, step * normal) >= 0 else -upright)
    one, other = found
    return (one, other) if np.isfinite(found).all() else None


def _seen(camera: Camera, point: FloatArray, step: FloatArray) -> FloatArray:
    """Motion (2,) [px] of a point that takes a small step (3,) [length unit of the rig]."""
    return camera.project(point + step) - camera.project(point - step)
