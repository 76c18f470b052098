"""What files say of themselves by the CF conventions: long names, positive directions; only in files, not in memory."""

from collections.abc import Mapping
from typing import Any, Final

import xarray as xr

__all__ = ["CONVENTIONS", "described", "undescribed"]

CONVENTIONS: Final = "CF-1.11"
_POSITIVE = {
    "structure": (
        "lateral: away from the reference camera, vertical: down, longitudinal: along the structure, to the left for "
        "one who faces it from the reference camera's side (right-handed)"
    ),
    "reference camera": "right, down and forward, as seen by the reference camera",
    "image plane": "right and down in the picture",
}
"""Positive directions of the axes by the frame of displacement."""
_LONG_NAMES = {
    "time": "time since the first frame of the reference view",
    "point": "name of the point",
    "view": "name of the view",
    "axis": "axis of the displacement",
    "pixel": "direction in the picture: u to the right, v down",
    "component": "source of uncertainty",
    "displacement": "displacement of the point",
    "displacement_std": "random part of the standard uncertainty of the displacement",
    "combined_std": "combined standard uncertainty of the displacement",
    "expanded_uncertainty": "expanded uncertainty of the displacement (coverage factor 2)",
    "uncertainty": "standard uncertainty of the displacement by its source",
    "scale_std": "relative standard uncertainty of the gain of an axis",
    "gain_std": "standard uncertainty of the leakage between axes",
    "gain_covariance": "covariance of the gains of all axes",
    "pixel_sensitivity": "displacement for a shift of a point in one picture",
    "gain_difference": "difference of the motion seen by two views, relative to it",
    "reprojection_error": "root mean square reprojection error",
    "status": "status of the sample",
    "origin": "position that displacement is relative to",
    "uncertainty_estimated": "whether there was anything to estimate the component from",
    "position_std": "standard uncertainty of the position",
    "position_covariance": "covariance of the position in the picture",
    "correlation": "zero-normalised cross-correlation with the reference subset",
    "subset_px": "side of the subset that is compared",
    "half_difference": "motion of the right half of the subset beyond the left half",
    "scatter": "scatter of the track from frame to frame",
    "clock_offset": "time by which the view began later than the reference view",
    "clock_offset_std": "standard uncertainty of the clock offset",
    "clock_rate": "rate of the view's clock over that of the reference view",
    "camera_motion_before": "shift of the static points before the camera motion was taken out",
    "camera_motion_after": "shift of the static points after the camera motion was taken out",
    "confidence": "confidence in the position",
}


def described(dataset: xr.Dataset) -> xr.Dataset:
    """A copy that says what its variables are, for the readers of a file.

    Parameters
    ----------
    dataset
        Dataset with variables of any shape and unit; what it already says of them stands.

    Examples
    --------
    >>> found = described(xr.Dataset({"displacement": ("time", [0.0], {"units": "mm"})}, attrs={"frame": "structure"}))
    >>> found.attrs["Conventions"], found["displacement"].attrs["long_name"]
    ('CF-1.11', 'displacement of the point')
    """
    copy = dataset.copy()
    copy.attrs = {"Conventions": CONVENTIONS, **dataset.attrs}
    for name in copy.variables:
        copy[name].attrs = {**_said_of(str(name), dataset), **dataset[name].attrs}
    return copy


def undescribed(dataset: xr.Dataset) -> xr.Dataset:
    """A copy without what `described` added.

    Parameters
    ----------
    dataset
        Dataset with variables of any shape and unit.

    Examples
    --------
    >>> undescribed(described(xr.Dataset({"status": ("time", [0])}))).identical(xr.Dataset({"status": ("time", [0])}))
    True
    """
    copy = dataset.copy()
    copy.attrs = _without(dataset.attrs, {"Conventions": CONVENTIONS})
    for name in copy.variables:
        copy[name].attrs = _without(dataset[name].attrs, _said_of(str(name), dataset))
    return copy


def _said_of(name: str, dataset: xr.Dataset) -> dict[str, str]:
    said = {"long_name": _LONG_NAMES[name]} if name in _LONG_NAMES else {}
    if name == "position":
        where = "picture" if "pixel" in dataset[name].dims else "frame of the axes"
        said["long_name"] = f"position of the point in the {where}"
    if name == "time":
        said |= {"axis": "T"} if dataset[name].dims == ("time",) else {}
    frame = str(dataset.attrs.get("frame"))
    if name == "axis" and frame in _POSITIVE:
        said["positive"] = _POSITIVE[frame]
    return said


def _without(attrs: Mapping[Any, Any], added: Mapping[str, str]) -> dict[Any, Any]:
    return {key: value for key, value in attrs.items() if not (isinstance(value, str) and added.get(key) == value)}
