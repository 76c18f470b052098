"""The displacement field of a structure: its deflection line at every time, with its uncertainty."""

from collections.abc import Collection

import numpy as np
import xarray as xr

from vfm_sdm.analysis.field.fit import FittedAxis, fit_axis
from vfm_sdm.analysis.field.shapes import find_shapes
from vfm_sdm.core.arrays import BoolArray, FloatArray, time_blocks
from vfm_sdm.core.datasets import Status, check_displacement, trusted_values
from vfm_sdm.errors import DatasetError

__all__ = ["NOT_OF_STRUCTURE", "compute_field"]

NOT_OF_STRUCTURE = "not of the structure"
"""Reason of static points."""

_LEAST_POINTS = 6
_LEAST_SHARE = 0.9
"""Share of the samples that a point must have."""
_LEAST_FRAMES = 20
_LEAST_REACH_M, _MOST_GAP = 0.01, 0.4
"""Least length of the line [m], and longest part of it without a point [1]: no record of points tells what is there."""
_COMMON = ("cameras", "synchronization", "assumption", "compression")
"""Components of a point's budget that all points have alike: no number of points makes them smaller."""
_NEIGHBOURS = 15
"""Points next to a station whose budgets say what all have in common there."""


def compute_field(
    displacement: xr.Dataset,
    *,
    static: Collection[str] = (),
    stations: int = 61,
    still_interval_s: tuple[float, float] | None = None,
) -> xr.Dataset:
    """Displacement of a structure along its length, with its uncertainty, from all its points together.

    Parameters
    ----------
    displacement
        Displacement dataset along the structure's axes, shape (T, P, 3) [mm].
    static
        Names of points that are not of the structure.
    stations
        How many places S along the structure, from its first point to its last.
    still_interval_s
        While the structure stood, if that is known: what moves then is an error that all points share.

    Returns
    -------
    field
        ``displacement`` and ``displacement_std`` (time, station, axis) [mm], k = 1, all errors; ``common_std`` of it,
        what all points share; ``position`` (station, axis) [m]; of the points ``used`` (point, axis), ``reason``
        (point) why one is left out, ``point_place`` (point, axis) [m] at rest; on ``axis`` what was found of the
        errors: ``gain_scatter`` [1], ``correlated_share`` [1], ``correlation_length`` [m], ``point_std`` [mm] (median);
        and operational ``shape`` (shape, station, axis) [1] with their ``shape_frequency`` (shape) [Hz].

    Raises
    ------
    DatasetError
        The axes are not the structure's, or too few points were measured along it.

    Notes
    -----
    Points that lie beside each other compare the same pixels in part, so that their errors are alike; how much is
    measured from what the field leaves of them (`vfm_sdm.analysis.field.errors.measure_errors`). Cameras, clocks,
    assumptions and compression make the same error everywhere and are taken from the points' budgets.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
    >>> time_s, station = np.arange(60) / 20, np.linspace(0, 10, 40)
    >>> motion = np.zeros((60, 40, 3))
    >>> motion[..., 1] = np.sin(9 * time_s)[:, None] * np.sin(np.pi * station / 10)
    >>> motion += np.random.default_rng(0).normal(0, 0.01, motion.shape)
    >>> place = np.zeros((60, 40, 3))
    >>> place[..., 2] = station
    >>> arrays = DisplacementArrays(
    ...     motion, np.full(motion.shape, 0.01), np.zeros((40, 3)), place, np.zeros((60, 40)), np.zeros((60, 40))
    ... )
    >>> names = [f"p{number}" for number in range(40)]
    >>> made = make_displacement(time_s, names, STRUCTURE_AXES, arrays, attrs={"frame": "structure"})
    >>> field = compute_field(made, stations=5)
    >>> true = np.sin(9 * 0.1) * np.sin(np.pi * field["station"] / 10)
    >>> float(np.abs(field["displacement"][2, :, 1] - true).max()) < 0.02
    True
    """
    data = check_displacement(displacement)
    if data.attrs.get("frame") != "structure":
        raise DatasetError(
            f"field: expected displacement along the structure's axes, got {data.attrs.get('frame')!r}; measure "
            "site.perpendicular_distance and site.longitudinal_distance"
        )
    if stations < 2:
        raise DatasetError(f"stations: expected at least 2, got {stations}; ask for more")
    if data.sizes["time"] < _LEAST_FRAMES:
        raise DatasetError(
            f"field: expected at least {_LEAST_FRAMES} frames, from which it learns how the structure moves, got "
            f"{data.sizes['time']}; measure a longer recording"
        )
    names = [str(name) for name in data["point"].values]
    values, place = trusted_values(data, "displacement"), _places(data)
    values = np.where(np.isfinite(data["displacement_std"].values), values, np.nan)
    share = np.isfinite(values).mean(axis=0)
    placed = np.asarray(np.isfinite(place).all(axis=1))
    moving = np.array([name not in static for name in names])
    usable = (share >= _LEAST_SHARE) & (moving & placed)[:, None]
    lacking = [
        str(axis) for axis, found in zip(data["axis"].values, usable.T, strict=True) if found.sum() < _LEAST_POINTS
    ]
    if lacking:
        raise DatasetError(
            f"field: expected at least {_LEAST_POINTS} points of the structure with {100 * _LEAST_SHARE:.0f} % of "
            f"their samples, got fewer along {', '.join(lacking)}; add a [[grid]] or more points"
        )
    fitted = []
    for a in range(3):
        stated = np.full(len(names), np.nan)
        stated[usable[:, a]] = np.nanmedian(data["displacement_std"].values[:, usable[:, a], a], axis=0)
        fitted.append(fit_axis(values[..., a], stated, place[:, 1:], usable[:, a]))
    begin, end = _find_reach(fitted, [str(axis) for axis in data["axis"].values])
    station = np.linspace(begin, end, stations)
    return _gather(data, fitted, place, station, still_interval_s).assign(
        reason=("point", _list_reasons(data, usable, fitted, static, placed))
    )


