"""A measurement against a reference: clocks brought together, the same band on both, metrics of each point and axis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.analysis.evaluation.metrics import Score, score
from vfm_sdm.analysis.evaluation.records import Evaluation, EvaluationRow
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import check_displacement
from vfm_sdm.core.sensor_datasets import check_reference
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.clocks import estimate_remaining_lag, even_clock, interpolate
from vfm_sdm.signals.filters import band_pass
from vfm_sdm.stages.synchronize import LagSearch, estimate_sensor_lag

__all__ = ["ReferenceClock", "evaluate"]

_LAG_BAND_HZ = (1.0, 10.0)
"""Band in which a lag is estimated when none is given [Hz]: the vibration, not the drift of either side."""
_LONGEST_S = 1e6
_FEWEST_STAMPS = 4
"""Stamps that the estimate of the lag and the splines need at least."""


@dataclass(frozen=True)
class ReferenceClock(LagSearch):
    """How the clock of a reference is brought to that of the measurement.

    Parameters
    ----------
    search_s, start_lag_s, start_std_s
        Where the lag of the reference is looked for, see `vfm_sdm.stages.synchronize.LagSearch` [s]. Where no lag is
        estimated, ``start_lag_s`` is the lag.
    synchronize
        Whether to estimate the lag of the reference, jointly over all pairs. Left out: yes for sensors, which have a
        clock of their own, and no for another displacement dataset, which shares the measurement's.
    """

    search_s: float = 5.0
    synchronize: bool | None = None

    def __post_init__(self) -> None:
        if not (abs(self.start_lag_s) <= _LONGEST_S and 0 < self.search_s <= _LONGEST_S):
            raise DatasetError(
                f"clock: expected a lag within {_LONGEST_S:g} s and a search up to as much, got {self.start_lag_s:g} "
                f"and {self.search_s:g} s; correct them"
            )


@dataclass(frozen=True)
class _Comparison:
    """Series and settings that are the same for all rows."""

    displacement: xr.Dataset
    reference: xr.DataArray
    """Displacement [mm], dims ``time, place, axis``."""
    clock_s: FloatArray
    """Stamps of the reference on the measurement's clock; NaN when not known."""
    band_hz: tuple[float, float] | None
    remove_offset: bool


