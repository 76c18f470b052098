"""Signals in time: image movement, displacement, how both change with SGR, and how they agree with a reference."""

from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.analysis.evaluation.metrics import correlation, gain
from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import Status, check_displacement, check_tracks
from vfm_sdm.errors import DatasetError
from vfm_sdm.outputs.plots.drawing import (
    AXIS_COLOURS,
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    choose_name,
    finish_axes,
    list_names,
    mark_status,
    plain_text,
    reduce_band,
    reduce_line,
)
from vfm_sdm.outputs.plots.panels import plot_trajectory
from vfm_sdm.outputs.plots.protocol.layout import LINE_WIDTH, add_legend, make_figure, make_panels, panel_order

__all__ = ["plot_comparison", "plot_displacement3d", "plot_parity", "plot_refinement", "plot_trajectories"]

_SERIES_STYLES = {"reference": (ORANGE, 1.4), "truth": ("black", 0.6), "vision": (BLUE, LINE_WIDTH)}
"""Colour and line width, in the order of drawing."""
_DOWNWARD = ("vertical", "down")


def plot_trajectories(tracks: xr.Dataset, *, point: str | None = None) -> Figure:
    """Movement of one point in the images against time [px], one panel for each view (the paper's trajectories).

    Parameters
    ----------
    tracks
        Synchronised tracks with a dim ``view``, shape (V, T, P, 2) [px].
    point
        Name of the point; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no synchronised tracks, or no such point.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> position = np.sin(np.arange(90) / 5)[:, None, None] * [1.0, 2.0]
    >>> covariance = np.tile(0.01 * np.eye(2), (90, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(90) / 30, ["mid"], position, covariance, np.zeros((90, 1)), attrs={})
    >>> both = tracks.expand_dims(view=["left", "right"]).transpose("view", ...)
    >>> [axes.get_title(loc="left") for axes in plot_trajectories(both).axes]
    ['mid, view left', 'mid, view right']
    """
    check_tracks(tracks, synchronized=True)
    name = choose_name(tracks, "point", point)
    figure, panels = make_panels(len(list_names(tracks, "view")), height_in=2.1, sharey=True)
    for panel, view in zip(panels, list_names(tracks, "view"), strict=True):
        plot_trajectory(tracks.sel(view=view), panel, point=name)
        panel.label_outer()
        panel.set_title(plain_text(f"{name}, view {view}"), loc="left", fontsize="medium")
    return add_legend(figure, panels)


def plot_refinement(
    before: xr.Dataset, after: xr.Dataset, ax: Axes | None = None, *, view: str, point: str | None = None
) -> Axes:
    """Horizontal movement of one point in the corrected view before and after SGR [px].

    Both are relative to the first sample with status ok before SGR. The vertical movement is not corrected.

    Parameters
    ----------
    before, after
        Synchronised tracks with a dim ``view``, shape (V, T, P, 2) [px].
    ax
        Axes to draw into; a new figure when None.
    view
        Name of the corrected view.
    point
        Name of the point; may be left out where there is only one.

    Raises
    ------
    DatasetError
        A dataset holds no synchronised tracks, or no such view or point.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> position = np.sin(np.arange(90) / 5)[:, None, None] * [1.0, 2.0]
    >>> covariance = np.tile(0.01 * np.eye(2), (90, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(90) / 30, ["mid"], position, covariance, np.zeros((90, 1)), attrs={})
    >>> both = tracks.expand_dims(view=["left", "right"]).transpose("view", ...)
    >>> plot_refinement(both, both, view="right").get_title(loc="left")
    'mid, view right'
    """
    axes = make_figure(2.9).add_subplot() if ax is None else ax
    first, second = (_select_horizontal(tracks, view, point) for tracks in (before, after))
    time_s, status = first["time"].values, first["status"].values
    good = np.flatnonzero(status == Status.OK)
    origin = first["position"].values[good[0]] if good.size else np.nan
    moved = first["position"].values - origin
    axes.plot(*reduce_line(time_s, moved), color=ORANGE, linewidth=LINE_WIDTH, label="before refinement")
    refined = second["position"].values - origin
    axes.plot(*reduce_line(second["time"].values, refined), color=BLUE, linewidth=LINE_WIDTH, label="after refinement")
    mark_status(axes, time_s, moved[:, None], status)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("u (right) [px]")
    axes.set_title(plain_text(f"{first['point'].values}, view {view}"), loc="left", fontsize="medium", pad=20)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, frameon=False, fontsize="small", borderpad=0)
    return finish_axes(axes, time_s)


