"""Synchronised tracks as the geometry takes them."""

import xarray as xr

from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.visibility import Disagreement, Sightings, see_points

__all__ = ["see_tracks"]


def see_tracks(tracks: xr.Dataset, rig: Rig) -> Sightings:
    """Pixels and weights of the views that are used for each sample.

    Parameters
    ----------
    tracks
        Tracks with a dim ``view``, in the order of the rig's cameras, shape (V, T, P, 2) [px]; with ``view_shift``
        (view, point, pixel) [px], its covariance and ``view_shift_known`` (view, point) where an earlier part of the
        recording told how the views disagree.
    rig
        V cameras.
    """
    known = None
    if "view_shift" in tracks:
        known = Disagreement(
            tracks["view_shift"].transpose("view", "point", "pixel").values,
            tracks["view_shift_covariance"].transpose("view", "point", "pixel_a", "pixel_b").values,
            tracks["view_shift_known"].transpose("view", "point").values > 0,
        )
    trusted = tracks["status"].values == Status.OK
    return see_points(tracks["position"].values, tracks["position_covariance"].values, trusted, rig, known)
