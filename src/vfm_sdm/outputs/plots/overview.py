"""One picture of the displacement of many points along one axis, in place of one picture a point."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import check_displacement, trusted_values
from vfm_sdm.outputs.plots.about import About, positive_direction
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, list_names, plain_text

__all__ = ["MOST_FIGURES", "draw_overview"]

MOST_FIGURES = 20
"""Points with a figure of their own; of more, there are overviews."""
_WIDTH_IN, _ROW_IN = 13.0, 0.16
_MOST_NAMES = 80
_COLUMNS = 1500
_DPI = 150


def draw_overview(displacement: xr.Dataset, axis: str, about: About) -> Figure:
    """Displacement of all points along an axis: as colours over time, and peak-to-peak with what is uncertain of it.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    axis
        Name of the axis.
    about
        What is said of the run.

    Raises
    ------
    DatasetError
        The dataset holds no displacement.
    """
    check_displacement(displacement)
    names, frame = list_names(displacement, "point"), str(displacement.attrs.get("frame") or "")
    number = list_names(displacement, "axis").index(axis)
    values, time_s = trusted_values(displacement, "displacement")[..., number], displacement["time"].values
    height_in = 2.2 + float(np.clip(_ROW_IN * len(names), 3.0, 14.0))
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI)
    layout = {"left": 0.13, "right": 0.98, "bottom": 0.75 / height_in, "top": 1 - 1.4 / height_in, "wspace": 0.06}
    colours, bars = figure.subplots(1, 2, sharey=True, gridspec_kw={**layout, "width_ratios": [3.2, 1]})
    rows, edges = np.arange(len(names)), _edges(time_s)
    shown, share = _reduce(values)
    largest = float(np.nanmax(np.abs(shown))) if np.isfinite(shown).any() else 1.0
    image = colours.imshow(
        shown.T,
        aspect="auto",
        cmap="RdBu_r" if share == 1 else "viridis",
        vmin=-largest if share == 1 else 0,
        vmax=largest,
        extent=(edges[0], edges[1], len(names) - 0.5, -0.5),
        interpolation="nearest",
    )
    colours.set_facecolor("#cccccc")  # where there is no value
    colours.set_xlabel("time [s]")
    # In a place of its own, so that rows and bars stay side by side.
    place = colours.get_position()
    bar = figure.add_axes((place.x0, place.y1 + 0.1 / height_in, place.width, 0.14 / height_in))
    within = "" if share == 1 else f", peak-to-peak within {share * (edges[1] - edges[0]) / time_s.size:.2g} s"
    figure.colorbar(image, cax=bar, orientation="horizontal", label=f"{axis} [mm]{within}")
    bar.xaxis.set_label_position("top")
    bar.xaxis.tick_top()
    known = np.isfinite(values).any(axis=0)
    span = np.full(len(names), np.nan)
    span[known] = np.nanmax(values[:, known], axis=0) - np.nanmin(values[:, known], axis=0)
    scale = displacement["scale_std"].transpose("point", "axis").values[:, number]
    still = [name in about.static for name in names]
    bars.barh(rows, span, xerr=2 * np.nan_to_num(scale * span), color=[BLUE if one else ORANGE for one in still],
              error_kw={"linewidth": 0.7})  # fmt: skip
    bars.set_xlabel(
        "peak-to-peak [mm], ± scale (k = 2)\nblue: static" if any(still) else "peak-to-peak [mm], ± scale (k = 2)"
    )
    bars.grid(axis="x", linewidth=0.4, color="#cccccc")
    bars.set_axisbelow(True)
    bars.tick_params(labelleft=False)
    step = int(np.ceil(len(names) / _MOST_NAMES))
    colours.set_yticks(rows[::step], [plain_text(about.named(name)) for name in names[::step]], fontsize=6.5)
    positive = positive_direction(frame, axis)
    title = f"{axis} displacement of {len(names)} points" + (f"; positive: {positive}" if positive else "")
    figure.text(0.01, 1 - 0.1 / height_in, plain_text(title), ha="left", va="top", fontsize="large")
    figure.text(0.99, 1 - 0.12 / height_in, plain_text(about.line), ha="right", va="top",
                fontsize="small", color=GREY)  # fmt: skip
    return figure


def _edges(time_s: FloatArray) -> tuple[float, float]:
    half = 0.5 * float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.5
    return float(time_s[0]) - half, float(time_s[-1]) + half


def _reduce(values: FloatArray) -> tuple[FloatArray, int]:
    """The values (T, P); where several frames share a column of the picture, their peak-to-peak; and how many do."""
    share = -(-len(values) // _COLUMNS)
    if share == 1:
        return values, share
    starts = np.arange(0, len(values), share)
    lowest, highest = np.fmin.reduceat(values, starts, axis=0), np.fmax.reduceat(values, starts, axis=0)
    return np.asarray(highest - lowest), share
