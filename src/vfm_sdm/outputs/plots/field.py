"""A field: the deflection line with its band, the whole history, and how large the motion is over the first frame."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.analysis.field import NOT_OF_STRUCTURE
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.constants import NORMAL_95
from vfm_sdm.outputs.plots.about import About, positive_direction
from vfm_sdm.outputs.plots.drawing import BLUE, GREEN, GREY, ORANGE, VERMILION, plain_text, reduce_band

__all__ = ["draw_field", "draw_heat_map"]

_COLOURS = (VERMILION, BLUE, GREEN, ORANGE)
_WIDTH_IN = 13.0


def draw_field(
    field: xr.Dataset, displacement: xr.Dataset, axis: str, times_s: Sequence[float], about: About
) -> Figure:
    """Deflection lines with their 95 % bands beside the points, the history of all stations, and bending shapes.

    Parameters
    ----------
    field
        Field dataset, shape (T, S, 3) [mm].
    displacement
        What it was computed from, shape (T, P, 3) [mm].
    axis
        Axis that is shown.
    times_s
        Times of the lines [s].
    about
        What is said of the run.
    """
    figure = Figure(figsize=(_WIDTH_IN, 8.4), layout="constrained")
    figure.suptitle(plain_text(f"field, {axis}: {about.line}"), ha="left", x=0.01, fontsize="medium")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.25, 1.0))
    _draw_lines(field, displacement, axis, times_s, figure.add_subplot(grid[0, :]))
    _draw_history(field.sel(axis=axis), figure.add_subplot(grid[1, 0]), figure)
    _draw_shapes(field.sel(axis=axis), figure.add_subplot(grid[1, 1]))
    return figure


def _draw_lines(field: xr.Dataset, displacement: xr.Dataset, axis: str, times_s: Sequence[float], axes: Axes) -> None:
    """Lines at some times, each with its band and with the points that it rests on."""
    station, used = field["station"].values, field["used"].sel(axis=axis).values.astype(bool)
    along = field["point_place"].sel(axis="longitudinal").values[used]
    for time_s, colour in zip(times_s, _COLOURS, strict=False):
        frame = field.sel(axis=axis).sel(time=time_s, method="nearest")
        line, half = frame["displacement"].values, NORMAL_95 * frame["displacement_std"].values
        points = displacement["displacement"].sel(axis=axis).sel(time=time_s, method="nearest").values
        axes.plot(
            along,
            points[used],
            ".",
            color=colour,
            alpha=0.35,
            markersize=4,
        )
        axes.fill_between(station, line - half, line + half, color=colour, alpha=0.25, linewidth=0)
        axes.plot(station, line, color=colour, linewidth=1.6, label=f"{float(frame['time']):.2f} s, band: 95 %")
    axes.axhline(0, color=GREY, linewidth=0.6)
    axes.set_xlim(station[0], station[-1])
    axes.set_xlabel("along the structure [m]")
    where = positive_direction("structure", axis)
    axes.set_ylabel(f"{axis} [mm]" + f"\npositive: {where}" * bool(where))
    if axis == "vertical":
        axes.invert_yaxis()
    axes.legend(fontsize="small", frameon=False)
    axes.set_title(f"deflection line of {used.sum()} points", loc="left", fontsize="small")
    axes.spines[["top", "right"]].set_visible(False)


def _draw_history(one: xr.Dataset, axes: Axes, figure: Figure) -> None:
    """Displacement over time and station in colours."""
    values = one["displacement"].values
    time_s, station = one["time"].values, one["station"].values
    columns = [reduce_band(time_s, line, line) for line in values.T]
    # Of frames that share a column of the picture, the larger motion is shown.
    shown = np.array([np.where(np.abs(low) > np.abs(high), low, high) for _, low, high in columns])
    most = float(np.nanmax(np.abs(values))) or 1.0
    picture = axes.imshow(
        shown,
        extent=(time_s[0], time_s[-1], station[0], station[-1]),
        aspect="auto", origin="lower", cmap="RdBu_r", vmin=-most, vmax=most,
    )  # fmt: skip
    figure.colorbar(picture, ax=axes, label="mm")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("along the structure [m]")
    axes.set_title("all times", loc="left", fontsize="small")


def _draw_shapes(one: xr.Dataset, axes: Axes) -> None:
    """Operational shapes, of largest value 1."""
    station = one["station"].values
    for number, colour in zip(range(one.sizes["shape_number"]), _COLOURS, strict=False):
        shape, frequency = one["shape"].values[number], float(one["shape_frequency"].values[number])
        if np.isfinite(shape).all():
            axes.plot(station, shape, color=colour, label=f"{frequency:.2f} Hz")
    axes.axhline(0, color=GREY, linewidth=0.6)
    axes.set_xlabel("along the structure [m]")
    axes.set_ylabel("shape, largest value 1")
    axes.set_title("shapes in which it moved", loc="left", fontsize="small")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="small", frameon=False)
    axes.spines[["top", "right"]].set_visible(False)


def draw_heat_map(field: xr.Dataset, picture: npt.NDArray[Any], places: FloatArray, axis: str, about: About) -> Figure:
    """Peak-to-peak displacement of the points, drawn over the first frame of a view; points left out are crosses.

    Parameters
    ----------
    field
        Field dataset, shape (T, S, 3) [mm].
    picture
        First frame of the view, shape (H, W) or (H, W, 3).
    places
        Pixels of the field's points in it, shape (P, 2) [px].
    axis
        Axis that is shown.
    about
        What is said of the run.
    """
    height, width = picture.shape[:2]
    figure = Figure(figsize=(_WIDTH_IN, 0.6 + 0.88 * _WIDTH_IN * height / width), layout="constrained")
    figure.suptitle(
        plain_text(f"peak-to-peak of the field, {axis} [mm]: {about.line}"), ha="left", x=0.01, fontsize="medium"
    )
    axes = figure.add_subplot()
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255 if picture.dtype == np.uint8 else None)
    span = np.ptp(field["displacement"].sel(axis=axis).values, axis=0)
    used = field["used"].sel(axis=axis).values.astype(bool)
    of_points = np.interp(field["point_place"].sel(axis="longitudinal").values, field["station"].values, span)
    shown = axes.scatter(
        places[used, 0],
        places[used, 1],
        c=of_points[used],
        s=36,
        cmap="viridis",
        edgecolors="white",
        linewidths=0.4,
        vmin=0.0,
    )
    left_out = ~used & (field["reason"].values != NOT_OF_STRUCTURE)
    axes.plot(*places[left_out].T, "x", color=VERMILION, markersize=5, label=f"left out ({left_out.sum()})")
    figure.colorbar(shown, ax=axes, label="mm", shrink=0.7)
    if left_out.any():
        axes.legend(loc="lower right", fontsize="small")
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_axis_off()
    return figure
