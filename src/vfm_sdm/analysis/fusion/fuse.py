"""Displacement of a point from standstill to the band of a sensor, of the video and of the sensor together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
import xarray as xr

from vfm_sdm.analysis.fusion.along import Alignment, Fused, Record, Video, fuse_along
from vfm_sdm.analysis.fusion.bands import BandSize, compare_bands, find_contradicting
from vfm_sdm.analysis.fusion.result import describe_fusion, fail_fusion
from vfm_sdm.analysis.fusion.still_points import estimate_video_errors
from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import START, check_displacement, trusted_values
from vfm_sdm.core.sensor_datasets import check_acceleration
from vfm_sdm.core.statuses import ClockStatus, FusionStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings, compute_reference
from vfm_sdm.inputs.sensors.outliers import find_lone
from vfm_sdm.inputs.sensors.readings import find_readings, name_defects, reading_status
from vfm_sdm.stages.synchronize import LagSearch, Synchronization
from vfm_sdm.stages.synchronize.dataset_lags import estimate_sensor_lag

__all__ = ["FusionSettings", "fuse", "search_about_start"]

_FEWEST_FRAMES = 60
"""Values of the video below which nothing is known of its noise."""
_LAG_BANDS_HZ = ((1.0, 10.0), (0.5, 10.0), (2.0, 10.0))
"""Bands in which the lag is looked for, the next where one does not tell it: below, the sensor drifts, and a period of
the lower end is lost on both sides of what was not recorded."""
_SEARCH_S, _SEARCH_ABOUT_START_S = 5.0, 2.0
"""How far the lag is looked for: about zero, and about what the start times of video and sensor say, whose seconds are
often rounded [s]."""
_SAMPLES_OF_FASTEST = 4.0
_FILLED = 1.5
"""Intervals of the sensor's clock up to which missing samples are filled."""
_MM_PER_M = 1e3
_MOST_OFF = 4.0
"""Standard deviations of a sensor's sensitivity beyond which its axis is another one, or in other units."""
_NO_STATIC = (
    "no static point shows how the video errs slowly: 0.3 of its scatter is assumed, within a factor of two; add "
    "a point that must not move"
)
_BY_START = (
    "the lag is looked for within {search.search_s:.3g} s of {search.start_lag_s:.2f} s, by the start times of "
    "video and sensor"
)
_LEFT_OUT = (
    "{axis}: left out; the video is {gain:.2f} times the sensor; check the sensor's units and the sign of its column"
)
_FAILURES = {
    ClockStatus.NOT_UNIQUE: FusionStatus.AMBIGUOUS,
    ClockStatus.AT_EDGE: FusionStatus.AT_EDGE,
    ClockStatus.TOO_SHORT: FusionStatus.TOO_SHORT,
    ClockStatus.TOO_SLOW: FusionStatus.TOO_SHORT,
}


@dataclass(frozen=True)
class FusionSettings:
    """What is known of the sensor beforehand.

    Parameters
    ----------
    gain_std
        Standard deviation of the sensor's sensitivity over the scale of the video [1].
    cross_std
        Share of one axis that another one shows, by misalignment [1]: 0.05 are three degrees.
    clock_std
        Standard deviation of the rate of the sensor's clock [1], where the motion does not tell it.
    search
        Where the lag of the sensor's clock is looked for [s]; as `search_about_start` says when ``None``.
    """

    gain_std: float = 0.1
    cross_std: float = 0.05
    clock_std: float = 1e-4
    search: LagSearch | None = None


def search_about_start(
    displacement: xr.Dataset, acceleration: xr.Dataset, *, start_lag_s: float | None = None
) -> LagSearch:
    """Where the lag of a sensor's clock is looked for: about what is stated, or the start times of both recordings say.

    Parameters
    ----------
    displacement
        Displacement dataset; attribute ``time_coverage_start`` is when its time is zero.
    acceleration
        Acceleration dataset; attribute ``start_utc`` is when its first sample was taken.
    start_lag_s
        How much later the sensor's clock shows an event, as far as somebody knows [s].

    Examples
    --------
    >>> from vfm_sdm.core.sensor_datasets import make_acceleration
    >>> video = xr.Dataset(attrs={START: "2026-11-20T10:15:30.25+00:00"})
    >>> times = np.arange(300) / 100 + 0.5
    >>> sensed = make_acceleration(times, ["phone"], ["vertical"], np.zeros((300, 1, 1)), sampling_rate_hz=100.0)
    >>> search_about_start(video, sensed.assign_attrs(start_utc="2026-11-20T10:15:18+00:00"))
    LagSearch(search_s=2.0, start_lag_s=12.75, start_std_s=None)
    """
    begun = displacement.attrs.get(START), acceleration.attrs.get("start_utc")
    if start_lag_s is not None or not all(begun):
        return LagSearch(_SEARCH_S, start_lag_s or 0.0)
    video, sensor = (datetime.fromisoformat(str(one)) for one in begun)
    later = (video - sensor).total_seconds() + float(acceleration["time"].values[0])
    return LagSearch(_SEARCH_ABOUT_START_S, later)


