"""How a structure answers a passing vehicle: amplification over the static part, and displacement against its place."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from vfm_sdm.analysis.load_test.influence import find_influence
from vfm_sdm.analysis.load_test.passages import Axle, Passage
from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import Status, check_displacement
from vfm_sdm.core.statuses import PassageStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.filters import low_pass
from vfm_sdm.signals.spectrum import dominant_frequency

__all__ = ["judge_passages"]

_DRAWS = 200
_CUTOFFS = (0.7, 0.84, 1.0, 1.2, 1.43)
"""Cutoffs that are tried, over the one that is stated: nobody knows where the static part ends."""
_STATIC_LINES = 1.5
"""Up to where the static part of a passage reaches, in inverse durations: the main lobe of a half sine."""
_TOTAL = 2.0
"""Up to where the structure answers, over its frequency: noise above that makes the largest of many values larger."""
_APART = 2.0
"""How far the structure's frequency must lie above that."""
_BEFORE_S = 5.0
"""Length of the rest before a passage at most [s]."""
_SHORTEST_REST_S = 1.0
_LONGEST_GAP = 0.2
"""Longest gap that is bridged, in periods of the cutoff."""
_STATIONS = 101
_COVERAGE = (0.025, 0.975)
_CLEAR = 5.0
"""Multiples of its standard deviation that a static deflection must have to be compared with."""
_LEAST_STATIC = 0.1
"""Share of the largest displacement that it must have: of less, what the filter leaves of a vibration is a part."""


_FIGURES = {
    **dict.fromkeys(("largest_total", "total_uncertainty", "largest_static", "static_uncertainty"), "mm"),
    **dict.fromkeys(("amplification", "amplification_low", "amplification_high"), "1"),
    "cutoff": "Hz",
}
"""Units of what is found, by passage, point and axis."""


@dataclass(frozen=True)
class _Series:
    """One point and axis around a passage at even times, shape (N,) [s], [mm], [mm]; gaps are bridged."""

    time_s: FloatArray
    values_mm: FloatArray
    std_mm: FloatArray
    longest_gap_s: float

    @property
    def rate_hz(self) -> float:
        return float((len(self.time_s) - 1) / (self.time_s[-1] - self.time_s[0]))


@dataclass(frozen=True)
class _Answer:
    """What is found of one passage, point and axis; and draws of the static part, shape (draws, stations) [mm]."""

    status: PassageStatus
    figures: Mapping[str, float] = field(default_factory=dict)
    static: FloatArray | None = None


