"""A load test: levels in the history, and deflection against load."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.outputs.plots.about import About
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION, plain_text, reduce_line

__all__ = ["draw_load_test"]

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
    names = _chosen(result, axis)
    figure = Figure(figsize=(_WIDTH_IN, 1.3 + _ROW_IN * max(len(names), 1)), layout="constrained")
    figure.suptitle(plain_text(f"load test, {axis}: {about.line}"), ha="left", x=0.01, fontsize="medium")
    panels = figure.subplots(max(len(names), 1), 2, squeeze=False, gridspec_kw={"width_ratios": [2.2, 1.0]})
    for (history, diagram), name in zip(panels, names, strict=False):
        one = result.sel(point=name, axis=axis)
        _draw_history(displacement.sel(point=name, axis=axis), one, history)
        _draw_diagram(one, diagram)
        history.set_title(plain_text(about.named(name)), loc="left", fontsize="small")
    panels[0, 1].legend(fontsize="small", frameon=False)
    return figure


def _chosen(result: xr.Dataset, axis: str) -> Sequence[str]:
    """Names of the points that deflected most."""
    largest = np.abs(result["largest"].sel(axis=axis).values)
    order = np.argsort(-np.nan_to_num(largest, nan=-1.0), kind="stable")
    return [str(result["point"].values[i]) for i in order if np.isfinite(largest[i])][:_MOST]


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