def fuse(
    displacement: xr.Dataset,
    acceleration: xr.Dataset,
    point: str,
    *,
    axes: Sequence[str] = (),
    static: Sequence[str] = (),
    settings: FusionSettings | None = None,
) -> xr.Dataset:
    """One displacement of a point from standstill to the sensor's band, at the sensor's rate, on the video's clock.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    acceleration
        Acceleration of one sensor at that point, shape (T', 1, A) [m/s2], with gravity, on its own clock.
    point
        The point.
    axes
        Axes to fuse; all that the sensor has when left out.
    static
        Points that must not move, which show how the video errs slowly.
    settings
        What is known of the sensor.

    Returns
    -------
    fused
        Dims ``time`` and ``axis``: ``displacement``, ``displacement_std`` (all but the scale and what else the whole
        series shares), ``combined_std`` [mm] and ``status``; by axis what was found of sensor and video, see
        `vfm_sdm.analysis.fusion.result.describe_fusion`, and whether they agree at all frequencies, ``bands_agree``.
        Attribute ``status`` is one of
        `vfm_sdm.core.statuses.FusionStatus`; there are no samples unless it is ``ok``.

    Raises
    ------
    DatasetError
        The datasets are not as described, or have no point or axis of that name.

    Notes
    -----
    A Kalman filter over displacement, velocity and the sensor's bias, driven by the measured acceleration, whose gain
    and misalignment, lag and drift of the clock are states, too; values of the video are means over the exposure, with
    noise from frame to frame and a slow error, which is a state because it does not average out [1]_. The smoother runs
    over values of both kinds. Levels of noise are estimated from the record; the spread that it leaves them is part of
    the result's. Docs: fuse.md.

    References
    ----------
    .. [1] Smyth, A., & Wu, M. (2007). Multi-rate Kalman filtering for the data fusion of displacement and acceleration
       response measurements in dynamic system monitoring. Mechanical Systems and Signal Processing 21(2), 706-723.
    """
    settings = settings or FusionSettings()
    check_displacement(displacement)
    check_acceleration(acceleration)
    chosen = _choose_axes(displacement, acceleration, point, axes)
    sensor = str(acceleration["sensor"].values[0])
    rate_hz = float(acceleration.attrs["sampling_rate_hz"])
    acceleration, notes = _replace_lone(acceleration)
    codes, filled, known = find_readings(acceleration, longest_gap_s=_FILLED / rate_hz)
    # The recipe leaves out what is named, and refuses what is not.
    acceleration = acceleration.assign(status=reading_status(codes))
    sensed = [str(name) for name in acceleration["axis"].values]
    notes = [
        *notes,
        *acceleration.attrs.get("notes", ()),
        *name_defects(codes, acceleration["time"].values, [sensor], sensed),
    ]
    search, by_start = _choose_search(settings.search, displacement, acceleration)
    notes += by_start
    lag = _find_lag(displacement, acceleration, (point, sensor), chosen, search)
    values = trusted_values(displacement, "displacement")
    if not lag.ok:
        status = _FAILURES.get(ClockStatus(lag.status), FusionStatus.NO_MOTION)
        return fail_fusion(point, sensor, chosen, status, [*notes, f"lag of the sensor: {lag.status}"])
    record = Record(
        acceleration["time"].values, _MM_PER_M * filled[:, 0], np.asarray(known[:, 0].all(axis=1)), tuple(sensed)
    )
    alignment = _align(lag, record, settings)
    videos = {axis: _read_video(displacement, values, point, axis, record, alignment) for axis in chosen}
    seen = {axis: video for axis, video in videos.items() if np.isfinite(video.values_mm).sum() >= _FEWEST_FRAMES}
    if not seen:
        return fail_fusion(point, sensor, chosen, FusionStatus.TOO_SHORT, notes)
    errors = estimate_video_errors(displacement, static, list(seen))
    if not errors.points:
        notes.append(_NO_STATIC)
    found: dict[str, Fused] = {}
    apart: dict[str, tuple[BandSize, BandSize] | None] = {}
    # The axis that moves most tells the clock best; the others begin with what it found.
    for axis in sorted(seen, key=lambda one: -_strength(seen[one])):
        one = fuse_along(record, seen[axis], axis, alignment, errors)
        gain = float(one.gains[one.own])
        if gain < 0 or abs(gain - 1) > _MOST_OFF * settings.gain_std:
            notes.append(_LEFT_OUT.format(axis=axis, gain=gain))
            continue
        found[axis], apart[axis] = one, find_contradicting(compare_bands(record, seen[axis], one))
        alignment = replace(one.alignment, gain_std=alignment.gain_std, cross_std=alignment.cross_std)
    if not found:
        return fail_fusion(point, sensor, chosen, FusionStatus.OTHER_SIZE, notes)
    notes += [_name_bands(axis, *bands) for axis, bands in apart.items() if bands is not None]
    in_order = {axis: found[axis] for axis in seen if axis in found}
    described = describe_fusion(displacement.sel(point=point), in_order, record, sensor, notes)
    return described.assign(bands_agree=("axis", np.array([apart[axis] is None for axis in in_order], np.int8)))