def judge_passages(
    displacement: xr.Dataset,
    passages: Sequence[Passage],
    *,
    frequency_hz: float | None = None,
    axles: Sequence[Axle] = (),
    static: Collection[str] = (),
) -> xr.Dataset:
    """Dynamic amplification of every passage, and static displacement against the vehicle's place, with uncertainty.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    passages
        In their order.
    frequency_hz
        Natural frequency in which the structure answers a passage [Hz]; that of the strongest oscillation, which the
        displacement of each point shows along each axis, when ``None``, or else the lowest of the others.
    axles
        Of the vehicle; with them and the speed, influence lines of 1 kN are found.
    static
        Names of the points that must not move: what they show is not the structure's frequency.

    Returns
    -------
    result
        Dims ``passage``, ``point`` and ``axis``: ``status`` (`vfm_sdm.core.statuses.PassageStatus`); ``largest_total``
        and ``largest_static`` displacement from the rest before the passage on with their expanded uncertainty [mm];
        ``amplification``, the ratio of both, with an interval of 95 % [1]; ``cutoff`` [Hz].
        By point and axis ``frequency``, from which the cutoff is [Hz]; the attribute of that name says whether it was
        ``given`` or ``found``. By ``station``:
        ``place`` of the first axle [m] (passage, station), ``static`` and ``static_std`` [mm]; with axles ``along`` [m]
        and ``influence``, ``influence_std`` [mm/kN].

    Raises
    ------
    DatasetError
        A passage lies outside the recording, the frequency is not above 0, or there are axles and no passage
        whose speed is stated, or one whose way is shorter than the vehicle.

    Notes
    -----
    Amplification is the largest displacement, up to twice the structure's frequency, over the largest one of the
    static part, both to the same side. The static part is what a filter without phase shift leaves below the cutoff,
    which lies halfway, by ratio, between the static part of a crossing of that duration and the structure's frequency.
    Three things make it uncertain: noise, of which the largest of many values is too large (estimates are corrected by
    what draws of the noise show, the basic bootstrap [1]_); the cutoff, which is tried from 0.7 to 1.4 of that; and the
    passage itself, whose slow part is amplified, too: by ``1 / (1 - a^2)`` with ``a = 1 / (2 f T)`` for a beam of the
    frequency f that is crossed in T [2]_. That is taken out, and taken to be known within its own size. Scale and
    cameras err in both alike and do not count.

    References
    ----------
    .. [1] Davison, A. C. and Hinkley, D. V. (1997). Bootstrap methods and their application, section 5.2.
    .. [2] Frýba, L. (1999). Vibration of solids and structures under moving loads, section 1.3.
    """
    data = check_displacement(displacement)
    time_s = data["time"].values
    first, last = passages[0].begin_s, passages[-1].end_s
    if first < time_s[0] or last > time_s[-1]:
        raise DatasetError(
            f"passages: expected them within the recording, {time_s[0]:.1f} to {time_s[-1]:.1f} s, got {first:.1f} to "
            f"{last:.1f} s; correct begin_s and end_s"
        )
    _check_given(passages, frequency_hz, axles)
    answers: dict[tuple[int, int, int], _Answer] = {}
    trusted = data["displacement"].where(data["status"] == Status.OK).transpose("point", "axis", "time").values
    may_move = np.array([str(name) not in static for name in data["point"].values])
    frequencies = _find_frequencies(time_s, trusted, may_move, frequency_hz)
    for p, a in np.ndindex(*trusted.shape[:2]):
        one, series = data.isel(point=p, axis=a), trusted[p, a]
        of_structure = None if np.isnan(frequencies[p, a]) else float(frequencies[p, a])
        free_s = float(time_s[0])
        for number, passage in enumerate(passages):
            cutoff = _choose_cutoff(passage, of_structure)
            around = _cut(one, series, max(free_s, passage.begin_s - _BEFORE_S), passage.end_s + _BEFORE_S)
            rng = np.random.default_rng((p, a, number))
            answers[number, p, a] = (
                _Answer(cutoff)
                if isinstance(cutoff, PassageStatus)
                else _judge(around, passage, cutoff, of_structure or 0.0, rng)
            )
            free_s = passage.end_s
    result = _assemble(answers, data, passages, axles)
    return result.assign(frequency=(("point", "axis"), frequencies, {"units": "Hz"})).assign_attrs(
        frequency="found" if frequency_hz is None else "given",
        displacement_key=str(data.attrs.get("key", "")),
    )


def _find_frequencies(
    time_s: FloatArray, trusted: FloatArray, may_move: BoolArray, given_hz: float | None
) -> FloatArray:
    """Frequencies of the structure by point and axis, shape (P, A) [Hz]; NaN where there is none."""
    if given_hz is not None:
        return np.full(trusted.shape[:2], given_hz)
    shown = np.full(trusted.shape[:2], np.nan)
    # What a point shows that must not move is the camera's: it gets that of the structure.
    for p, a in np.ndindex(*shown.shape):
        if may_move[p]:
            shown[p, a] = dominant_frequency(time_s, trusted[p, a]) or np.nan
    # A point at rest in a mode does not show it; the others do.
    lowest = np.where(np.isnan(shown), np.inf, shown).min(axis=0, initial=np.inf)
    return np.where(np.isnan(shown), np.where(np.isfinite(lowest), lowest, np.nan), shown)


def _check_given(passages: Sequence[Passage], frequency_hz: float | None, axles: Sequence[Axle]) -> None:
    """Refuses what is stated of structure and vehicle and cannot be."""
    if frequency_hz is not None and not 0 < frequency_hz < np.inf:
        raise DatasetError(
            f"frequency: expected that of the structure, above 0 Hz, got {frequency_hz:g}; correct it, or leave it out "
            "to have it found"
        )
    if not axles:
        return
    ways = [way for one in passages if np.isfinite(way := one.speed_m_s * (one.end_s - one.begin_s))]
    if not ways:
        raise DatasetError(
            "axles: expected passages whose speed is stated, got none; add a column speed [km/h], or leave axles out"
        )
    if min(ways) <= axles[-1].behind_m:
        raise DatasetError(
            f"axles: expected a vehicle that is shorter than its way, {min(ways):.4g} m at that speed in that time, "
            f"got {axles[-1].behind_m:g} m; correct axles, speed or times"
        )