def evaluate(
    displacement: xr.Dataset,
    reference: xr.Dataset,
    *,
    pairs: Mapping[str, str] | None = None,
    axes: Sequence[str] = ("lateral", "vertical"),
    band_hz: tuple[float, float] | None = None,
    clock: ReferenceClock | None = None,
) -> Evaluation:
    """Metrics of every point and axis of a measurement that a reference knows.

    Parameters
    ----------
    displacement
        The measurement: a displacement dataset (`vfm_sdm.core.datasets`), shape (T, P, 3) [mm].
    reference
        A reference dataset of sensors, shape (T', S, A) [mm] (`vfm_sdm.inputs.sensors.accelerometer.compute_reference`,
        `vfm_sdm.inputs.sensors.sensor_csv.read_reference`), or another displacement dataset, such as the truth of a
        synthetic field test [mm].
    pairs
        Sensor, or point of the reference, that belongs to each point of the measurement. Left out: those of the same
        name, without points that do not move in the reference at all (static points).
    axes
        Axes to compare; one that either side lacks is left out, and a note says so.
    band_hz
        Band that both sides are filtered to [Hz]. Left out: the band of the reference, where it states one
        (displacement from acceleration holds nothing outside it), else no filtering.
    clock
        How the reference's clock is brought to the measurement's. Left out: the lag of sensors is estimated within 5 s
        of zero, and another displacement dataset shares the measurement's clock.

    Returns
    -------
    evaluation
        One row of metrics for every compared point and axis; lengths in mm.

    Raises
    ------
    DatasetError
        A dataset has other dims or units; a pair names what is not there; nothing is left to compare; the band does
        not fit the sampling rate.

    Notes
    -----
    A stamp t of the reference is ``t * rate_ratio + offset_s`` on the measurement's clock; from there the reference is
    interpolated to the measurement's stamps by splines over unbroken runs. Uneven stamps (missing frames) are first
    brought to an even clock where a filter needs one. Where the lag cannot be told, all metrics are NaN.

    The zero of a sensor's displacement is arbitrary, so the mean difference is removed. Another displacement dataset is
    taken to have the measurement's zero, and nothing is removed.

    Unfiltered, ``coverage`` is that of the expanded uncertainty (`vfm_sdm.stages.displacement.uncertainty`), or, in
    datasets without one, of plus or minus twice ``sqrt(std^2 + (scale_std d)^2)``, random and systematic part together;
    nominally 95 %. In a band nothing was stated, and it is NaN.

    ``lag_s`` is what is left after alignment, for the series alone: with e the estimate and r the reference,
    ``e = c + a r + b r'`` by least squares and ``lag = -b / a``, because ``a r(t - lag)`` is ``a r - a lag r'`` for a
    lag much shorter than a period.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> time_s = np.arange(300) / 30
    >>> def moving(gain):
    ...     motion = gain * np.sin(2 * np.pi * 2 * time_s)[:, None, None] * [1.0, 2.0, 0.0]
    ...     return make_displacement(
    ...         time_s,
    ...         ["mid"],
    ...         STRUCTURE_AXES,
    ...         DisplacementArrays(
    ...             displacement_mm=motion,
    ...             displacement_std_mm=np.full((300, 1, 3), 0.1),
    ...             scale_std=np.zeros((1, 3)),
    ...             position_m=np.zeros((300, 1, 3)),
    ...             reprojection_error_px=np.zeros((300, 1)),
    ...             status=np.zeros((300, 1)),
    ...         ),
    ...         attrs={"frame": "structure"},
    ...     )
    >>> evaluation = evaluate(moving(1.01), moving(1.0))
    >>> [(row.axis, round(row.score.gain, 3)) for row in evaluation.rows]
    [('lateral', 1.01), ('vertical', 1.01)]
    """
    check_displacement(displacement)
    against_sensors = "sensor" in reference.dims
    if against_sensors:
        check_reference(reference)
    else:
        check_displacement(reference)
    if min(displacement.sizes["time"], reference.sizes["time"]) < _FEWEST_STAMPS:
        raise DatasetError(
            f"time: expected at least {_FEWEST_STAMPS} stamps on both sides, got {displacement.sizes['time']} and "
            f"{reference.sizes['time']}; check that the right files are compared"
        )
    places = reference["displacement"].rename({"sensor" if against_sensors else "point": "place"})
    chosen_axes, notes = _choose_axes(displacement, places, axes)
    notes += [f"reference: {note}" for note in reference.attrs.get("notes", ()) if against_sensors]
    places = places.sel(axis=chosen_axes)
    chosen = _choose_pairs(displacement, places, pairs)
    band = _choose_band(reference, band_hz, notes)
    synchronization = None
    clock = clock or ReferenceClock()
    clock_s = reference["time"].values - clock.start_lag_s
    if clock.synchronize or (clock.synchronize is None and against_sensors):
        synchronization = estimate_sensor_lag(
            displacement,
            places.rename(place="sensor").to_dataset(name="displacement"),
            pairs=list(chosen.items()),
            axes=chosen_axes,
            search=clock,
            band_hz=_LAG_BAND_HZ if band is None else band,
        )
        clock_s = reference["time"].values * synchronization.rate_ratio + synchronization.offset_s
        if not synchronization.ok:
            notes.append(
                f"lag of the reference unknown: {synchronization.status}; widen or narrow the search, or state the lag"
            )
    comparison = _Comparison(displacement, places, clock_s, band, remove_offset=against_sensors)
    rows = tuple(
        _make_row(comparison, point, place, axis, notes) for point, place in chosen.items() for axis in chosen_axes
    )
    name = (
        f"sensors {', '.join(chosen.values())}"
        if against_sensors
        else str(reference.attrs.get("title", "displacement"))
    )
    return Evaluation(rows, synchronization, band, name, tuple(notes))