def plot_displacement3d(before: xr.Dataset, after: xr.Dataset, *, point: str | None = None) -> Figure:
    """Displacement of one point along all axes against time [mm], (a) before and (b) after SGR.

    Parameters
    ----------
    before, after
        Displacement datasets, shape (T, P, 3) [mm].
    point
        Name of the point; may be left out where there is only one.

    Raises
    ------
    DatasetError
        A dataset holds no displacement, or no such point.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> displacement = make_displacement(
    ...     np.arange(90) / 30,
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=np.sin(np.arange(90) / 5)[:, None, None] * [1.0, 2.0, 0.1],
    ...         displacement_std_mm=np.full((90, 1, 3), 0.1),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((90, 1, 3)),
    ...         reprojection_error_px=np.zeros((90, 1)),
    ...         status=np.zeros((90, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> [axes.get_title(loc="left") for axes in plot_displacement3d(displacement, displacement).axes]
    ['(a) mid, before refinement', '(b) mid, after refinement']
    """
    figure, panels = make_panels(2, height_in=2.4, sharey=True)
    for panel, letter, displacement, when in zip(panels, "ab", (before, after), ("before", "after"), strict=True):
        check_displacement(displacement)
        name = choose_name(displacement, "point", point)
        series = displacement.sel(point=name)
        time_s, values = series["time"].values, series["displacement"].values
        for index, axis in enumerate(list_names(displacement, "axis")):
            colour = AXIS_COLOURS[index % len(AXIS_COLOURS)]
            label = f"{axis} (positive down)" if axis in _DOWNWARD else axis
            # The noisiest axis comes last and lies below the others.
            below = 2 - 0.1 * index
            panel.plot(
                *reduce_line(time_s, values[:, index]), color=colour, linewidth=LINE_WIDTH, label=label, zorder=below
            )
        mark_status(panel, time_s, values, series["status"].values)
        panel.set_title(plain_text(f"({letter}) {name}, {when} refinement"), loc="left", fontsize="medium")
        panel.set_ylabel("displacement [mm]")
        finish_axes(panel, time_s)
    panels[-1].set_xlabel("time [s]")
    return add_legend(figure, panels)


def plot_comparison(
    time_s: npt.ArrayLike, series: Mapping[str, Mapping[str, npt.ArrayLike]], *, title: str = ""
) -> Figure:
    """Displacement by vision against a reference in time [mm], one panel for each axis, vertical above lateral.

    Parameters
    ----------
    time_s
        Common clock, shape (T,) [s].
    series
        Series of each axis on that clock, shape (T,) [mm]: ``vision`` and, where known, ``reference`` (of a sensor),
        ``truth``, and ``vision_std``, drawn as a band of two standard deviations. NaN where not known.
    title
        Title, which stands above the first panel.

    Raises
    ------
    DatasetError
        There is no axis, one has no vision, or a series has another name or length.

    Examples
    --------
    >>> truth = np.sin(np.arange(90) / 5)
    >>> figure = plot_comparison(np.arange(90) / 30, {"vertical": {"vision": 1.02 * truth, "truth": truth}})
    >>> figure.axes[0].get_ylabel().splitlines()
    ['vertical [mm]', 'positive down']
    """
    time = as_float_array(time_s, "time_s", (None,))
    arrays = _check_series(series, len(time))
    figure, panels = make_panels(len(arrays), height_in=2.2)
    for panel, (axis, named) in zip(panels, arrays.items(), strict=True):
        if "vision_std" in named:
            vision, half_band = named["vision"], 2 * named["vision_std"]
            band = reduce_band(time, vision - half_band, vision + half_band)
            panel.fill_between(*band, color=BLUE, alpha=0.2, linewidth=0, label="vision ± 2 std")
        for name, (colour, width) in _SERIES_STYLES.items():
            if name in named:
                panel.plot(*reduce_line(time, named[name]), color=colour, linewidth=width, label=name)
        panel.set_ylabel(f"{axis} [mm]\n" + ("positive down" if axis in _DOWNWARD else ""))
        finish_axes(panel, time)
    panels[0].set_title(plain_text(title), loc="left", fontsize="medium")
    panels[-1].set_xlabel("time [s]")
    return add_legend(figure, panels)


