"""Values of one point along one axis, each with its expanded uncertainty, and what drawings need of its series."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.outputs.results.summary import difference_variance, summarize_series
from vfm_sdm.signals.spectrum import amplitude_spectrum
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["COLUMNS", "Curve", "SeriesValues", "Stated", "describe_series", "level_length_s", "reduce_series"]

COLUMNS = 440
"""Columns of a drawing along time, and along frequency."""
_LEVEL_SHARE, _LONGEST_LEVEL_S = 0.2, 60.0
"""Share of a recording over which a level is taken at its beginning and end, and the most of it [s]."""
_BLOCKS = 4
"""Parts of such a stretch whose means say how well its own mean is known."""
_NEEDED = ("displacement", "displacement_std", "scale_std", "status", "uncertainty", "expanded_uncertainty")


@dataclass(frozen=True)
class Stated:
    """A value with its expanded uncertainty.

    Parameters
    ----------
    value
        The value [mm]; NaN where it is not known.
    expanded
        Expanded uncertainty (k = 2) [mm]; NaN where it is not known.
    at_s
        When it was reached, on the reference view's clock [s]; NaN of a value that belongs to no moment.
    """

    value: float
    expanded: float
    at_s: float = float("nan")


@dataclass(frozen=True, eq=False)
class Curve:
    """A series as a drawing shows it: the lowest and highest value in each column that holds a sample.

    Parameters
    ----------
    time_s
        Time of each column's first sample, shape (C,) [s].
    lowest, highest
        Limits of the values, shape (C,) [mm]; NaN in columns without a trusted sample.
    band_lowest, band_highest
        Limits of values and expanded uncertainty, shape (C,) [mm].
    """

    time_s: FloatArray
    lowest: FloatArray
    highest: FloatArray
    band_lowest: FloatArray
    band_highest: FloatArray


@dataclass(frozen=True, eq=False)
class SeriesValues:
    """What a report says of one point along one axis.

    Parameters
    ----------
    point, axis
        Names.
    summary
        Main values, as `vfm_sdm.outputs.results.summarize_displacement` has them.
    highest, lowest
        Extremes.
    rms
        Root mean square about the zero of the displacement.
    shift
        Mean over the end of the recording less the mean over its beginning.
    combined_mm
        Root mean square over time of the combined standard uncertainty of a sample (k = 1) [mm].
    curve
        The series as it is drawn.
    spectrum
        Frequencies, shape (F,) [Hz], and amplitudes, shape (F,) [mm], as they are drawn.
    """

    point: str
    axis: str
    summary: dict[str, Any]
    highest: Stated
    lowest: Stated
    rms: Stated
    shift: Stated
    combined_mm: float
    curve: Curve
    spectrum: tuple[FloatArray, FloatArray]


def describe_series(displacement: xr.Dataset, point: str, axis: str) -> SeriesValues:
    """Values of a point along an axis, of which alone the samples are read.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    point, axis
        Names.

    Notes
    -----
    Only samples with status ok count. The uncertainty of an extreme is that of its sample. Of the root mean square, the
    random part is independent from sample to sample, all other components are taken to err by the same standard
    deviation in all samples; what noise may have added, ``x - sqrt(x^2 - s^2)`` with its variance ``s^2``, is a
    component of its own, so that of motion within the noise nothing is claimed. The shift is the difference of two
    means: each has the mean standard deviation of each component, its random part that of the mean, or that which the
    means over quarters of the stretch show, whichever is larger; they are put together as
    `vfm_sdm.outputs.results.summary.difference_variance` does it. Without a budget the components are the random part
    and the scale.
    """
    names = [name for name in _NEEDED if name in displacement]
    series = displacement[names].sel(point=point, axis=axis).load()
    time_s, ok = series["time"].values, series["status"].values == Status.OK
    values = np.where(ok, series["displacement"].values, np.nan)
    parts = _list_parts(series)
    variance = np.sum([u**2 for u in parts.values()], axis=0)
    found = np.isfinite(values)
    nothing = Stated(np.nan, np.nan)
    highest = lowest = rms = nothing
    if found.any():
        extremes = (int(np.nanargmax(values)), int(np.nanargmin(values)))
        highest, lowest = (
            Stated(float(values[n]), COVERAGE_FACTOR * float(np.sqrt(variance[n])), float(time_s[n])) for n in extremes
        )
        rms = _state_rms(values[found], {name: u[found] for name, u in parts.items()})
    half_band = COVERAGE_FACTOR * np.sqrt(variance)
    return SeriesValues(
        point,
        axis,
        summarize_series(series, time_s, ok),
        highest,
        lowest,
        rms,
        _state_shift(time_s, values, parts),
        float(np.sqrt(np.mean(variance[found]))) if found.any() else float("nan"),
        reduce_series(time_s, values, half_band),
        amplitude_spectrum(time_s, values, most_lines=COLUMNS),
    )


def reduce_series(time_s: FloatArray, values: FloatArray, half_band: FloatArray, columns: int = COLUMNS) -> Curve:
    """A series with no more corners than a drawing shows.

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    values, half_band
        Values and half the width of the band around them, shape (T,) [mm]; values are NaN where there is none.
    columns
        Columns of the drawing.

    Examples
    --------
    >>> time_s = np.arange(9000) / 30
    >>> curve = reduce_series(time_s, np.sin(time_s), np.full(9000, 0.1), columns=100)
    >>> curve.time_s.size, bool(curve.highest.max() == np.sin(time_s).max())
    (100, True)
    """
    if not time_s.size:
        return Curve(*[np.zeros(0)] * 5)
    length = max(float(time_s[-1] - time_s[0]), np.finfo(float).tiny)
    column = np.minimum(((time_s - time_s[0]) / length * columns).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    # Where no uncertainty is known, the band is the line.
    margin = np.nan_to_num(half_band)
    # fmin and fmax pass over NaN.
    lowest, highest = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    below, above = np.fmin.reduceat(values - margin, starts), np.fmax.reduceat(values + margin, starts)
    return Curve(time_s[starts], lowest, highest, below, above)


def _list_parts(series: xr.Dataset) -> dict[str, FloatArray]:
    """Standard deviations of all samples by component, shape (T,) each [mm]."""
    if "uncertainty" in series:
        budget = series["uncertainty"].transpose("component", "time").values
        return dict(zip([str(name) for name in series["component"].values], budget, strict=True))
    scale = np.abs(float(series["scale_std"]) * series["displacement"].values)
    return {"random": series["displacement_std"].values, "cameras": scale}


def _state_rms(values: FloatArray, parts: Mapping[str, FloatArray]) -> Stated:
    """Root mean square of values (N,) with standard deviations by component (N,) [mm]."""
    count, rms = values.size, float(np.sqrt(np.mean(values**2)))
    if rms == 0:
        return Stated(0.0, float("nan"))
    share = np.abs(values) / (count * rms)
    variance = 0.0
    for name, u in parts.items():
        if name == "random":
            noise = min(float(np.mean(u**2)), rms**2) if np.isfinite(u).all() else np.nan
            variance += float(np.sum((share * u) ** 2)) + (rms - np.sqrt(rms**2 - noise)) ** 2
        else:
            variance += float(np.sum(share * u)) ** 2
    return Stated(rms, COVERAGE_FACTOR * float(np.sqrt(variance)))


def level_length_s(time_s: FloatArray) -> float:
    """Length of the stretches at beginning and end whose levels are compared [s].

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    """
    return min(_LEVEL_SHARE * float(time_s[-1] - time_s[0]), _LONGEST_LEVEL_S) if time_s.size else 0.0


def _state_shift(time_s: FloatArray, values: FloatArray, parts: Mapping[str, FloatArray]) -> Stated:
    """Mean over the end of a series less that over its beginning [mm]."""
    length_s = level_length_s(time_s)
    found = np.isfinite(values)
    stretches = [found & near for near in (time_s <= time_s[:1] + length_s, time_s >= time_s[-1:] - length_s)]
    if min(int(np.count_nonzero(one)) for one in stretches) < 2 * _BLOCKS:
        return Stated(float("nan"), float("nan"))
    before, after = (float(values[one].mean()) for one in stretches)
    stds = [_state_mean(values, parts, one) for one in stretches]
    return Stated(after - before, COVERAGE_FACTOR * float(np.sqrt(difference_variance(*stds))))


def _state_mean(values: FloatArray, parts: Mapping[str, FloatArray], chosen: BoolArray) -> dict[str, float]:
    """Standard deviation of the mean over a stretch, by component [mm]."""
    means = [float(part.mean()) for part in np.array_split(values[chosen], _BLOCKS)]
    scatter = float(np.std(means, ddof=1)) / np.sqrt(_BLOCKS)
    stds = {name: float(np.mean(u[chosen])) for name, u in parts.items()}
    random = parts["random"][chosen]
    return {**stds, "random": max(float(np.sqrt(np.sum(random**2))) / random.size, scatter)}