def _find_reach(fitted: list[FittedAxis], axes: list[str]) -> tuple[float, float]:
    """First and last station between which there are points along all axes [m]; nowhere far from any."""
    for one, axis in zip(fitted, axes, strict=True):
        stations = np.unique(one.station_m)
        gaps = np.diff(stations)
        if not gaps.size or gaps.sum() < _LEAST_REACH_M:
            raise DatasetError(
                f"field: expected points along the structure, got those along {axis} at one station, "
                f"{stations[0]:.2f} m; add a [[grid]] or points elsewhere along it"
            )
        widest = int(gaps.argmax())
        if gaps[widest] > _MOST_GAP * gaps.sum():
            raise DatasetError(
                f"field: expected points all along the structure, got none along {axis} from {stations[widest]:.2f} m "
                f"to {stations[widest + 1]:.2f} m; add a [[grid]] or points there, or leave out what lies beyond"
            )
    begin, end = max(one.station_m.min() for one in fitted), min(one.station_m.max() for one in fitted)
    if end - begin < _LEAST_REACH_M:
        spans = "; ".join(
            f"{axis} {one.station_m.min():.2f} m to {one.station_m.max():.2f} m"
            for one, axis in zip(fitted, axes, strict=True)
        )
        raise DatasetError(
            f"field: expected stations with points along every axis, got none: {spans}; add a [[grid]] or points that "
            "are measured along all axes"
        )
    return float(begin), float(end)


def _places(data: xr.Dataset) -> FloatArray:
    """Places of the points at rest: lateral, vertical, longitudinal, shape (P, 3) [m]."""
    if "origin" in data:
        return np.asarray(data["origin"].transpose("point", "axis").values)
    return np.asarray(data["position"].values[0])


def _gather(
    data: xr.Dataset,
    fitted: list[FittedAxis],
    place: FloatArray,
    station: FloatArray,
    still_interval_s: tuple[float, float] | None,
) -> xr.Dataset:
    """The field's dataset, of what was fitted along each axis."""
    time_s = data["time"].values
    shape = (len(time_s), len(station), 3)
    field, std, common = np.empty(shape), np.empty(shape), _common_std(data, fitted, station)
    for a, one in enumerate(fitted):
        field[..., a] = one.coefficients @ one.terms(station).T
        still, growing = one.variances(station)
        still = still + _moves_at_rest(field[..., a], still, time_s, still_interval_s)
        for rows in time_blocks(len(time_s)):
            moved = field[rows, :, a] ** 2
            std[rows, :, a] = np.sqrt(still + growing * moved + common[rows, :, a] ** 2)
    dims = ("time", "station", "axis")
    used = np.stack([one.used for one in fitted], axis=1)
    every = used.any(axis=1)
    position = np.stack([np.interp(station, *_sorted(place[every, 2], place[every, a])) for a in range(3)], axis=1)
    shapes, frequency = find_shapes(field, time_s)
    return xr.Dataset(
        {
            "displacement": (dims, field, {"units": "mm"}),
            "displacement_std": (dims, std, {"units": "mm"}),
            "common_std": (dims, common, {"units": "mm"}),
            "position": (("station", "axis"), position, {"units": "m"}),
            "used": (("point", "axis"), used.astype(np.int8)),
            "point_place": (("point", "axis"), place, {"units": "m"}),
            "gain_scatter": ("axis", [one.errors.gain_std for one in fitted], {"units": "1"}),
            "correlated_share": ("axis", [one.errors.shared for one in fitted], {"units": "1"}),
            "correlation_length": ("axis", [one.errors.length_m for one in fitted], {"units": "m"}),
            "point_std": ("axis", [float(np.median(one.errors.std_mm)) for one in fitted], {"units": "mm"}),
            "shape": (("shape_number", "station", "axis"), shapes, {"units": "1"}),
            "shape_frequency": (("shape_number", "axis"), frequency, {"units": "Hz"}),
        },
        coords={
            "time": data["time"],
            "station": ("station", station, {"units": "m"}),
            "axis": data["axis"],
            "point": data["point"],
            "shape_number": np.arange(1, len(shapes) + 1),
        },
        attrs={"frame": data.attrs["frame"], "displacement_key": str(data.attrs.get("key", ""))},
    )


