"""The paper's monocular method: motion in the image plane of one view, scaled by one known length."""

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.covariances import edges_across, find_edges, judged_std
from vfm_sdm.core.datasets import FIRST_SAMPLE, IMAGE_PLANE, DisplacementArrays, check_tracks, make_displacement
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.displacement.edges import OPEN_SHARE, UNKNOWN_MOTION_M
from vfm_sdm.stages.displacement.stereo import find_origin, keep_origin

__all__ = ["PLANE_AXES", "compute_planar_displacement", "measure_planar", "scale_factor"]

PLANE_AXES = ("right", "down")
"""Axes of a displacement in the image plane."""
_NAMED_PIXEL_STD = 0.5
"""Standard deviation of a user's pointing at the end of a length [px]."""


def measure_planar(session: Session, tracks: xr.Dataset) -> xr.Dataset:
    """Displacement in the image plane of a session's single view, scaled by a known length in it.

    Parameters
    ----------
    session
        Points, ``site.length`` (the first counts) and ``method.still_interval_s``.
    tracks
        Tracks of the view, shape (T, P, 2) [px].

    Returns
    -------
    displacement
        Displacement along ``right`` and ``down``, shape (T, P, 2) [mm].

    Raises
    ------
    DatasetError
        The tracks are malformed, or the length's ends coincide.
    """
    length = session.site.length[0]
    # Pixels as high as they are wide: lengths across and along the picture count alike.
    square = np.array([float(tracks.attrs.get("pixel_aspect", 1.0)), 1.0])
    tracks = _stretch(tracks, square)
    ends = [square * p.pixel for name in length.points for p in session.point if p.name == name]
    factor = scale_factor(ends[0], ends[1], length.value * 1e3)
    picked = _NAMED_PIXEL_STD * np.sqrt(2) / np.linalg.norm(ends[0] - ends[1])
    return compute_planar_displacement(
        tracks,
        mm_per_px=factor,
        scale_std=float(np.hypot(length.std / length.value, picked)),
        still_interval_s=session.method.still_interval_s,
    ).assign_attrs(session.start_attrs)


def _stretch(tracks: xr.Dataset, square: FloatArray) -> xr.Dataset:
    """Tracks in units of a pixel's height, from pixels that are ``square[0]`` times as wide as high."""
    if square[0] == 1:
        return tracks
    position, covariance = tracks["position"], tracks["position_covariance"]
    changed = {
        "position": position.copy(data=position.values * square),
        "position_covariance": covariance.copy(data=covariance.values * np.outer(square, square)),
    }
    if "edge_across" in tracks:
        # A line keeps its points: its normal is stretched the other way.
        across = tracks["edge_across"].values / square
        changed["edge_across"] = tracks["edge_across"].copy(
            data=across / np.linalg.norm(across, axis=-1, keepdims=True)
        )
    return tracks.assign(changed)


def compute_planar_displacement(
    tracks: xr.Dataset, *, mm_per_px: float, scale_std: float, still_interval_s: tuple[float, float] | None = None
) -> xr.Dataset:
    """Displacement in the image plane of a single view, in the layout of every displacement dataset.

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px]; with ``origin`` (point, axis) [px] where an earlier part of the
        recording told the places that displacement is relative to.
    mm_per_px
        Scale factor of a known length beside the points, see `scale_factor` [mm/px].
    scale_std
        Relative standard deviation of that factor [1].
    still_interval_s
        Beginning and end [s] of the interval whose mean is the origin of displacement; without it, the origin is the
        first valid sample of each point.

    Returns
    -------
    displacement
        Displacement along the axes ``right`` and ``down`` of the picture, shape (T, P, 2) [mm], with its ``origin``
        (point, axis) [px].

    Raises
    ------
    DatasetError
        The tracks are malformed, the factor is not positive, or no frame lies in the still interval.

    Notes
    -----
    This is the paper's monocular method. It holds only for motion parallel to the image plane, at the distance of the
    known length. The standard deviation is that of the positions, without that of the factor. Positions in space and
    reprojection errors are NaN, because one view does not know them. Of a point that is seen across an edge only, the
    motion along the edge counts as any of `vfm_sdm.stages.displacement.edges.UNKNOWN_MOTION_M`; an axis that it
    leaves a tenth of its variance is NaN.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> position = [[[100.0, 200.0]], [[100.0, 201.5]]]
    >>> tracks = make_tracks([0.0, 0.1], ["mid"], position, np.zeros((2, 1, 2, 2)), np.zeros((2, 1)), attrs={})
    >>> displacement = compute_planar_displacement(tracks, mm_per_px=2.0, scale_std=0.01)
    >>> displacement["displacement"].sel(axis="down").values.ravel().tolist()
    [0.0, 3.0]
    """
    check_tracks(tracks)
    if not (np.isfinite(mm_per_px) and mm_per_px > 0):
        raise DatasetError(f"mm_per_px: expected a positive factor, got {mm_per_px}; use scale_factor")
    position = tracks["position"].values
    valid = np.isfinite(position).all(axis=2)
    origin = keep_origin(tracks, find_origin(position, valid, tracks["time"].values, still_interval_s))
    variance = _find_variance(tracks, UNKNOWN_MOTION_M * 1e3 / mm_per_px)
    not_measured = find_edges(tracks)[:, None] & np.isnan(variance)
    moved = np.where(not_measured, np.nan, position - origin)
    frames, points, axes = position.shape
    displacement = make_displacement(
        tracks["time"].values,
        [str(p) for p in tracks["point"].values],
        PLANE_AXES,
        DisplacementArrays(
            displacement_mm=moved * mm_per_px,
            displacement_std_mm=np.sqrt(variance) * mm_per_px,
            scale_std=np.full((points, axes), scale_std),
            position_m=np.full((frames, points, axes), np.nan),
            reprojection_error_px=np.full((frames, points), np.nan),
            status=tracks["status"].values,
        ),
        attrs={
            "frame": IMAGE_PLANE,
            "mm_per_px": mm_per_px,
            "relative_to": FIRST_SAMPLE if still_interval_s is None else "mean of the still interval",
        },
    )
    return displacement.assign(origin=(("point", "axis"), origin, {"units": "px"}))


def _find_variance(tracks: xr.Dataset, unknown_px: float) -> FloatArray:
    """Variance of the positions along u and v, shape (T, P, 2) [px2]; NaN along an axis that an edge leaves open."""
    covariance = tracks["position_covariance"].values
    variance = np.einsum("tpkk->tpk", covariance)
    across, edge = edges_across(tracks), find_edges(tracks)
    if not edge.any():
        return np.asarray(variance)
    along = np.stack([-across[:, 1], across[:, 0]], axis=-1)
    stated = judged_std(covariance, across) ** 2
    of_edge = stated[..., None] * across**2 + unknown_px**2 * along**2
    of_edge = np.where(of_edge > OPEN_SHARE * unknown_px**2, np.nan, of_edge)
    return np.where(edge[:, None], of_edge, variance)


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

    Examples
    --------
    >>> scale_factor([100.0, 200.0], [100.0, 300.0], 500.0)
    5.0
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