def _name_bands(axis: str, one: BandSize, other: BandSize) -> str:
    """What two bands say of an axis that contradict each other."""
    return (
        f"{axis}: the video over the sensor is {one.size:.2f} from {one.low_hz:.2g} to {one.high_hz:.2g} Hz and "
        f"{other.size:.2f} from {other.low_hz:.2g} to {other.high_hz:.2g} Hz; the sensor sits elsewhere or does not "
        "show all frequencies alike"
    )


def _replace_lone(acceleration: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """The acceleration with lone wrong samples as those beside them have it, and a note on each axis that has any."""
    values, time_s = acceleration["acceleration"].values.copy(), acceleration["time"].values
    notes = []
    for a, axis in enumerate(acceleration["axis"].values):
        lone = find_lone(values[:, 0, a])
        if not lone.any():
            continue
        values[lone, 0, a] = np.interp(time_s[lone], time_s[~lone], values[~lone, 0, a])
        first = time_s[lone][0]
        notes.append(f"{axis}: {lone.sum()} lone samples are bridged, the first at {first:.6g} s; check the logger")
    return acceleration.assign(acceleration=acceleration["acceleration"].copy(data=values)), notes


def _choose_axes(displacement: xr.Dataset, acceleration: xr.Dataset, point: str, axes: Sequence[str]) -> list[str]:
    points = [str(name) for name in displacement["point"].values]
    if point not in points:
        raise DatasetError(f"point: expected one of {points}, got {point!r}; name the point that the sensor sits at")
    if acceleration.sizes["sensor"] != 1:
        raise DatasetError(f"sensor: expected one, got {acceleration.sizes['sensor']}; choose one with sel")
    measured, sensed = ([str(name) for name in one["axis"].values] for one in (displacement, acceleration))
    shared = [axis for axis in measured if axis in sensed]
    if not shared or not {*axes} <= {*shared}:
        raise DatasetError(
            f"axes: expected some of {shared}, which video and sensor have, got {list(axes)}; name the sensor's "
            "columns in the session"
        )
    return list(axes) or shared


def _choose_search(
    given: LagSearch | None, displacement: xr.Dataset, acceleration: xr.Dataset
) -> tuple[LagSearch, list[str]]:
    """Where the lag is looked for, and a note where it was start times that told it."""
    search = given or search_about_start(displacement, acceleration)
    told = given is None and search != LagSearch(_SEARCH_S)
    return search, [_BY_START.format(search=search)] * told


def _find_lag(
    displacement: xr.Dataset,
    acceleration: xr.Dataset,
    pair: tuple[str, str],
    axes: list[str],
    search: LagSearch,
) -> Synchronization:
    """Lag of the sensor's clock, from its displacement by the paper's recipe."""
    highest = float(acceleration.attrs["sampling_rate_hz"]) / _SAMPLES_OF_FASTEST
    found = Synchronization(np.nan, np.nan, np.nan, ClockStatus.TOO_SHORT)
    for low, high in _LAG_BANDS_HZ:
        band = (low, min(high, highest))
        begin_s = float(acceleration["time"].values[0])
        try:
            recipe = RecipeSettings(onset_s=begin_s, band_hz=band, integration="spline", hampel="off")
            reference = compute_reference(acceleration, recipe)
        except DatasetError:
            continue
        tried = estimate_sensor_lag(displacement, reference, pairs=[pair], axes=axes, search=search, band_hz=band)
        # The first band says best why there is none.
        found = tried if tried.ok or found.status == ClockStatus.TOO_SHORT else found
        if found.ok:
            break
    return found


def _align(lag: Synchronization, record: Record, settings: FusionSettings) -> Alignment:
    """How the sensor's clock and axes relate to the video's, before the filter has seen them."""
    drift_std = lag.rate_ratio_std if np.isfinite(lag.rate_ratio_std) else settings.clock_std
    return Alignment(
        lag.rate_ratio, lag.offset_s, lag.lag_std_s, drift_std, lag.at_s, settings.gain_std, settings.cross_std
    )


def _read_video(
    displacement: xr.Dataset, values: FloatArray, point: str, axis: str, record: Record, alignment: Alignment
) -> Video:
    """One series of the video, where the sensor recorded, too."""
    p, a = (list(displacement[dim].values).index(name) for dim, name in (("point", point), ("axis", axis)))
    time_s = displacement["time"].values
    stds = displacement["displacement_std"].values[:, p, a]
    clock = alignment.on_video(record.time_s)
    interval = float(np.median(np.diff(time_s)))
    inside: BoolArray = (time_s > clock[0] + interval) & (time_s < clock[-1] - interval) & (stds > 0)
    return Video(time_s, np.where(inside, values[:, p, a], np.nan), stds)


def _strength(video: Video) -> float:
    """Motion over noise [1]."""
    return float(np.nanstd(video.values_mm) / np.nanmedian(video.stds_mm))
