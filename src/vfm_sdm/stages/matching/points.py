"""The points that a session names, as one dataset: where they lie in every view, in its first frame or a later one."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import Session

__all__ = ["NAMED_STD_PX", "check_inside", "named_points", "state_frames"]

NAMED_STD_PX = 1.5
"""Standard deviation of a place that a user named, along each axis [px]: a click on a picture that is seen whole."""


def check_inside(session: Session, frames: Mapping[str, LumaArray]) -> None:
    """Refuses named pixels outside their picture.

    Parameters
    ----------
    session
        The measurement, which names the points.
    frames
        First frame of every view, shape (H, W); only the sizes [px] are used.

    Raises
    ------
    SessionError
        A pixel lies outside; the message names every such point.
    """
    faults = []
    for point in session.point:
        for view, (u, v) in {point.view: point.pixel, **point.pixel_in}.items():
            height, width = frames[view].shape
            if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
                faults.append(
                    f"{point.name!r} in view {view!r}: expected inside {width} x {height}, got ({u:g}, {v:g})"
                )
    if faults:
        raise SessionError("points: " + "; ".join(faults) + "; correct their pixels")


def named_points(
    session: Session, views: Sequence[str], reference_frames: Mapping[str, Mapping[str, int]] | None = None
) -> xr.Dataset:
    """Points dataset with the pixels that the session names, exact in a point's own view, a click in others.

    Parameters
    ----------
    session
        The measurement, which names the points.
    views
        Names of the V views, in order.
    reference_frames
        Numbers of the frames in which points are named, by view and point; the first one of points that are not in it.

    Returns
    -------
    points
        Points dataset with the pixels of P points, shape (V, P, 2) [px]; with ``frame`` (view, point), where one is
        named in another frame than the first.
    """
    shape = (len(views), len(session.point))
    position = np.full((*shape, 2), np.nan)
    status = np.full(shape, PointStatus.NOT_LOOKED_FOR, dtype=object)
    std = np.full((*shape, 2), np.nan)
    for number, point in enumerate(session.point):
        for view, pixel in point.pixel_in.items():
            if view not in views:
                continue
            there = views.index(view), number
            position[there], status[there], std[there] = pixel, PointStatus.OK, NAMED_STD_PX
        # The point is where it was named first: what it is called elsewhere is as exact as a click.
        here = views.index(point.view), number
        position[here], status[here], std[here] = point.pixel, PointStatus.OK, 0.0
    names = [point.name for point in session.point]
    points = make_points(views, names, position=position, position_std=std, status=status)
    return state_frames(points, reference_frames or {})


def state_frames(points: xr.Dataset, reference_frames: Mapping[str, Mapping[str, int]]) -> xr.Dataset:
    """Points with the numbers of the frames in which their places are; as they are where all are in the first ones.

    Parameters
    ----------
    points
        Points dataset, positions of shape (V, P, 2) [px].
    reference_frames
        Numbers by view and point; the first frame of points that are not in it.
    """
    views, names = (points[dim].values.tolist() for dim in ("view", "point"))
    numbers = [[reference_frames.get(view, {}).get(name, 0) for name in names] for view in views]
    return points.assign(frame=(("view", "point"), np.array(numbers))) if np.any(numbers) else points
