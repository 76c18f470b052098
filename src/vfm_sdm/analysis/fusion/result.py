"""Fused displacement as a dataset: samples, their uncertainty, and what was found of sensor and video."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr

from vfm_sdm.analysis.fusion.along import Fused, Record
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import START
from vfm_sdm.core.statuses import FusedStatus, FusionStatus

__all__ = ["FUSED_MEANINGS", "describe_fusion", "fail_fusion"]

FUSED_MEANINGS = tuple(str(status) for status in FusedStatus)
_OK, _BRIDGED, _NO_SENSOR = range(len(FUSED_MEANINGS))
_SCALING = ("cameras", "compression", "subset")
"""Components of the budget that grow with the motion."""
_STEADY = ("synchronization", "assumption", "origin")
_BAND_SHARE = 0.4
"""Highest frequency that a sensor's record holds whole, over its sampling rate."""
_LARGE_FACTOR = 2.0
_LARGE_RATIO = 1.3
_DISAGREE_STD = 3.0
_JUMP = 7.0
"""Of normal errors one in 10^11 is larger."""


def describe_fusion(
    of_point: xr.Dataset, found: Mapping[str, Fused], record: Record, sensor: str, notes: Sequence[str]
) -> xr.Dataset:
    """The dataset of a fusion.

    Parameters
    ----------
    of_point
        Displacement of the point, shape (T, 3) [mm].
    found
        By axis.
    record
        The sensor's record.
    sensor
        Its name.
    notes
        Sentences on the record.

    Returns
    -------
    fused
        Dims ``time`` and ``axis``. ``displacement`` [mm]; ``displacement_std``, which differs from sample to sample;
        ``combined_std``, with what the budget of the video states beside its random part: scale, compression and subset
        in proportion to the motion, clocks of the views, assumption and origin as they are on the whole; ``status``. By
        axis: ``gain`` (acceleration of the video over that of the sensor) and ``gain_std`` [1]; ``size`` and
        ``size_std``, the same over all axes of a sensor that may be turned [1]; ``lag`` and ``lag_std`` [s],
        ``drift_std`` [1]; ``bias`` [m/s2]; ``sensor_noise`` [m/s2/sqrt(Hz)]; ``video_std``, of a value of the video
        alone, and its slow part ``slow_std`` [mm] with its correlation time ``slow_time`` [s]; ``exposure`` [s];
        ``innovation_rms`` [mm] and ``innovation_ratio`` [1]; ``stated_ratio``, the scatter of the video over the stated
        one [1].
    """
    # Axes differ by microseconds in what they found of the clock: one clock, of the one that knows it best.
    best = min(found.values(), key=lambda one: one.alignment.lag_std_s)
    begin = min(one.places[0] for one in found.values())
    end = max(one.places[-1] for one in found.values()) + 1
    clock = best.alignment.on_video(record.time_s[begin:end])
    values, stds = (np.full((end - begin, len(found)), np.nan) for _ in range(2))
    codes = np.full((end - begin, len(found)), _NO_SENSOR, np.int8)
    notes = list(notes)
    for number, (axis, one) in enumerate(found.items()):
        place = one.places - begin
        known = record.known[one.places]
        values[place, number] = np.where(known, one.values_mm, np.nan)
        stds[place, number] = np.where(known, one.stds_mm, np.nan)
        codes[place, number] = np.where(known, np.where(one.bridged, _BRIDGED, _OK), _NO_SENSOR)
        notes += _list_notes(axis, one, of_point)
    combined = np.sqrt(np.square(stds) + _share_systematic(of_point.sel(axis=list(found)), values))
    dims = ("time", "axis")
    flags = np.arange(len(FUSED_MEANINGS), dtype=np.int8)
    meanings = {"flag_values": flags, "flag_meanings": " ".join(FUSED_MEANINGS)}
    by_axis = {
        name: ("axis", np.array([of(one) for one in found.values()]), {"units": units})
        for name, (units, of) in _BY_AXIS.items()
    }
    interval = float(np.mean(np.diff(clock)))
    attrs = {
        "status": FusionStatus.OK,
        "point": str(of_point["point"].values),
        "sensor": sensor,
        "sampling_rate_hz": 1 / interval,
        "band_hz": [0.0, _BAND_SHARE / interval],
        "notes": notes,
        **{name: of_point.attrs[name] for name in ("session_hash", START) if name in of_point.attrs},
        "displacement_key": str(of_point.attrs.get("key", "")),
    }
    variables = {
        "displacement": (dims, values, {"units": "mm"}),
        "displacement_std": (dims, stds, {"units": "mm"}),
        "combined_std": (dims, combined, {"units": "mm"}),
        "status": (dims, codes, meanings),
        **by_axis,
    }
    return xr.Dataset(variables, {"time": ("time", clock, {"units": "s"}), "axis": list(found)}, attrs)


