"""Labelled datasets that travel between the stages: their contents, and the checks of them.

points
    Dims ``view, point, pixel``; ``position`` [px] in the first frame of every view, or in that of number ``frame``
    (view, point) where some are named in later ones, ``position_std`` [px], ``status`` in words (``ok``, or why there
    is no position); where there are grids also ``grid`` (point), the name of the grid, empty for points of their own.
tracks
    One view, own clock: dims ``time, point, pixel``; ``position`` [px], ``position_covariance`` [px2]
    (``pixel_a, pixel_b``), ``status``. Where subsets were designed point by point also ``subset_px`` (point) [px],
    ``warp`` (point) in words, ``believed`` (point, or time and point), the share of pixels believed [1], and
    ``edge_across`` (point, pixel), the unit vector across a point that is measured across an edge only, else NaN: along
    the edge its position is that of the reference frame, with the standard deviation `UNMEASURED_STD_PX`.
    Where reference frames were renewed, or are not the first frame, also ``reference`` (time, point), the number of the
    frame that a sample was compared with, and ``reference_covariance`` (reference_frame, point, pixel_a, pixel_b)
    [px2], what renewal adds to ``position_covariance``.
    With a leading dim ``view`` the tracks share one clock, and what is known of each view's own clock are variables on
    ``view``: ``clock_offset`` [s], ``clock_offset_std`` [s], ``clock_rate`` [1], ``clock_status``;
    and ``clock_use`` (view, point).
displacement
    dims ``time, point, axis``; ``displacement`` [mm], ``displacement_std`` [mm] (random part), ``scale_std`` [1]
    (systematic part, dims ``point, axis``), ``position`` [m], ``reprojection_error`` [px], ``status``.

The datasets of sensors stand in `vfm_sdm.core.sensor_datasets`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.dataset_checks import check_clock, check_codes, check_variable
from vfm_sdm.core.statuses import SampleStatus
from vfm_sdm.errors import DatasetError

__all__ = [
    "CAMERA_AXES",
    "FIRST_SAMPLE",
    "IMAGE_PLANE",
    "PIXEL",
    "START",
    "STATUS_MEANINGS",
    "STRUCTURE_AXES",
    "UNMEASURED_STD_PX",
    "DisplacementArrays",
    "Status",
    "check_displacement",
    "check_points",
    "check_tracks",
    "convert_units",
    "frames_of_points",
    "make_displacement",
    "make_points",
    "make_tracks",
    "status_variable",
    "trusted_values",
    "worst_status",
]

PIXEL = ("u", "v")
START = "time_coverage_start"
"""Attribute of tracks and displacement with the date and time of time zero, where the session states it (ISO 8601)."""
STRUCTURE_AXES = ("lateral", "vertical", "longitudinal")
CAMERA_AXES = ("right", "down", "forward")
FIRST_SAMPLE = "first valid sample"
"""What displacement is relative to where no still interval is stated: attribute ``relative_to``."""
IMAGE_PLANE = "image plane"
"""Frame of the displacement of a single view, in the picture."""
UNMEASURED_STD_PX = 1000.0
"""Standard deviation of a position along an edge, where nothing is measured: the size of a picture [px]."""
STATUS_MEANINGS = tuple(str(status) for status in SampleStatus)


class Status:
    """Codes of `vfm_sdm.core.statuses.SampleStatus`, as the arrays ``status`` hold them."""

    OK, LOST, OUTSIDE, UNRELIABLE, BEHIND = range(len(SampleStatus))


_SEVERITY = np.array([0, 2, 3, 1, 4])
"""Severity of the codes of `Status`, in their order."""
_UNIT_FACTORS = {
    ("m", "mm"): 1e3,
    ("mm", "m"): 1e-3,
    ("cm", "mm"): 10.0,
    ("um", "mm"): 1e-3,
    ("g", "m/s2"): 9.80665,
    ("m/s2", "g"): 1 / 9.80665,
    ("mg", "m/s2"): 9.80665e-3,
    ("cm/s2", "m/s2"): 1e-2,
    ("mm/s2", "m/s2"): 1e-3,
}


def status_variable(dims: Sequence[str], codes: npt.ArrayLike) -> xr.Variable:
    """A status variable with its meanings as CF flags.

    Parameters
    ----------
    dims
        Names of the dims.
    codes
        Codes of `Status`, shape (...), such as one for each frame and point.

    Examples
    --------
    >>> status_variable(["time"], [Status.OK, Status.LOST]).attrs["flag_meanings"]
    'ok lost outside unreliable behind_camera'
    """
    values = np.asarray(codes, dtype=np.int8)
    flags = np.arange(len(STATUS_MEANINGS), dtype=np.int8)
    return xr.Variable(dims, values, {"flag_values": flags, "flag_meanings": " ".join(STATUS_MEANINGS)})


def worst_status(codes: npt.ArrayLike) -> npt.NDArray[np.int8]:
    """Most severe code of `Status` over the first axis: missing before unreliable before ok.

    Parameters
    ----------
    codes
        Codes of V views, shape (V, ...), such as one for each frame and point.

    Returns
    -------
    codes
        Shape (...).

    Examples
    --------
    >>> worst_status([[Status.OK, Status.LOST], [Status.UNRELIABLE, Status.OUTSIDE]]).tolist()
    [3, 2]
    """
    values = np.asarray(codes, dtype=np.int8)
    worst = _SEVERITY[values].argmax(axis=0)
    return np.asarray(np.take_along_axis(values, worst[None], axis=0)[0])


def make_points(
    views: Sequence[str],
    points: Sequence[str],
    *,
    position: npt.ArrayLike,
    position_std: npt.ArrayLike,
    status: npt.ArrayLike,
) -> xr.Dataset:
    """Places of named points in the first frame of every view.

    Parameters
    ----------
    views, points
        Names, lengths V and P.
    position
        Positions in full-image pixels, shape (V, P, 2) [px]; NaN where a point was not found.
    position_std
        Standard deviation, shape (V, P, 2) [px]; 0 where a point is where its user named it, NaN where unknown.
    status
        ``ok``, or why there is no position, shape (V, P).

    Raises
    ------
    DatasetError
        Shapes disagree.

    Examples
    --------
    >>> found = make_points(["left"], ["mid"], position=[[[320.0, 240.0]]], position_std=[[[0, 0]]], status=[["ok"]])
    >>> found["position"].sel(view="left", point="mid", pixel="v").item()
    240.0
    """
    dims = ("view", "point")
    try:
        found = xr.Dataset(
            {
                "position": ((*dims, "pixel"), np.asarray(position, np.float64), {"units": "px"}),
                "position_std": ((*dims, "pixel"), np.asarray(position_std, np.float64), {"units": "px"}),
                "status": (dims, np.asarray(np.asarray(status, dtype=str), dtype=object)),
            },
            coords={"view": list(views), "point": list(points), "pixel": list(PIXEL)},
        )
    except ValueError as error:
        raise DatasetError(f"points: expected arrays of one number of views and points; {error}") from error
    return check_points(found)


def frames_of_points(points: xr.Dataset, names: Sequence[str] | None = None) -> IntArray:
    """Numbers of the frames of a view in which positions of points are stated, shape (P,).

    Parameters
    ----------
    points
        One view of a points dataset, positions of shape (P, 2) [px]; with ``frame`` (point) where some are named in
        other frames than the first ones.
    names
        Names of the points; all of the dataset when left out.

    Examples
    --------
    >>> found = make_points(["left"], ["mid"], position=[[[320.0, 240.0]]], position_std=[[[0, 0]]], status=[["ok"]])
    >>> frames_of_points(found.sel(view="left")).tolist()
    [0]
    """
    chosen = [str(name) for name in points["point"].values] if names is None else list(names)
    if "frame" not in points:
        return np.zeros(len(chosen), np.int64)
    return np.asarray(points["frame"].sel(point=chosen).values, np.int64)


def check_points(points: xr.Dataset) -> xr.Dataset:
    """The points as given, after checking dims and units.

    Parameters
    ----------
    points
        Points dataset, positions of shape (V, P, 2) [px].

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units.
    """
    check_variable(points, "position", ("view", "point", "pixel"), "px")
    check_variable(points, "position_std", ("view", "point", "pixel"), "px")
    check_variable(points, "status", ("view", "point"), None)
    return points


def make_tracks(
    time_s: npt.ArrayLike,
    points: Sequence[str],
    position: npt.ArrayLike,
    position_covariance: npt.ArrayLike,
    status: npt.ArrayLike,
    *,
    attrs: Mapping[str, Any],
) -> xr.Dataset:
    """Tracks of one view.

    Parameters
    ----------
    time_s
        Clock of the view, shape (T,) [s].
    points
        Point names, length P.
    position
        Positions in full-image pixels, shape (T, P, 2) [px]; NaN where lost or outside.
    position_covariance
        Covariances of the positions, shape (T, P, 2, 2) [px2].
    status
        Codes of `Status`, shape (T, P).
    attrs
        ``tracker``, ``view``, ``image_width``, ``image_height`` and other facts about the tracks.

    Raises
    ------
    DatasetError
        Shapes disagree or the clock does not increase.

    Examples
    --------
    >>> tracks = make_tracks([0.0, 0.1], ["mid"], np.zeros((2, 1, 2)), np.zeros((2, 1, 2, 2)), [[0], [0]], attrs={})
    >>> tracks["position"].dims, tracks["position"].attrs["units"]
    (('time', 'point', 'pixel'), 'px')
    """
    try:
        tracks = xr.Dataset(
            {
                "position": (("time", "point", "pixel"), np.asarray(position, np.float64), {"units": "px"}),
                "position_covariance": (
                    ("time", "point", "pixel_a", "pixel_b"),
                    np.asarray(position_covariance, np.float64),
                    {"units": "px2"},
                ),
                "status": status_variable(("time", "point"), status),
            },
            coords={
                "time": ("time", np.asarray(time_s, np.float64), {"units": "s"}),
                "point": list(points),
                "pixel": list(PIXEL),
                "pixel_a": list(PIXEL),
                "pixel_b": list(PIXEL),
            },
            attrs=dict(attrs),
        )
    except ValueError as error:
        raise DatasetError(f"tracks: expected arrays of one number of frames and points; {error}") from error
    return check_tracks(tracks)


def check_tracks(tracks: xr.Dataset, *, synchronized: bool = False) -> xr.Dataset:
    """The tracks as given, after checking dims, units and clock.

    Parameters
    ----------
    tracks
        Tracks dataset, positions of shape (T, P, 2) or, with a dim ``view``, (V, T, P, 2) [px].
    synchronized
        Whether the tracks must have the dim ``view``.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units; a status has no meaning; the clock does not increase.
    """
    lead = ("view",) if synchronized else ()
    check_variable(tracks, "position", (*lead, "time", "point", "pixel"), "px")
    check_variable(tracks, "position_covariance", (*lead, "time", "point", "pixel_a", "pixel_b"), "px2")
    check_variable(tracks, "status", (*lead, "time", "point"), None)
    check_codes(tracks, "status", len(STATUS_MEANINGS))
    check_clock(tracks)
    return tracks


@dataclass(frozen=True, eq=False)
class DisplacementArrays:
    """Displacement of P points at T times along three axes, and what is known of it.

    Parameters
    ----------
    displacement_mm, displacement_std_mm
        Displacement and its standard deviation, which is the random part only, shape (T, P, 3) [mm].
    scale_std
        Relative standard deviation of each axis' gain, shape (P, 3) [1]: the systematic part.
    position_m
        Positions in the frame named in ``attrs["frame"]``, shape (T, P, 3) [m].
    reprojection_error_px
        Root mean square reprojection error, shape (T, P) [px].
    status
        Codes of `Status`, shape (T, P).
    """

    displacement_mm: npt.ArrayLike
    displacement_std_mm: npt.ArrayLike
    scale_std: npt.ArrayLike
    position_m: npt.ArrayLike
    reprojection_error_px: npt.ArrayLike
    status: npt.ArrayLike


def make_displacement(
    time_s: npt.ArrayLike,
    points: Sequence[str],
    axes: Sequence[str],
    arrays: DisplacementArrays,
    *,
    attrs: Mapping[str, Any],
) -> xr.Dataset:
    """Displacement of points along named axes.

    Parameters
    ----------
    time_s
        Common clock, shape (T,) [s].
    points, axes
        Names, lengths P and 3.
    arrays
        Displacement and what is known of it, of T samples and P points along the axes.
    attrs
        ``frame`` and other facts about the values.

    Raises
    ------
    DatasetError
        Shapes disagree or the clock does not increase.

    Examples
    --------
    >>> displacement = make_displacement(
    ...     [0.0, 0.1],
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=[[[0.0, 0.0, 0.0]], [[0.5, 2.0, 0.1]]],
    ...         displacement_std_mm=np.full((2, 1, 3), 0.1),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((2, 1, 3)),
    ...         reprojection_error_px=np.zeros((2, 1)),
    ...         status=np.zeros((2, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> displacement["displacement"].sel(point="mid", axis="vertical").values.tolist()
    [0.0, 2.0]
    """
    dims = ("time", "point", "axis")
    try:
        displacement = xr.Dataset(
            {
                "displacement": (dims, np.asarray(arrays.displacement_mm, np.float64), {"units": "mm"}),
                "displacement_std": (dims, np.asarray(arrays.displacement_std_mm, np.float64), {"units": "mm"}),
                "scale_std": (("point", "axis"), np.asarray(arrays.scale_std, np.float64), {"units": "1"}),
                "position": (dims, np.asarray(arrays.position_m, np.float64), {"units": "m"}),
                "reprojection_error": (dims[:2], np.asarray(arrays.reprojection_error_px, np.float64), {"units": "px"}),
                "status": status_variable(dims[:2], arrays.status),
            },
            coords={
                "time": ("time", np.asarray(time_s, np.float64), {"units": "s"}),
                "point": list(points),
                "axis": list(axes),
            },
            attrs=dict(attrs),
        )
    except ValueError as error:
        raise DatasetError(f"displacement: expected arrays of one number of frames and points; {error}") from error
    return check_displacement(displacement)


def check_displacement(displacement: xr.Dataset) -> xr.Dataset:
    """The displacement as given, after checking dims, units and clock.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units; a status has no meaning; the clock does not increase.
    """
    dims = ("time", "point", "axis")
    check_variable(displacement, "displacement", dims, "mm")
    check_variable(displacement, "displacement_std", dims, "mm")
    check_variable(displacement, "scale_std", ("point", "axis"), "1")
    check_variable(displacement, "position", dims, "m")
    check_variable(displacement, "reprojection_error", dims[:2], "px")
    check_variable(displacement, "status", dims[:2], None)
    check_codes(displacement, "status", len(STATUS_MEANINGS))
    check_clock(displacement)
    return displacement


def trusted_values(dataset: xr.Dataset, name: str) -> FloatArray:
    """Values of a variable with one more dim than ``status``, NaN where that is not ok.

    Parameters
    ----------
    dataset
        Tracks, shape (T, P, 2) [px], or displacement, shape (T, P, 3) [mm].
    name
        Name of the variable, such as ``position`` (time, point, pixel) [px] or ``displacement`` (time, point, axis)
        [mm].

    Examples
    --------
    >>> position = np.zeros((2, 1, 2))
    >>> tracks = make_tracks([0.0, 0.1], ["mid"], position, np.zeros((2, 1, 2, 2)), [[0], [Status.LOST]], attrs={})
    >>> trusted_values(tracks, "position")[:, 0].tolist()
    [[0.0, 0.0], [nan, nan]]
    """
    ok = dataset["status"].values == Status.OK
    return np.where(ok[..., None], dataset[name].values, np.nan)


def convert_units(array: xr.DataArray, units: str) -> xr.DataArray:
    """The array in other units, values and ``units`` attribute changed together.

    Parameters
    ----------
    array
        Array of any shape with the attribute ``units``, such as ``m``.
    units
        Units wanted, such as ``mm``.

    Raises
    ------
    DatasetError
        The array has no units, or no factor between the two is known.

    Examples
    --------
    >>> convert_units(xr.DataArray([0.002], attrs={"units": "m"}), "mm").values.tolist()
    [2.0]
    """
    have = str(array.attrs.get("units"))
    if have == units:
        return array
    if (have, units) not in _UNIT_FACTORS:
        raise DatasetError(f"units: expected one of {sorted(_UNIT_FACTORS)}, got {have!r} to {units!r}; set `units`")
    converted: xr.DataArray = array * _UNIT_FACTORS[(have, units)]
    converted.attrs = {**array.attrs, "units": units}
    return converted
