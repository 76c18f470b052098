"""``summary.json``: what a reader wants to know first, with null where nothing can be said."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.fft import next_fast_len, rfft
from scipy.signal import detrend

from vfm_sdm.arrays import BoolArray, FloatArray, IntArray, as_float_array
from vfm_sdm.datasets import STATUS_MEANINGS, Status, check_displacement
from vfm_sdm.errors import DatasetError, ResultsError
from vfm_sdm.files import replace_file
from vfm_sdm.uncertainty import COVERAGE_FACTOR

__all__ = ["dominant_frequency", "read_summary", "summarize_displacement", "write_json", "write_summary"]

_PROPORTIONAL = ("cameras", "compression")
"""Components of the budget that are proportional to the motion."""
_SHORTEST_S = 2.0
_FEWEST_CYCLES = 4.0
"""With fewer, the window blurs a line over all its neighbours and nothing is left to tell it from noise."""
_FEWEST_VALID = 0.8
"""Share of frames that must be there; over more gaps, interpolation would colour the spectrum."""
_FALSE_PEAK = 1e-5
"""Nominal probability that noise alone gives a peak; as the noise level is estimated from few lines, the true one is
below 1 in 300 for white noise and about 1 in 100 for a random walk (found by simulation)."""
_ZERO_PADDING = 4


def write_summary(folder: Path | str, summary: Mapping[str, Any]) -> Path:
    """Writes ``summary.json``; numbers that are not finite become null.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    summary
        Tables and lists of text, numbers, truth values, NumPy scalars and arrays, paths and ``None``.

    Raises
    ------
    ResultsError
        The file cannot be written, or a value is of another type.
    """
    return write_json(Path(folder) / "summary.json", summary, label="summary")


def write_json(path: Path, content: Mapping[str, Any], *, label: str) -> Path:
    """Writes a table as JSON, whole or not at all, with null for numbers that are not finite; returns the path.

    Parameters
    ----------
    path
        The file to make or replace.
    content
        See `write_summary`.
    label
        What messages call the table.

    Raises
    ------
    ResultsError
        The file cannot be written, or a value is of another type.
    """
    text = json.dumps(_jsonable(content, label), indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with replace_file(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{path}: expected to write it, got: {error}; choose another folder") from error
    return path


def read_summary(path: Path | str) -> dict[str, Any]:
    """The summary of a run folder, or in the file itself.

    Raises
    ------
    ResultsError
        The file is missing or damaged.
    """
    source = Path(path) / "summary.json" if Path(path).is_dir() else Path(path)
    try:
        found = json.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ResultsError(f"{source}: expected a summary, got no such file; run `vfm-sdm measure`") from error
    except (OSError, ValueError) as error:
        raise ResultsError(f"{source}: expected a summary, got: {error}; run `vfm-sdm measure` again") from error
    if not isinstance(found, dict):
        raise ResultsError(f"{source}: expected a table, got {type(found).__name__}; run `vfm-sdm measure` again")
    return found


def _jsonable(value: Any, label: str) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _jsonable(inner, f"{label}.{key}") for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(inner, f"{label}[{index}]") for index, inner in enumerate(value)]
    if isinstance(value, np.ndarray | np.generic):
        return _jsonable(value.tolist(), label)
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Path):
        return value.as_posix()
    raise ResultsError(f"{label}: expected text, numbers, lists or tables, got {type(value).__name__}; convert it")


def summarize_displacement(displacement: xr.Dataset) -> dict[str, Any]:
    """Figures of each point and axis, ready for `write_summary`.

    Parameters
    ----------
    displacement
        See `vfm_sdm.datasets`.

    Returns
    -------
    summary
        By point name: ``coverage_valid`` (share of frames with status ok [1]), ``status_counts`` (frames by status)
        and ``axes``, by axis name: ``peak_to_peak_mm``, ``rms_mm`` (about the zero of the displacement),
        ``random_std_mm`` (median), ``scale_std`` [1], ``expanded_uncertainty_mm`` (of the peak-to-peak, k = 2),
        ``budget_mm`` (root mean square over time of each component of the uncertainty of a sample, k = 1) and
        ``dominant_frequency_hz``. Only frames with status ok count; None where these do not tell.

    Notes
    -----
    The peak-to-peak is ``x_a - x_b`` with the extremes at frames a and b. Components of the uncertainty that are
    proportional to the motion add up over the two, the others are taken as independent. Where a dataset holds no
    budget, ``U = 2 sqrt(s_a^2 + s_b^2 + (s_scale (x_a - x_b))^2)`` from its random part and scale. The tendency of
    extremes of noise to lie apart is not in it: of motion within the noise, the peak-to-peak shows the noise.
    """
    data = check_displacement(displacement)
    time_s = data["time"].values
    summary: dict[str, Any] = {}
    for point in data["point"].values:
        of_point = data.sel(point=point)
        status = of_point["status"].values
        ok = status == Status.OK
        summary[str(point)] = {
            "coverage_valid": float(ok.mean()) if ok.size else None,
            "status_counts": {name: int((status == code).sum()) for code, name in enumerate(STATUS_MEANINGS)},
            "axes": {str(axis): _axis_figures(of_point.sel(axis=axis), time_s, ok) for axis in data["axis"].values},
        }
    return summary


def _axis_figures(series: xr.Dataset, time_s: FloatArray, ok: BoolArray) -> dict[str, Any]:
    values = np.where(ok, series["displacement"].values, np.nan)
    std = series["displacement_std"].values
    scale_std = float(series["scale_std"])
    found = np.isfinite(values)
    figures: dict[str, Any] = {
        "peak_to_peak_mm": None,
        "rms_mm": None,
        "random_std_mm": None,
        "scale_std": _or_none(scale_std),
        "expanded_uncertainty_mm": None,
        "budget_mm": None,
        "dominant_frequency_hz": None,
    }
    if not found.any():
        return figures
    top, bottom = int(np.nanargmax(values)), int(np.nanargmin(values))
    span = float(values[top] - values[bottom])
    known_std = std[found & np.isfinite(std)]
    figures["peak_to_peak_mm"] = span
    figures["rms_mm"] = float(np.sqrt(np.mean(values[found] ** 2)))
    figures["random_std_mm"] = float(np.median(known_std)) if known_std.size else None
    variance = std[top] ** 2 + std[bottom] ** 2 + (scale_std * span) ** 2
    if "uncertainty" in series:
        budget = {str(name): series["uncertainty"].sel(component=name).values for name in series["component"].values}
        figures["budget_mm"] = {name: _or_none(float(np.sqrt(np.mean(u[found] ** 2)))) for name, u in budget.items()}
        # What grows with the motion has opposite signs at the extremes, and errs alike.
        variance = sum(
            (u[top] + u[bottom]) ** 2 if name in _PROPORTIONAL else u[top] ** 2 + u[bottom] ** 2
            for name, u in budget.items()
        )
    figures["expanded_uncertainty_mm"] = _or_none(COVERAGE_FACTOR * float(np.sqrt(variance)))
    figures["dominant_frequency_hz"] = dominant_frequency(time_s, values)
    return figures


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def dominant_frequency(time_s: npt.ArrayLike, values: npt.ArrayLike) -> float | None:
    """Frequency of the strongest oscillation of a series [Hz], or None where there is no clear one.

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s].
    values
        The series, any unit, shape (T,); NaN where there is no value.

    Returns
    -------
    frequency_hz
        None when the values span less than 2 s, fewer than 80 % of the frames have one, or no peak of at least four
        cycles in the record stands clear of the noise around it.

    Raises
    ------
    DatasetError
        The lengths differ or the time stamps do not increase.

    Notes
    -----
    Linear interpolation to evenly spaced times, linear trend removed, Hann window, periodogram padded four times, and
    a parabola through the logarithm of the highest peak and its neighbours. In noise of ``M`` lines the highest
    exceeds the mean by more than ``ln(M / p)`` with probability ``p``. The mean is taken around each line, over two
    octaves, so that slow drift hides no vibration and is not taken for one; and from the median, which an oscillation
    does not raise.
    """
    clock, series = as_float_array(time_s, "time_s", (None,)), as_float_array(values, "values", (None,))
    if clock.shape != series.shape or np.any(np.diff(clock) <= 0):
        raise DatasetError(
            f"dominant frequency: expected increasing time stamps, one a value, got {clock.size} stamps for "
            f"{series.size} values; sort or cut them"
        )
    found = np.flatnonzero(np.isfinite(series))
    if found.size < 2 or clock[found[-1]] - clock[found[0]] < _SHORTEST_S:
        return None
    count = int(found[-1] - found[0]) + 1
    if found.size < _FEWEST_VALID * count:
        return None
    # The mean, because containers round stamps: at 60 frames a second the median of rounded intervals is 17 ms.
    grid: FloatArray = np.linspace(clock[found[0]], clock[found[-1]], count)
    interval = float(grid[1] - grid[0])
    even: FloatArray = np.interp(grid, clock[found], series[found])
    padded = next_fast_len(_ZERO_PADDING * count, real=True)
    power = np.abs(rfft(detrend(even) * np.hanning(count), padded)) ** 2
    lowest = int(np.ceil(_FEWEST_CYCLES * padded / count))
    lines = np.arange(lowest, power.size - 1)
    # Rounding errors are no noise: a constant series has no peak.
    rounding = (np.finfo(float).eps * np.abs(even).max() * count) ** 2
    clear = power[lines] > np.log(count / 2 / _FALSE_PEAK) * _background(power, lines) + rounding
    clear &= (power[lines] >= power[lines - 1]) & (power[lines] >= power[lines + 1])
    if not clear.any():
        return None
    highest = int(lines[clear][np.argmax(power[lines[clear]])])
    left, middle, right = np.log(np.maximum(power[highest - 1 : highest + 2], np.finfo(float).tiny))
    curvature = left - 2 * middle + right
    offset = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
    return float((highest + offset) / (padded * interval))


def _background(power: FloatArray, lines: IntArray) -> FloatArray:
    """Mean power of the noise around each line, from the median of the lines from half to twice its frequency."""
    if lines.size == 0:
        return np.zeros(0)
    octaves = np.log2(lines[-1] / lines[0])
    centres = lines[0] * 2 ** np.linspace(0, octaves, int(8 * octaves) + 2)
    medians = [np.median(power[int(centre / 2) : int(2 * centre) + 1]) for centre in centres]
    # The power of noise is exponentially distributed, with its median at ln 2 of the mean.
    return np.asarray(np.interp(lines, centres, np.array(medians)) / np.log(2))
