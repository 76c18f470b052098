"""The labelled datasets that travel between the stages: what they hold, and the checks at the door.

points
    Dims ``view, point, pixel``; ``position`` [px] in the first frame of every view, ``position_std`` [px], ``status``
    in words (``ok``, or why there is no position).
tracks
    One view, own clock: dims ``time, point, pixel``; ``position`` [px], ``position_covariance`` [px2]
    (``pixel_a, pixel_b``), ``status``. With a leading dim ``view`` the tracks share one clock, and what is known of
    each view's own clock are variables on ``view``: ``clock_offset`` [s], ``clock_offset_std`` [s], ``clock_rate``
    [1], ``clock_status``.
displacement
    dims ``time, point, axis``; ``displacement`` [mm], ``displacement_std`` [mm] (random part), ``scale_std`` [1]
    (systematic part, dims ``point, axis``), ``position`` [m], ``reprojection_error`` [px], ``status``.
acceleration, reference
    A sensor's own clock, even: dims ``time, sensor, axis``; ``acceleration`` [m/s2] or ``displacement`` [mm]; attribute
    ``sampling_rate_hz``, and of a reference ``onset_s`` (NaN before it) and ``band_hz`` (what it can show).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, clock_departure
from vfm_sdm.core.statuses import SampleStatus
from vfm_sdm.errors import DatasetError

__all__ = [
    "CAMERA_AXES",
    "PIXEL",
    "STATUS_MEANINGS",
    "STRUCTURE_AXES",
    "Status",
    "check_acceleration",
    "check_displacement",
    "check_points",
    "check_reference",
    "check_tracks",
    "convert_units",
    "make_acceleration",
    "make_displacement",
    "make_points",
    "make_reference",
    "make_tracks",
    "status_variable",
    "trusted_values",
    "worst_status",
]

PIXEL = ("u", "v")
STRUCTURE_AXES = ("lateral", "vertical", "longitudinal")
CAMERA_AXES = ("right", "down", "forward")
STATUS_MEANINGS = tuple(str(status) for status in SampleStatus)


class Status:
    """Codes of `vfm_sdm.core.statuses.SampleStatus`, as the arrays ``status`` hold them."""

    OK, LOST, OUTSIDE, UNRELIABLE, BEHIND = range(len(SampleStatus))


_SENSOR_DIMS = ("time", "sensor", "axis")
_SEVERITY = np.array([0, 2, 3, 1, 4])
"""Of the codes of `Status`, in their order."""
_UNEVEN = 0.01
"""Share of the sampling interval by which a time stamp of a sensor's clock may be off: its stamps are computed from the
rate, so that only the digits of a stated rate can part them."""
_UNIT_FACTORS = {("m", "mm"): 1e3, ("mm", "m"): 1e-3, ("g", "m/s2"): 9.80665, ("m/s2", "g"): 1 / 9.80665}


def status_variable(dims: Sequence[str], codes: npt.ArrayLike) -> xr.Variable:
    """A status variable with its meanings as CF flags."""
    values = np.asarray(codes, dtype=np.int8)
    flags = np.arange(len(STATUS_MEANINGS), dtype=np.int8)
    return xr.Variable(dims, values, {"flag_values": flags, "flag_meanings": " ".join(STATUS_MEANINGS)})


def worst_status(codes: npt.ArrayLike) -> npt.NDArray[np.int8]:
    """The code of `Status` that says most against a sample, over the first axis: missing before unreliable before ok.

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
    """Where named points lie in the first frame of every view.

    Parameters
    ----------
    views, points
        Names, lengths V and P.
    position
        Shape (V, P, 2) [px], full-image pixels; NaN where a point was not found.
    position_std
        Standard deviation, shape (V, P, 2) [px]; 0 where a point is where its user named it, NaN where unknown.
    status
        ``ok`` or why there is no position, shape (V, P).

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


def check_points(points: xr.Dataset) -> xr.Dataset:
    """The same points, after checking dims and units.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units.
    """
    _check_variable(points, "position", ("view", "point", "pixel"), "px")
    _check_variable(points, "position_std", ("view", "point", "pixel"), "px")
    _check_variable(points, "status", ("view", "point"), None)
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
        Shape (T, P, 2) [px], full-image pixels; NaN where lost or outside.
    position_covariance
        Shape (T, P, 2, 2) [px2].
    status
        Codes of `Status`, shape (T, P).
    attrs
        ``tracker``, ``view``, ``image_width``, ``image_height`` and whatever else explains the tracks.

    Raises
    ------
    DatasetError
        Shapes disagree or the clock does not increase.
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
    """The same tracks, after checking dims, units and clock.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units; the clock does not increase.
    """
    lead = ("view",) if synchronized else ()
    _check_variable(tracks, "position", (*lead, "time", "point", "pixel"), "px")
    _check_variable(tracks, "position_covariance", (*lead, "time", "point", "pixel_a", "pixel_b"), "px2")
    _check_variable(tracks, "status", (*lead, "time", "point"), None)
    _check_clock(tracks)
    return tracks


def make_displacement(
    time_s: npt.ArrayLike,
    points: Sequence[str],
    axes: Sequence[str],
    *,
    displacement_mm: npt.ArrayLike,
    displacement_std_mm: npt.ArrayLike,
    scale_std: npt.ArrayLike,
    position_m: npt.ArrayLike,
    reprojection_error_px: npt.ArrayLike,
    status: npt.ArrayLike,
    attrs: Mapping[str, Any],
) -> xr.Dataset:
    """Displacement of points along named axes.

    Parameters
    ----------
    time_s
        Common clock, shape (T,) [s].
    points, axes
        Names, lengths P and 3.
    displacement_mm, displacement_std_mm
        Shape (T, P, 3) [mm]; the standard deviation is the random part only.
    scale_std
        Relative standard deviation of each axis' gain, shape (P, 3) [1]: the systematic part.
    position_m
        Shape (T, P, 3) [m], in the frame named in ``attrs["frame"]``.
    reprojection_error_px
        Shape (T, P) [px].
    status
        Codes of `Status`, shape (T, P).
    attrs
        ``frame`` and whatever else explains the values.

    Raises
    ------
    DatasetError
        Shapes disagree or the clock does not increase.
    """
    dims = ("time", "point", "axis")
    try:
        displacement = xr.Dataset(
            {
                "displacement": (dims, np.asarray(displacement_mm, np.float64), {"units": "mm"}),
                "displacement_std": (dims, np.asarray(displacement_std_mm, np.float64), {"units": "mm"}),
                "scale_std": (("point", "axis"), np.asarray(scale_std, np.float64), {"units": "1"}),
                "position": (dims, np.asarray(position_m, np.float64), {"units": "m"}),
                "reprojection_error": (dims[:2], np.asarray(reprojection_error_px, np.float64), {"units": "px"}),
                "status": status_variable(dims[:2], status),
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
    """The same displacement, after checking dims, units and clock.

    Raises
    ------
    DatasetError
        A variable is missing, or has other dims or units; the clock does not increase.
    """
    dims = ("time", "point", "axis")
    _check_variable(displacement, "displacement", dims, "mm")
    _check_variable(displacement, "displacement_std", dims, "mm")
    _check_variable(displacement, "scale_std", ("point", "axis"), "1")
    _check_variable(displacement, "position", dims, "m")
    _check_variable(displacement, "reprojection_error", dims[:2], "px")
    _check_variable(displacement, "status", dims[:2], None)
    _check_clock(displacement)
    return displacement


def make_acceleration(
    time_s: npt.ArrayLike,
    sensors: Sequence[str],
    axes: Sequence[str],
    acceleration: npt.ArrayLike,
    *,
    sampling_rate_hz: float,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Acceleration of sensors that share a clock.

    Parameters
    ----------
    time_s
        The sensors' clock, ``t0 + i / sampling_rate_hz``, shape (T,) [s].
    sensors, axes
        Names, lengths S and A.
    acceleration
        Shape (T, S, A) [m/s2], gravity and bias included.
    sampling_rate_hz
        Samples a second of that clock [Hz].
    attrs
        Whatever else explains the values.

    Raises
    ------
    DatasetError
        Shapes disagree, or the clock is not even.
    """
    coords = _sensor_coords(time_s, sensors, axes)
    signal = {"acceleration": (_SENSOR_DIMS, np.asarray(acceleration, np.float64), {"units": "m/s2"})}
    try:
        dataset = xr.Dataset(signal, coords, {"sampling_rate_hz": float(sampling_rate_hz), **(attrs or {})})
    except ValueError as error:
        raise DatasetError(f"acceleration: expected shape (time, sensor, axis); {error}") from error
    return check_acceleration(dataset)


