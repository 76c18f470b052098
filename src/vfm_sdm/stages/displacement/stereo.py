"""Tracks and cameras to displacement in millimetres along the structure's axes (paper, section Triangulation)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import CAMERA_AXES, PIXEL, STRUCTURE_AXES, Status, check_tracks, make_displacement
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.propagation import (
    compute_gain_covariance,
    compute_gain_sensitivity,
    compute_position_covariance,
    triangulation_jacobian,
)
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import compute_reprojection_error, in_front_of_all, triangulate

__all__ = ["compute_displacement"]

_MM_PER_M = 1e3


def compute_displacement(
    tracks: xr.Dataset,
    rig: Rig,
    *,
    frame: StructureFrame | None = None,
    covariance: FloatArray | None = None,
    refinement_gain: FloatArray | None = None,
    still_interval_s: tuple[float, float] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Displacement dataset of all points from synchronised tracks.

    Parameters
    ----------
    tracks
        Tracks with a dim ``view``, in the order of the rig's cameras, on one clock.
    rig
        Metric cameras.
    frame
        The structure's axes; without them displacement is along the reference camera's own axes
        (right, down, forward).
    covariance
        Joint covariance of rig parameters and axes, shape (10 V + 3, 10 V + 3); ``None`` when nothing is known of it,
        and then ``scale_std`` is NaN.
    refinement_gain
        Where the tracks were refined: refined displacement along each axis from displacement along each as the images
        alone give it, shape (P, 3, 3) [1]; NaN for points that were not refined.
    still_interval_s
        Displacement is relative to the mean over this interval; else to the first valid sample of each point.
    attrs
        Further attributes of the dataset.

    Raises
    ------
    DatasetError
        The tracks are not synchronised, their views are not the rig's, the rig is not metric, or no frame lies in the
        still interval.

    Notes
    -----
    The random part of the uncertainty is the tracks' covariance through the triangulation; it leaves out what all
    frames share, because the reference frame's noise shifts a whole series and not its motion. The systematic part is
    the gain of each axis under the covariance of cameras and axes (`compute_gain_std`); ``gain_std`` also holds the
    leakage from motion along one axis into another, and ``gain_covariance`` what
    `vfm_sdm.stages.displacement.uncertainty` needs for any displacement. ``pixel_sensitivity`` is how each pixel
    coordinate moves the result.
    """
    check_tracks(tracks, synchronized=True)
    names = tuple(str(name) for name in tracks["view"].values)
    if names != rig.names:
        raise DatasetError(f"tracks: expected views {list(rig.names)}, got {list(names)}; select and order them")
    if not rig.metric:
        raise DatasetError("rig: expected metres, got an unknown scale; measure the baseline")
    pixels = tracks["position"].values
    points3d = triangulate(pixels, rig)
    behind = np.isfinite(points3d).all(axis=-1) & ~in_front_of_all(points3d, rig)
    points3d = np.where(behind[..., None], np.nan, points3d)
    status = _combined_status(tracks["status"].values, behind)
    valid = np.asarray(np.isfinite(points3d).all(axis=-1))

    rotation = np.eye(3) if frame is None else frame.rotation
    position = points3d @ rotation.T
    origin = _reference_position(position, valid, tracks["time"].values, still_interval_s)

    # Pixels hardly move compared with the distance: one linearisation a point serves the whole recording.
    anchor = _first_valid(pixels, valid)
    jacobian = np.einsum("ai,pivk->pavk", rotation, triangulation_jacobian(anchor, rig))
    applied = np.broadcast_to(np.eye(3), (pixels.shape[2], 3, 3))
    if refinement_gain is not None:
        applied = np.where(np.isfinite(refinement_gain), refinement_gain, applied)
    jacobian = np.einsum("pab,pbvk->pavk", applied, jacobian)
    random = compute_position_covariance(jacobian, tracks["position_covariance"].values)
    random_std = np.sqrt(np.einsum("tpaa->tpa", random))

    axes = CAMERA_AXES if frame is None else STRUCTURE_AXES
    gain_covariance = np.full((pixels.shape[2], 3, 3, 3), np.nan)
    if covariance is not None:
        sensitivity = compute_gain_sensitivity(anchor, rig)
        gain_covariance = compute_gain_covariance(sensitivity, rotation, covariance, refinement_gain=applied)
    gain_std = np.sqrt(np.maximum(np.einsum("pabb->pab", gain_covariance), 0.0))
    displacement = make_displacement(
        tracks["time"].values,
        [str(p) for p in tracks["point"].values],
        axes,
        displacement_mm=(position - origin) * _MM_PER_M,
        displacement_std_mm=np.where(valid[..., None], random_std, np.nan) * _MM_PER_M,
        scale_std=np.einsum("paa->pa", gain_std),
        position_m=position,
        reprojection_error_px=compute_reprojection_error(points3d, pixels, rig),
        status=status,
        attrs={
            "frame": "reference camera" if frame is None else "structure",
            "baseline_m": rig.baseline() if len(rig) > 1 else float("nan"),
            "relative_to": "first valid sample" if still_interval_s is None else "mean of the still interval",
            **(attrs or {}),
        },
    )
    displacement["gain_std"] = (("point", "axis", "motion_axis"), gain_std, {"units": "1"})
    displacement["gain_covariance"] = (
        ("point", "axis", "motion_axis", "motion_axis_2"),
        gain_covariance,
        {"units": "1"},
    )
    displacement["pixel_sensitivity"] = (
        ("point", "axis", "view", "pixel"),
        jacobian * _MM_PER_M,
        {"units": "mm/px"},
    )
    coordinates = {"motion_axis": list(axes), "motion_axis_2": list(axes), "view": list(names), "pixel": list(PIXEL)}
    return displacement.assign_coords(coordinates)


def _combined_status(status: np.ndarray[Any, np.dtype[np.int8]], behind: BoolArray) -> np.ndarray[Any, Any]:
    """The worst status over the views, (V, T, P) to (T, P): missing before unreliable before ok."""
    severity = np.array([0, 2, 3, 1])
    worst = np.take_along_axis(status, severity[status].argmax(axis=0)[None], axis=0)[0]
    return np.where(behind, Status.BEHIND, worst)


def _reference_position(
    position: FloatArray, valid: BoolArray, time_s: FloatArray, still_interval_s: tuple[float, float] | None
) -> FloatArray:
    """Position that displacement is relative to, (T, P, 3) to (P, 3); NaN for a point without any."""
    if still_interval_s is None:
        return np.asarray(_first_valid(position[None], valid)[0])
    still = (time_s >= still_interval_s[0]) & (time_s <= still_interval_s[1])
    if not still.any():
        raise DatasetError(
            f"still interval: expected frames between {still_interval_s[0]} and {still_interval_s[1]} s, got a "
            f"recording from {time_s[0]:.3f} to {time_s[-1]:.3f} s; correct method.still_interval_s"
        )
    usable = (valid & still[:, None])[..., None]
    count = usable.sum(axis=0)
    total = np.where(usable, position, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _first_valid(values: FloatArray, valid: BoolArray) -> FloatArray:
    """The first valid sample of each point, (V, T, P, n) to (V, P, n); NaN where there is none."""
    first = valid.argmax(axis=0)
    chosen = values[:, first, np.arange(valid.shape[1])]
    return np.asarray(np.where(np.asarray(valid.any(axis=0))[:, None], chosen, np.nan))