def _choose_axes(displacement: xr.Dataset, places: xr.DataArray, axes: Sequence[str]) -> tuple[list[str], list[str]]:
    """The axes that both sides have, and a note on the others."""
    measured, known = (list(map(str, side["axis"].values)) for side in (displacement, places))
    axes = list(dict.fromkeys(axes))
    chosen = [axis for axis in axes if axis in measured and axis in known]
    if not chosen:
        raise DatasetError(f"axes: expected some of {list(axes)} on both sides, got {measured} and {known}; name them")
    missing = [axis for axis in axes if axis not in chosen]
    return chosen, [f"left out: axes {missing}, which one side does not have"] if missing else []


def _choose_pairs(displacement: xr.Dataset, places: xr.DataArray, pairs: Mapping[str, str] | None) -> dict[str, str]:
    points, known = (list(map(str, side)) for side in (displacement["point"].values, places["place"].values))
    if pairs is None:
        still = (places.max("time") == places.min("time")).all("axis")
        pairs = {point: point for point in points if point in known and not still.sel(place=point)}
    if not pairs or not ({*pairs} <= {*points} and {*pairs.values()} <= {*known}):
        raise DatasetError(
            f"pairs: expected points of {points}, each with one of {known}, got {dict(pairs)}; pair them"
        )
    return dict(pairs)


def _choose_band(
    reference: xr.Dataset, band_hz: tuple[float, float] | None, notes: list[str]
) -> tuple[float, float] | None:
    """The band that is asked for, else the one that the reference is limited to [Hz]."""
    if "band_hz" not in reference.attrs:
        return band_hz
    low, high = (float(edge) for edge in reference.attrs["band_hz"])
    if band_hz is None:
        # A recorded displacement reaches down to standstill; only its sampling rate limits it.
        return (low, high) if low > 0 else None
    if band_hz[0] < low or band_hz[1] > high:
        notes.append(f"the band {band_hz[0]:g} to {band_hz[1]:g} Hz is wider than the reference's, {low:g} to {high:g}")
    return band_hz


def _make_row(comparison: _Comparison, point: str, place: str, axis: str, notes: list[str]) -> EvaluationRow:
    measured = comparison.displacement.sel(point=point, axis=axis)
    time_s, values = measured["time"].values, measured["displacement"].values
    known = comparison.reference.sel(place=place, axis=axis).values
    std: FloatArray | None = np.hypot(
        measured["displacement_std"].values, float(measured["scale_std"]) * np.abs(values)
    )
    if "combined_std" in measured:
        std = measured["combined_std"].values
    if not np.isfinite(comparison.clock_s).all():
        return _make_empty_row(point, axis, comparison)
    if comparison.band_hz is None:
        truth = interpolate(comparison.clock_s, known, time_s)
    else:
        std = None
        grid, rate_hz = even_clock(time_s)
        values = values if grid is time_s else interpolate(time_s, values, grid)
        truth = interpolate(comparison.clock_s, known, grid)
        # Cut alike first: what a filter rings at the ends then is the same on both sides.
        both = np.isfinite(values) & np.isfinite(truth)
        values, truth = (band_pass(np.where(both, v, np.nan), rate_hz, comparison.band_hz) for v in (values, truth))
        time_s = grid
    lag_s = estimate_remaining_lag(time_s, values, truth)
    try:
        metrics = score(
            values,
            truth,
            estimate_std=std,
            remove_offset=comparison.remove_offset,
        )
    except DatasetError as error:
        # Shapes are right by construction: what is left are series too short, too still or too full of gaps.
        notes.append(f"{point!r}, {axis}: {error}")
        return _make_empty_row(point, axis, comparison)
    both = np.isfinite(values) & np.isfinite(truth)
    error_mm = (values - truth)[both] - (metrics.offset if comparison.remove_offset else 0.0)
    return EvaluationRow(
        point,
        axis,
        replace(metrics, band_hz=comparison.band_hz, lag_s=lag_s),
        float(np.ptp(values[both])),
        float(np.ptp(truth[both])),
        float(np.sqrt(np.mean(error_mm**2))),
    )


def _make_empty_row(point: str, axis: str, comparison: _Comparison) -> EvaluationRow:
    """A row whose metrics are all NaN."""
    unknown: dict[str, Any] = {field.name: np.nan for field in fields(Score)}
    unknown |= {"samples": 0, "band_hz": comparison.band_hz, "offset_removed": comparison.remove_offset}
    return EvaluationRow(point, axis, Score(**unknown), np.nan, np.nan, np.nan)