def _sorted(station: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stations in rising order, each once, and the mean of the values there."""
    distinct, rows = np.unique(station.round(2), return_inverse=True)
    return distinct, np.bincount(rows.reshape(-1), values) / np.bincount(rows.reshape(-1))


def _common_std(data: xr.Dataset, fitted: list[FittedAxis], station: FloatArray) -> FloatArray:
    """What all points have in common, at the stations, shape (T, S, 3) [mm]; 0 where the dataset has no budget.

    Noise that budgets state and that points do not show against their neighbours is alike in these: a codec treats the
    pixels of a surface that moves as one alike.
    """
    result = np.zeros((data.sizes["time"], len(station), 3))
    if "uncertainty" not in data:
        return result
    names = [name for name in _COMMON if name in data["component"].values]
    for a, one in enumerate(fitted):
        budget = (
            data["uncertainty"].isel(axis=a, point=np.flatnonzero(one.used)).transpose("component", "time", "point")
        )
        parts, random = budget.sel(component=names), budget.sel(component="random")
        nearest = np.argsort(np.abs(station[:, None] - one.station_m), axis=1)[:, :_NEIGHBOURS]
        for rows in time_blocks(data.sizes["time"]):
            variance = (parts.isel(time=rows).values ** 2).sum(axis=0)
            variance += np.maximum(random.isel(time=rows).values ** 2 - one.errors.std_mm**2, 0.0)
            # The middle of neighbours: a budget of one that is poorly placed says nothing of the others.
            result[rows, :, a] = np.sqrt(_median_of_known(variance[:, nearest]))
    return result


def _median_of_known(values: FloatArray) -> FloatArray:
    """Median over the last axis of what is known; 0 where nothing is, and then there is no line either."""
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    ordered = np.sort(np.where(known, values, np.inf), axis=-1)
    middle = np.maximum((count - 1) // 2, 0)
    found = np.take_along_axis(ordered, middle[..., None], axis=-1)[..., 0]
    return np.asarray(np.where(count > 0, found, 0.0))


def _moves_at_rest(
    field: FloatArray, still: FloatArray, time_s: FloatArray, still_interval_s: tuple[float, float] | None
) -> FloatArray:
    """Variance of the field (T, S) while the structure stood, beyond what its points explain, shape (S,) [mm2]."""
    if still_interval_s is None:
        return np.zeros_like(still)
    rows = (time_s >= still_interval_s[0]) & (time_s <= still_interval_s[1]) & np.isfinite(field).all(axis=1)
    if not rows.any():
        return np.zeros_like(still)
    return np.asarray(np.maximum((field[rows] ** 2).mean(axis=0) - still, 0.0))


def _list_reasons(
    data: xr.Dataset, usable: BoolArray, fitted: list[FittedAxis], static: Collection[str], placed: BoolArray
) -> np.ndarray:
    """Why each point is left out, along all axes or one, shape (P,); empty where it is used along all."""
    status = data["status"].values
    reasons = []
    for number in range(data.sizes["point"]):
        departs = [
            str(axis)
            for axis, one, known in zip(data["axis"].values, fitted, usable[number], strict=True)
            if known and not one.used[number]
        ]
        lost = float((status[:, number] != Status.OK).mean())
        if data["point"].values[number] in static:
            reasons.append(NOT_OF_STRUCTURE)
        elif not placed[number]:
            reasons.append("not seen in two views")
        elif lost > 1 - _LEAST_SHARE:
            reasons.append(f"{100 * lost:.0f} % of its samples are missing")
        elif departs:
            reasons.append(f"departs from its neighbours: {', '.join(departs)}")
        elif not usable[number].all():
            reasons.append("not measured along every axis")
        else:
            reasons.append("")
    return np.array(reasons, dtype=object)