def _assemble(
    answers: Mapping[tuple[int, int, int], _Answer],
    data: xr.Dataset,
    passages: Sequence[Passage],
    axles: Sequence[Axle],
) -> xr.Dataset:
    """All answers as a dataset; the scale's uncertainty is added to what is in millimetres."""
    shape = (len(passages), data.sizes["point"], data.sizes["axis"])
    figures = {name: np.full(shape, np.nan) for name in _FIGURES}
    status = np.empty(shape, dtype="<U32")
    curves = {
        name: np.full((shape[0], _STATIONS, *shape[1:]), np.nan)
        for name in ("static", "static_std", "influence", "influence_std")
    }
    place, along = _stations(passages, axles)
    scale_std = data["scale_std"].transpose("point", "axis").values
    for at, answer in answers.items():
        number, p, a = at
        status[at] = str(answer.status)
        for name, value in answer.figures.items():
            figures[name][at] = value
        if answer.static is None:
            continue
        lines = {"static": answer.static}
        if axles and np.isfinite(along[number]).all():
            lines["influence"] = find_influence(answer.static, place[number], along[number], axles)
        for name, draws in lines.items():
            curves[name][number, :, p, a] = draws[0]
            curves[f"{name}_std"][number, :, p, a] = np.hypot(draws[1:].std(axis=0), scale_std[p, a] * draws[0])
    for part in ("total", "static"):
        grown = 2 * scale_std * figures[f"largest_{part}"]
        figures[f"{part}_uncertainty"] = np.hypot(figures[f"{part}_uncertainty"], grown)
    dims, by_station = ("passage", "point", "axis"), ("passage", "station", "point", "axis")
    times = (("begin_s", "s"), ("end_s", "s"), ("speed_m_s", "m/s"))
    result = xr.Dataset(
        {
            **{name: (dims, values, {"units": _FIGURES[name]}) for name, values in figures.items()},
            **{name: (by_station, curves[name], {"units": "mm"}) for name in ("static", "static_std")},
            **{name: ("passage", [getattr(one, name) for one in passages], {"units": unit}) for name, unit in times},
            "status": (dims, status),
            "place": (by_station[:2], place, {"units": "m"}),
        },
        coords={"passage": np.arange(1, shape[0] + 1), **{name: data[name] for name in dims[1:]}},
    )
    if not axles:
        return result
    return result.assign(
        {name: (by_station, curves[name], {"units": "mm/kN"}) for name in ("influence", "influence_std")}
        | {"along": (by_station[:2], along, {"units": "m"})}
    )


def _stations(passages: Sequence[Passage], axles: Sequence[Axle]) -> tuple[FloatArray, FloatArray]:
    """Places of the first axle, and places on the structure, shapes (passages, stations) [m]."""
    share = np.linspace(0, 1, _STATIONS)
    ways = np.array([passage.speed_m_s * (passage.end_s - passage.begin_s) for passage in passages])
    lengths = ways - (axles[-1].behind_m if axles else 0.0)
    return np.outer(ways, share), np.outer(np.where(lengths > 0, lengths, np.nan), share)


def _choose_cutoff(passage: Passage, frequency_hz: float | None) -> float | PassageStatus:
    """Where the static part of a passage ends [Hz], or why that is not known."""
    if frequency_hz is None:
        return PassageStatus.NO_FREQUENCY
    lowest = _STATIC_LINES / (passage.end_s - passage.begin_s)
    return float(np.sqrt(lowest * frequency_hz)) if frequency_hz >= _APART * lowest else PassageStatus.TOO_FAST