def plot_parity(
    series: Mapping[str, Mapping[str, npt.ArrayLike]], *, against: str = "reference", title: str = ""
) -> Figure:
    """Displacement by vision over a reference [mm], one panel for each axis, with correlation R.

    Parameters
    ----------
    series
        Series of each axis, shape (T,) [mm]: ``vision`` and what it is compared with, as for `plot_comparison`.
    against
        Name of the series that it is compared with: ``reference`` or ``truth``.
    title
        Title, which stands above the panels.

    Raises
    ------
    DatasetError
        A series is not as in `plot_comparison`; or an axis lacks the series to compare with, or that series does not
        move or is known together with vision in too few samples.

    Notes
    -----
    Correlation and regression are those of `vfm_sdm.analysis.evaluation.metrics`; offsets are left as they are.

    Examples
    --------
    >>> truth = np.sin(np.arange(90) / 5)
    >>> figure = plot_parity({"vertical": {"vision": 1.02 * truth, "truth": truth}}, against="truth")
    >>> figure.axes[0].get_title()
    'vertical: R = 1.000, slope 1.02'
    """
    arrays = _check_series(series, None, needed=("vision", against))
    figure = make_figure(4.0)
    panels = figure.subplots(1, len(arrays), squeeze=False)[0].tolist()
    for panel, (axis, named) in zip(panels, arrays.items(), strict=True):
        vision, reference = named["vision"], named[against]
        known = np.isfinite(vision) & np.isfinite(reference)
        slope, _ = gain(vision, reference)
        x, y = reference[known], vision[known]
        ends = np.array([x.min(), x.max()])
        low, high = min(x.min(), y.min()), max(x.max(), y.max())
        margin = 0.05 * (high - low)
        limits = (low - margin, high + margin)
        panel.plot(x, y, ".", color=BLUE, markersize=4, markeredgewidth=0, alpha=0.5, label="samples")
        panel.plot(limits, limits, color=GREY, linewidth=LINE_WIDTH, linestyle="--", label="1:1")
        fit = y.mean() + slope * (ends - x.mean())
        panel.plot(ends, fit, color=VERMILION, linewidth=1.2, label="regression")
        panel.set_title(f"{axis}: R = {correlation(vision, reference):.3f}, slope {slope:.2f}", fontsize="medium")
        panel.set_xlabel(f"{against}, {axis} [mm]")
        panel.set_ylabel(f"vision, {axis} [mm]")
        finish_axes(panel, np.empty(0))
        panel.set(xlim=limits, ylim=limits, aspect="equal")
        panel.locator_params(nbins=6)
    return add_legend(figure, panels, title)


def _select_horizontal(tracks: xr.Dataset, view: str, point: str | None) -> xr.Dataset:
    """Horizontal pixel coordinate and status of one point in one view."""
    check_tracks(tracks, synchronized=True)
    chosen = {"view": choose_name(tracks, "view", view), "point": choose_name(tracks, "point", point)}
    return tracks[["position", "status"]].sel(chosen | {"pixel": "u"})


def _check_series(
    series: Mapping[str, Mapping[str, npt.ArrayLike]], length: int | None, *, needed: Collection[str] = ("vision",)
) -> dict[str, dict[str, FloatArray]]:
    """The series as arrays of one length an axis, in the order of the panels."""
    known = ("vision", "vision_std", "reference", "truth")
    if not series:
        raise DatasetError("series: expected at least one axis, got none; pass vision by axis")
    arrays: dict[str, dict[str, FloatArray]] = {}
    for axis in sorted(series, key=panel_order):
        names = set(series[axis])
        if not names.issuperset(needed) or not names.issubset(known):
            raise DatasetError(
                f"series of {axis!r}: expected {list(needed)}, and no others than {list(known)}, "
                f"got {sorted(names)}; rename them"
            )
        size = np.size(series[axis]["vision"]) if length is None else length
        arrays[axis] = {name: as_float_array(values, name, (size,)) for name, values in series[axis].items()}
    return arrays
