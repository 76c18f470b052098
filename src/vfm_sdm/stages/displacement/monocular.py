"""The paper's monocular baseline: motion in the image plane of one view, scaled by one known length."""

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import as_float_array
from vfm_sdm.core.datasets import check_tracks, make_displacement, status_variable
from vfm_sdm.errors import DatasetError

__all__ = ["PLANE_AXES", "compute_planar_displacement", "planar_displacement", "scale_factor"]

PLANE_AXES = ("right", "down")
"""Axes of a displacement in the image plane."""


def compute_planar_displacement(tracks: xr.Dataset, *, mm_per_px: float, scale_std: float) -> xr.Dataset:
    """Displacement in the image plane of a single view, in the layout of every displacement dataset.

    Parameters
    ----------
    tracks
        Tracks of one view.
    mm_per_px
        Scale factor of a known length beside the points, see `vfm_sdm.stages.displacement.monocular.scale_factor`.
    scale_std
        Relative standard deviation of that factor [1].

    Notes
    -----
    The paper's monocular baseline: right only for motion parallel to the image plane at the distance of the known
    length. Positions in space and reprojection errors are NaN, because one view does not know them.
    """
    planar = planar_displacement(tracks, mm_per_px)
    frames, points, axes = planar["displacement"].shape
    return make_displacement(
        planar["time"].values,
        [str(p) for p in planar["point"].values],
        [str(a) for a in planar["axis"].values],
        displacement_mm=planar["displacement"].values,
        displacement_std_mm=planar["displacement_std"].values,
        scale_std=np.full((points, axes), scale_std),
        position_m=np.full((frames, points, axes), np.nan),
        reprojection_error_px=np.full((frames, points), np.nan),
        status=planar["status"].values,
        attrs={"frame": "image plane", "mm_per_px": mm_per_px, "relative_to": "first valid sample"},
    )


def scale_factor(pixel_a: npt.ArrayLike, pixel_b: npt.ArrayLike, length_mm: float) -> float:
    """Millimetres a pixel, from a known length in the plane of motion, parallel to the image plane [mm/px].

    Parameters
    ----------
    pixel_a, pixel_b
        Ends of the length in the image, shape (2,) [px].
    length_mm
        The length [mm].

    Raises
    ------
    DatasetError
        The pixels coincide or are not finite, or the length is not positive.
    """
    ends = np.stack([as_float_array(pixel_a, "pixel_a", (2,)), as_float_array(pixel_b, "pixel_b", (2,))])
    distance_px = float(np.linalg.norm(ends[1] - ends[0]))
    if not (np.isfinite(distance_px) and distance_px > 0):
        raise DatasetError(
            f"pixel_a, pixel_b: expected two distinct finite pixels, got {ends.tolist()}; name both ends of the length"
        )
    if not (np.isfinite(length_mm) and length_mm > 0):
        raise DatasetError(f"length_mm: expected a positive length, got {length_mm}; measure it in millimetres")
    return float(length_mm) / distance_px


def planar_displacement(tracks: xr.Dataset, mm_per_px: float) -> xr.Dataset:
    """Displacement in the image plane from tracks of one view and a scale factor.

    Parameters
    ----------
    tracks
        Tracks of one view (see `vfm_sdm.core.datasets`).
    mm_per_px
        From `scale_factor` [mm/px].

    Returns
    -------
    xr.Dataset
        ``displacement`` and ``displacement_std`` [mm] (time, point, axis), axes ``right`` and ``down``, relative to
        the first frame in which the point has a position; ``status`` (time, point).

    Raises
    ------
    DatasetError
        The tracks are malformed, or the factor is not positive.

    Notes
    -----
    Right only for motion parallel to the image plane, at the distance of the known length: that is the limit of the
    method. The standard deviation is that of the positions, without that of the factor.
    """
    check_tracks(tracks)
    if not (np.isfinite(mm_per_px) and mm_per_px > 0):
        raise DatasetError(f"mm_per_px: expected a positive factor, got {mm_per_px}; use scale_factor")
    position = tracks["position"].values
    valid = np.isfinite(position).all(axis=2)
    first = valid.argmax(axis=0)
    origin = position[first, np.arange(position.shape[1])]
    variance = np.einsum("tpkk->tpk", tracks["position_covariance"].values)
    dims = ("time", "point", "axis")
    return xr.Dataset(
        {
            "displacement": (dims, (position - origin) * mm_per_px, {"units": "mm"}),
            "displacement_std": (dims, np.sqrt(variance) * mm_per_px, {"units": "mm"}),
            "status": status_variable(dims[:2], tracks["status"].values),
        },
        coords={"time": tracks["time"], "point": tracks["point"], "axis": list(PLANE_AXES)},
        attrs={**tracks.attrs, "frame": "image plane", "mm_per_px": mm_per_px},
    )