def fail_fusion(point: str, sensor: str, axes: Sequence[str], status: FusionStatus, notes: Sequence[str]) -> xr.Dataset:
    """A dataset without samples that says why.

    Parameters
    ----------
    point, sensor, axes
        Names.
    status
        The reason.
    notes
        Sentences on the record.
    """
    none = ("time", "axis"), np.zeros((0, len(axes)))
    names = ("displacement", "displacement_std", "combined_std")
    variables: dict[str, tuple[tuple[str, ...], FloatArray, dict[str, str]]] = {
        name: (*none, {"units": "mm"}) for name in names
    }
    variables["status"] = (*none, {})
    for name, (units, _) in _BY_AXIS.items():
        variables[name] = (("axis",), np.full(len(axes), np.nan), {"units": units})
    coords = {"time": ("time", np.zeros(0), {"units": "s"}), "axis": list(axes)}
    attrs = {"status": status, "point": point, "sensor": sensor, "notes": list(notes)}
    return xr.Dataset(variables, coords, attrs)


_M_PER_MM = 1e-3
_BY_AXIS: Mapping[str, tuple[str, Callable[[Fused], float]]] = {
    "gain": ("1", lambda one: one.gains[one.own]),
    "gain_std": ("1", lambda one: one.gain_stds[one.own]),
    "size": ("1", lambda one: one.size),
    "size_std": ("1", lambda one: one.size_std),
    "lag": ("s", lambda one: one.alignment.lag_s),
    "lag_std": ("s", lambda one: one.alignment.lag_std_s),
    "clock_rate": ("1", lambda one: one.alignment.rate_ratio),
    "clock_rate_std": ("1", lambda one: one.alignment.drift_std),
    "bias": ("m/s2", lambda one: _M_PER_MM * one.bias),
    "sensor_noise": ("m/s2/sqrt(Hz)", lambda one: _M_PER_MM * one.levels.sensor_density),
    "video_std": ("mm", lambda one: one.video_std_mm),
    "slow_std": ("mm", lambda one: one.slow_std_mm),
    "slow_time": ("s", lambda one: one.levels.slow_s),
    "exposure": ("s", lambda one: one.exposure_s),
    "innovation_rms": ("mm", lambda one: one.innovation_rms_mm),
    "innovation_ratio": ("1", lambda one: one.innovation_ratio),
    "stated_ratio": ("1", lambda one: one.levels.video_factor),
}


def _share_systematic(of_point: xr.Dataset, values: FloatArray) -> FloatArray:
    """Variance of what the video's budget has beside its random part, at fused values, shape (N, A) [mm2]."""
    seen = of_point.transpose("time", "axis", ...)
    motion = seen["displacement"].values
    if "uncertainty" not in seen:
        return np.asarray(np.square(seen["scale_std"].values * np.nan_to_num(values)))
    budget = seen["uncertainty"].transpose("component", "time", "axis")
    known = np.where(np.isfinite(motion), 1.0, np.nan)

    def mean_square(components: Sequence[str]) -> FloatArray:
        squares = np.sum(np.square(budget.sel(component=list(components)).values), axis=0)
        return np.asarray(np.nanmean(squares * known, axis=0))

    moved = np.nanmean(np.square(motion), axis=0)
    scale = np.divide(mean_square(_SCALING), moved, out=np.zeros_like(moved), where=moved > 0)
    return np.asarray(scale * np.square(values) + mean_square(_STEADY))


def _list_notes(axis: str, one: Fused, of_point: xr.Dataset) -> list[str]:
    """What a reader must know of one axis."""
    notes = []
    if one.levels.video_factor > _LARGE_FACTOR:
        notes.append(
            f"{axis}: the video scatters {one.levels.video_factor:.1f} times as much as it states; check that the "
            "sensor sits at the point"
        )
    if one.innovation_ratio > _LARGE_RATIO:
        notes.append(
            f"{axis}: the video is off what the sensor predicts by {one.innovation_ratio:.1f} times what both explain; "
            "do not rely on the intervals"
        )
    if one.worst_innovation > _JUMP:
        notes.append(
            f"{axis}: at {one.worst_s:.2f} s the video is off what the sensor predicts by {one.worst_innovation:.0f} "
            "times what both explain; one of them jumped there and the result is wrong about it"
        )
    gain, std = (values[one.own] for values in (one.gains, one.gain_stds))
    spread = float(np.hypot(std, float(of_point["scale_std"].sel(axis=axis))))
    if abs(gain - 1) > _DISAGREE_STD * spread:
        notes.append(
            f"{axis}: video and sensor differ in size by {100 * (gain - 1):+.1f} %, which the stated uncertainty of "
            "the scale does not explain; check the lengths of the site and the sensor's units"
        )
    return notes
