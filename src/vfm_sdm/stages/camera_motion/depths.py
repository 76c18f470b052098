"""What points move along the rays of cameras that move far: two views tell it, and only then are both exact."""

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate

__all__ = ["DEPTH_SLOPE", "REST_PLACE", "follow_depths"]

DEPTH_SLOPE, REST_PLACE = "depth_slope", "rest_place"
"""Variables of tracks of cameras that move far: change of a position with what its point moves (time, point, pixel,
space) [px/m], and where points are at rest (point, space) [m]."""
_ROUNDS = 3


def follow_depths(aligned: xr.Dataset, rig: Rig | None) -> xr.Dataset:
    """Synchronised tracks of cameras that move far, with the depths that points really have in every frame.

    Parameters
    ----------
    aligned
        Synchronised tracks, shape (V, T, P, 2) [px], mapped back to cameras at rest at the depths of points at rest.
    rig
        The cameras at rest; without them nothing is changed.

    Returns
    -------
    aligned
        Without the variables that only this needs.

    Notes
    -----
    A camera that is 0.5 m beside its rest sees a point that comes 10 mm nearer, at 20 m, shift by 0.0125 mm a
    millimetre. Displacement by both views gives the depth, this the positions, and these the displacement; each round
    leaves a fortieth.
    """
    if DEPTH_SLOPE not in aligned:
        return aligned
    slope = np.nan_to_num(aligned[DEPTH_SLOPE].transpose("view", "time", "point", "pixel", "space").values)
    place = aligned[REST_PLACE].transpose("view", "point", "space").values
    rest = place[np.isfinite(place).all(axis=(1, 2)).argmax()]
    found = aligned.drop_vars([DEPTH_SLOPE, REST_PLACE])
    if rig is None or len(rig) < 2:
        return found
    given, position = aligned["position"].values, trusted_values(aligned, "position")
    shift = np.zeros_like(given)
    for _ in range(_ROUNDS):
        moved = np.nan_to_num(triangulate(position + shift, rig) - rest)
        shift = np.einsum("vtpij,tpj->vtpi", slope, moved)
    return found.assign(position=found["position"].copy(data=given + shift))