def _cut(one: xr.Dataset, series: FloatArray, begin_s: float, end_s: float) -> _Series | None:
    """The series in an interval at even times; ``None`` without samples there."""
    time_s = one["time"].values
    known = np.isfinite(series) & (time_s >= begin_s) & (time_s <= end_s)
    if known.sum() < 2:
        return None
    first, last = time_s[known][[0, -1]]
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    even = np.linspace(first, last, round(rate_hz * (last - first)) + 1)
    values, std = (np.interp(even, time_s[known], of[known]) for of in (series, one["displacement_std"].values))
    return _Series(even, values, std, float(np.diff(time_s[known]).max()))


def _judge(
    series: _Series | None,
    passage: Passage,
    cutoff_hz: float,
    frequency_hz: float,
    rng: np.random.Generator,
) -> _Answer:
    """Figures of one passage, point and axis."""
    if series is None or series.longest_gap_s > max(_LONGEST_GAP / cutoff_hz, 1.5 / series.rate_hz):
        return _Answer(PassageStatus.GAPS)
    time_s = series.time_s
    if time_s[0] > passage.begin_s - _SHORTEST_REST_S or time_s[-1] < passage.end_s:
        return _Answer(PassageStatus.GAPS)
    if max(_CUTOFFS) * cutoff_hz >= series.rate_hz / 2:
        return _Answer(PassageStatus.TOO_FAST)
    total, static = _draw_parts(series, passage, cutoff_hz, frequency_hz, rng)
    side = np.sign(static[np.abs(static[:, 0]).argmax(), 0])
    tops = side * np.stack([(side * part).max(axis=0) for part in (total, static)])
    spread = tops[:, 1:] - tops[:, 1:].mean(axis=1, keepdims=True)
    std = spread.std(axis=1)
    # The largest of noisy values is too large, by as much as more noise makes it larger still.
    best = 2 * tops[:, 0] - tops[:, 1:].mean(axis=1)
    figures = {
        "largest_total": best[0],
        "total_uncertainty": 2 * std[0],
        "largest_static": best[1],
        "static_uncertainty": 2 * std[1],
        "cutoff": cutoff_hz,
    }
    inside = time_s[(time_s >= passage.begin_s) & (time_s <= passage.end_s)]
    stations = np.linspace(passage.begin_s, passage.end_s, _STATIONS)
    curves = np.array([np.interp(stations, inside, draw) for draw in static.T])
    if not abs(best[1]) > max(_CLEAR * std[1], _LEAST_STATIC * abs(best[0])):
        return _Answer(PassageStatus.IN_NOISE, figures, curves)
    slow = (1 / (2 * frequency_hz * (passage.end_s - passage.begin_s))) ** 2
    ratios = (best[0] - spread[0]) / (best[1] - spread[1]) / (1 - slow * rng.uniform(0, 2, spread.shape[1]))
    figures["amplification"] = best[0] / best[1] / (1 - slow)
    figures["amplification_low"], figures["amplification_high"] = np.quantile(ratios, _COVERAGE)
    return _Answer(PassageStatus.OK, figures, curves)


def _draw_parts(
    series: _Series, passage: Passage, cutoff_hz: float, frequency_hz: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draws of displacement and of its static part in a passage from the rest before, shape (N, draws) [mm].

    The first is the estimate.
    """
    count = len(_CUTOFFS) * _DRAWS + 1
    noise = rng.standard_normal((len(series.time_s), count)) * series.std_mm[:, None]
    noise[:, 0] = 0.0
    drawn = series.values_mm[:, None] + noise
    # Filtered, the largest value is little above the true one; what little is left shows in the draws.
    total_hz = _TOTAL * frequency_hz
    high = low_pass(drawn, series.rate_hz, total_hz) if total_hz < 0.4 * series.rate_hz else drawn
    low = np.empty_like(drawn)
    low[:, :1] = low_pass(drawn[:, :1], series.rate_hz, cutoff_hz)
    for number, factor in enumerate(_CUTOFFS):
        of_factor = slice(1 + number * _DRAWS, 1 + (number + 1) * _DRAWS)
        low[:, of_factor] = low_pass(drawn[:, of_factor], series.rate_hz, factor * cutoff_hz)
    rest = low[series.time_s < passage.begin_s].mean(axis=0)
    inside = (series.time_s >= passage.begin_s) & (series.time_s <= passage.end_s)
    return high[inside] - rest, low[inside] - rest
