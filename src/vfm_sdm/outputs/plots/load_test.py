"""A load test: levels in the history and deflection against load; vehicles that passed."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.outputs.plots.about import About
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION, plain_text, reduce_line

__all__ = ["draw_load_test", "draw_passages"]

_ROW_IN, _WIDTH_IN = 2.6, 13.0
_MOST = 6


def draw_load_test(displacement: xr.Dataset, result: xr.Dataset, axis: str, about: About) -> Figure:
    """Histories with the levels that were read, and deflection against load beside what was calculated.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test`.
    axis
        Axis that is shown.
    about
        What is said of the run.
    """
    names = _most(result["point"].values, np.abs(result["largest"].sel(axis=axis).values))
    figure, panels = _pairs(f"load test, {axis}: {about.line}", len(names))
    for (history, diagram), name in zip(panels, names, strict=False):
        one = result.sel(point=name, axis=axis)
        _draw_history(displacement.sel(point=name, axis=axis), one, history)
        _draw_diagram(one, diagram)
        history.set_title(plain_text(about.named(name)), loc="left", fontsize="small")
    if names:
        panels[0, 1].legend(fontsize="small", frameon=False)
    return figure


def _pairs(title: str, count: int) -> tuple[Figure, npt.NDArray[np.object_]]:
    """A figure with a history and a diagram in each of so many rows."""
    rows = max(count, 1)
    figure = Figure(figsize=(_WIDTH_IN, 1.3 + _ROW_IN * rows), layout="constrained")
    figure.suptitle(plain_text(title), ha="left", x=0.01, fontsize="medium")
    return figure, figure.subplots(rows, 2, squeeze=False, gridspec_kw={"width_ratios": [2.2, 1.0]})


def _most(names: npt.ArrayLike, sizes: FloatArray) -> Sequence[str]:
    """Names of the points with the largest sizes; those whose size is not known are left out."""
    order = np.argsort(-np.nan_to_num(sizes, nan=-1.0), kind="stable")
    return [str(np.asarray(names)[i]) for i in order if np.isfinite(sizes[i])][:_MOST]


def _draw_history(series: xr.Dataset, one: xr.Dataset, axes: Axes) -> None:
    time_s, values = series["time"].values, series["displacement"].values
    axes.plot(*reduce_line(time_s, values), color=GREY, linewidth=0.6)
    inside = (time_s >= float(one["begin_s"][0])) & (time_s <= float(one["end_s"][0]))
    rest = float(np.nanmean(values[inside])) if np.isfinite(values[inside]).any() else 0.0
    for begin, end, level in zip(
        one["begin_s"].values, one["end_s"].values, one["deflection"].values + rest, strict=True
    ):
        axes.axvspan(begin, end, color=BLUE, alpha=0.08, linewidth=0)
        axes.plot([begin, end], [level, level], color=VERMILION, linewidth=1.6)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("displacement [mm]")


def _draw_diagram(one: xr.Dataset, axes: Axes) -> None:
    load, calculated = one["load"].values, one["calculated"].values
    axes.errorbar(
        load, one["deflection"].values, yerr=one["expanded_uncertainty"].values,
        color=BLUE, marker="o", markersize=4, capsize=3, linewidth=0.8, label="measured, 95 %",
    )  # fmt: skip
    if np.isfinite(calculated).any():
        axes.plot(load, calculated, color=ORANGE, marker="x", linestyle="none", label="calculated")
    units = str(one["load"].attrs.get("units") or "")
    axes.set_xlabel(f"load [{units}]" if units else "load")
    axes.set_ylabel("deflection [mm]")


def draw_passages(displacement: xr.Dataset, crossed: xr.Dataset, axis: str, about: About) -> Figure:
    """Histories of the passages with their static part, and static displacement against the vehicle's place.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    crossed
        Of `vfm_sdm.analysis.load_test.judge_passages`.
    axis
        Axis that is shown.
    about
        What is said of the run.
    """
    largest = crossed["largest_static"].sel(axis=axis)
    names = _most(largest["point"].values, np.abs(largest.transpose("passage", ...).values).max(axis=0))
    figure, panels = _pairs(f"passages, {axis}, with their dynamic amplification: {about.line}", len(names))
    for (history, diagram), name in zip(panels, names, strict=False):
        one = crossed.sel(point=name, axis=axis)
        _draw_crossings(displacement.sel(point=name, axis=axis), one, history)
        _draw_static(one, diagram)
        history.set_title(plain_text(about.named(name)), loc="left", fontsize="small")
    for axes in panels[0] if names else ():
        axes.legend(fontsize="small", frameon=False)
    return figure


def _draw_crossings(series: xr.Dataset, one: xr.Dataset, axes: Axes) -> None:
    time_s, values = series["time"].values, series["displacement"].values
    axes.plot(*reduce_line(time_s, values), color=GREY, linewidth=0.6, label="displacement")
    for number in range(one.sizes["passage"]):
        crossing = one.isel(passage=number)
        begin, end = float(crossing["begin_s"]), float(crossing["end_s"])
        axes.axvspan(begin, end, color=BLUE, alpha=0.08, linewidth=0)
        inside = (time_s >= begin) & (time_s <= end)
        static = crossing["static"].values
        if not np.isfinite(values[inside]).any() or not np.isfinite(static).any():
            continue
        seconds = np.linspace(begin, end, len(static))
        # From the rest before the passage on: it goes through the middle of the displacement.
        rest = float(np.nanmedian(values[inside] - np.interp(time_s[inside], seconds, static)))
        axes.plot(seconds, static + rest, color=VERMILION, linewidth=1.4, label="static part" if number == 0 else None)
        amplification = float(crossing["amplification"])
        if np.isfinite(amplification):
            axes.annotate(
                f"{amplification:.2f}", (0.5 * (begin + end), 0.97), xycoords=("data", "axes fraction"),
                ha="center", va="top", fontsize="small",
            )  # fmt: skip
    axes.set_xlabel("time [s]")
    axes.set_ylabel("displacement [mm]")


def _draw_static(one: xr.Dataset, axes: Axes) -> None:
    line = "influence" if "influence" in one and np.isfinite(one["influence"]).any() else "static"
    for number in range(one.sizes["passage"]):
        crossing = one.isel(passage=number)
        place = crossing["along" if line == "influence" else "place"].values
        if not np.isfinite(place).any():
            place = np.linspace(0, 1, one.sizes["station"])
        values, std = crossing[line].values, crossing[f"{line}_std"].values
        colour = (BLUE, VERMILION, ORANGE, GREY)[number % 4]
        axes.fill_between(place, values - 2 * std, values + 2 * std, color=colour, alpha=0.2, linewidth=0)
        axes.plot(place, values, color=colour, linewidth=1.0, label=f"passage {int(crossing['passage'])}")
    known = np.isfinite(one["speed_m_s"]).all()
    label = "place of 1 kN [m]" if line == "influence" else "place of the first axle [m]"
    axes.set_xlabel(label if known else "share of the passage")
    axes.set_ylabel("influence [mm/kN]" if line == "influence" else "static displacement [mm]")