def make_reference(
    time_s: npt.ArrayLike,
    sensors: Sequence[str],
    axes: Sequence[str],
    displacement_mm: npt.ArrayLike,
    *,
    sampling_rate_hz: float,
    onset_s: float,
    band_hz: tuple[float, float],
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Reference displacement of sensors that share a clock; arguments as in `make_acceleration`, and these.

    Parameters
    ----------
    displacement_mm
        Shape (T, S, A) [mm]; NaN before the onset.
    onset_s
        Where on the clock the motion that was evaluated begins [s].
    band_hz
        Frequencies that the reference can show [Hz].

    Raises
    ------
    DatasetError
        Shapes disagree, or the clock is not even.
    """
    coords = _sensor_coords(time_s, sensors, axes)
    signal = {"displacement": (_SENSOR_DIMS, np.asarray(displacement_mm, np.float64), {"units": "mm"})}
    known = {"sampling_rate_hz": float(sampling_rate_hz), "onset_s": float(onset_s), "band_hz": list(band_hz)}
    try:
        dataset = xr.Dataset(signal, coords, {**known, **(attrs or {})})
    except ValueError as error:
        raise DatasetError(f"reference: expected shape (time, sensor, axis); {error}") from error
    return check_reference(dataset)


def check_acceleration(acceleration: xr.Dataset) -> xr.Dataset:
    """The same acceleration, after checking dims, units and clock.

    Raises
    ------
    DatasetError
        The variable is missing, or has other dims or units; the clock is not even.
    """
    _check_variable(acceleration, "acceleration", _SENSOR_DIMS, "m/s2")
    _check_even_clock(acceleration)
    return acceleration


def check_reference(reference: xr.Dataset) -> xr.Dataset:
    """The same reference displacement, after checking dims, units, clock and attributes.

    Raises
    ------
    DatasetError
        The variable or an attribute is missing, or has other dims or units; the clock is not even.
    """
    _check_variable(reference, "displacement", _SENSOR_DIMS, "mm")
    _check_even_clock(reference)
    missing = [name for name in ("onset_s", "band_hz") if name not in reference.attrs]
    if missing:
        raise DatasetError(f"reference: expected attributes onset_s and band_hz, missing {missing}; set them")
    return reference


def trusted_values(dataset: xr.Dataset, name: str) -> FloatArray:
    """Values of a variable with one more dim than ``status``, NaN where that is not ok.

    Parameters
    ----------
    dataset
        Tracks or displacement.
    name
        The variable, such as ``position`` (time, point, pixel) [px] or ``displacement`` (time, point, axis) [mm].
    """
    ok = dataset["status"].values == Status.OK
    return np.where(ok[..., None], dataset[name].values, np.nan)


def convert_units(array: xr.DataArray, units: str) -> xr.DataArray:
    """The array in other units, values and ``units`` attribute changed together.

    Raises
    ------
    DatasetError
        The array has no units, or no factor between the two is known.
    """
    have = str(array.attrs.get("units"))
    if have == units:
        return array
    if (have, units) not in _UNIT_FACTORS:
        raise DatasetError(f"units: expected one of {sorted(_UNIT_FACTORS)}, got {have!r} to {units!r}; set `units`")
    converted: xr.DataArray = array * _UNIT_FACTORS[(have, units)]
    converted.attrs = {**array.attrs, "units": units}
    return converted


def _check_variable(dataset: xr.Dataset, name: str, dims: tuple[str, ...], units: str | None) -> None:
    if name not in dataset:
        raise DatasetError(f"dataset: expected a variable {name!r}, got {sorted(map(str, dataset.data_vars))}")
    variable = dataset[name]
    if variable.dims != dims:
        raise DatasetError(f"{name}: expected dims {dims}, got {variable.dims}; transpose or rename them")
    if units is not None and variable.attrs.get("units") != units:
        raise DatasetError(f"{name}: expected units {units!r}, got {variable.attrs.get('units')!r}; convert them")


def _check_clock(dataset: xr.Dataset) -> None:
    time_s = dataset["time"].values
    if not np.isfinite(time_s).all() or np.any(np.diff(time_s) <= 0):
        raise DatasetError("time: expected finite, increasing seconds, got repeated or falling stamps; sort the frames")


def _check_even_clock(dataset: xr.Dataset) -> None:
    _check_clock(dataset)
    rate = float(dataset.attrs.get("sampling_rate_hz", np.nan))
    if not (rate > 0 and np.isfinite(rate)):
        raise DatasetError(f"sampling_rate_hz: expected an attribute > 0 Hz, got {rate}; set it")
    time_s = dataset["time"].values
    off = np.abs(clock_departure(time_s, 1 / rate))
    if np.any(off > _UNEVEN):
        raise DatasetError(
            f"time: expected t0 + i / {rate:g} s, got {time_s[off > _UNEVEN][0]:.6f} s as sample "
            f"{np.flatnonzero(off > _UNEVEN)[0]}; cut the recording at the gap, or resample it"
        )


def _sensor_coords(time_s: npt.ArrayLike, sensors: Sequence[str], axes: Sequence[str]) -> dict[str, Any]:
    time = ("time", np.asarray(time_s, np.float64), {"units": "s"})
    return {"time": time, "sensor": list(sensors), "axis": list(axes)}
