"""Figures: trajectories in pixels, displacement in millimetres, and first frames with the points drawn in.

Each ``plot_`` function draws into the axes given, or into a figure of its own, and returns the axes. Figures are made
without pyplot, so that nothing global changes and no window system is needed.
"""

from collections.abc import Sequence
from typing import Any

import matplotlib.patheffects as effects
import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import STATUS_MEANINGS, Status, check_displacement, check_tracks
from vfm_sdm.errors import DatasetError

__all__ = ["plot_displacement", "plot_points", "plot_trajectory"]

# The palette of Okabe and Ito, which stays distinguishable with colour-blindness and in grey.
_BLUE, _VERMILION, _GREEN, _ORANGE, _PURPLE = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7"
_GREY = "#555555"
_AXIS_COLOURS = (_BLUE, _VERMILION, _GREEN)
_DPI = 150
_DISPLAY_PX = 1920
"""Longest image side that is drawn; a print shows no more."""
_MOST_LABELS = 40
_COLUMNS = 2000
"""Columns of a picture that can show something of their own along time."""
_HALO = (effects.withStroke(linewidth=2.5, foreground="black"),)


def plot_trajectory(tracks: xr.Dataset, ax: Axes | None = None, *, point: str | None = None) -> Axes:
    """Movement of one point in the image against time, relative to its first sample with status ok [px].

    Parameters
    ----------
    tracks
        Tracks of one view (see `vfm_sdm.core.datasets`).
    ax
        Where to draw; a new figure when None.
    point
        Name of the point; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no tracks, or no such point.
    """
    of_point = check_tracks(tracks).sel(point=_chosen(tracks, "point", point))
    axes = _axes_or_new(ax)
    time_s, status = of_point["time"].values, of_point["status"].values
    position = of_point["position"].values
    good = np.flatnonzero(status == Status.OK)
    moved = position - (position[good[0]] if good.size else np.full(2, np.nan))
    for values, name, colour in zip(moved.T, ("u (right)", "v (down)"), (_BLUE, _VERMILION), strict=True):
        axes.plot(*_line(time_s, values), color=colour, linewidth=1.0, label=name)
    _mark_status(axes, time_s, moved, status)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("movement [px]")
    axes.set_title(str(of_point["point"].values), loc="left")
    return _finish(axes, time_s)


def plot_displacement(
    displacement: xr.Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None
) -> Axes:
    """Displacement of one point along one axis against time [mm], with a band of two standard deviations.

    The band is the random part; the systematic part stands in the title, as a percentage of the displacement (k = 2).

    Parameters
    ----------
    displacement
        See `vfm_sdm.core.datasets`.
    ax
        Where to draw; a new figure when None.
    point, axis
        Names; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no displacement, or no such point or axis.
    """
    check_displacement(displacement)
    names = {"point": _chosen(displacement, "point", point), "axis": _chosen(displacement, "axis", axis)}
    series = displacement.sel(names)
    axes = _axes_or_new(ax)
    time_s, status = series["time"].values, series["status"].values
    values, half_band = series["displacement"].values, 2 * series["displacement_std"].values
    label = "± 2 std (random)"
    if "expanded_uncertainty" in series:
        half_band, label = series["expanded_uncertainty"].values, "expanded uncertainty (k = 2)"
    colour = _AXIS_COLOURS[_names(displacement, "axis").index(names["axis"]) % len(_AXIS_COLOURS)]
    band = _envelope(time_s, values - half_band, values + half_band)
    axes.fill_between(*band, color=colour, alpha=0.25, linewidth=0, label=label)
    axes.plot(*_line(time_s, values), color=colour, linewidth=1.0)
    _mark_status(axes, time_s, values[:, None], status)
    scale_std = float(series["scale_std"])
    scale = f"scale ± {200 * scale_std:.2g} % (k = 2)" if np.isfinite(scale_std) else "scale uncertainty not known"
    axes.set_title(f"{names['point']}, {names['axis']}", loc="left")
    axes.set_title(scale, loc="right", fontsize="small", color=_GREY)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{names['axis']} [mm]")
    return _finish(axes, time_s)


def plot_points(luma: npt.NDArray[Any], points2d: npt.ArrayLike, names: Sequence[str], ax: Axes | None = None) -> Axes:
    """An image with named points drawn in; the axes are full-image pixels.

    Parameters
    ----------
    luma
        Brightness, shape (H, W), or colour, shape (H, W, 3); large images are drawn smaller.
    points2d
        Positions, shape (P, 2) [px], full-image pixels; points that are NaN are listed below the image.
    names
        Point names, length P.
    ax
        Where to draw; a new figure when None.

    Raises
    ------
    DatasetError
        The image is no image, or points and names differ in number.
    """
    image = np.asarray(luma)
    if image.ndim not in (2, 3) or image.size == 0 or (image.ndim == 3 and image.shape[2] != 3):
        raise DatasetError(f"luma: expected shape (H, W) or (H, W, 3), got {image.shape}; pass one frame")
    points = as_float_array(points2d, "points2d", (len(names), 2))
    axes = _axes_or_new(ax)
    height, width = image.shape[:2]
    small, factor = _smaller(image)
    axes.imshow(
        small,
        cmap="gray",
        vmin=float(small.min()) if image.ndim == 2 and image.dtype != np.uint8 else 0,
        vmax=float(small.max()) if image.ndim == 2 and image.dtype != np.uint8 else 255,
        # The pixels drawn cover whole blocks of the image, whose first begins half a pixel before its centre.
        extent=(-0.5, small.shape[1] * factor - 0.5, small.shape[0] * factor - 0.5, -0.5),
        interpolation="antialiased",
    )
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.plot(*points.T, "o", markersize=11, markerfacecolor="none", markeredgecolor=_ORANGE, path_effects=_HALO)
    axes.plot(*points.T, "+", markersize=7, markeredgecolor=_ORANGE, path_effects=_HALO)
    for (u, v), name in zip(points, names, strict=True):
        if len(names) <= _MOST_LABELS and np.isfinite([u, v]).all():
            left = u > 0.8 * width
            axes.annotate(
                name,
                (u, v),
                xytext=(-9 if left else 9, 6),
                textcoords="offset points",
                ha="right" if left else "left",
                color="white",
                fontsize=9,
                path_effects=_HALO,
            )
    missing = [name for name, (u, v) in zip(names, points, strict=True) if not np.isfinite([u, v]).all()]
    note = f"\nnot found here: {', '.join(missing)}" if missing else ""
    axes.set_xlabel(f"u [px]{note}")
    axes.set_ylabel("v [px]")
    return axes


def _mark_status(axes: Axes, time_s: FloatArray, values: FloatArray, status: npt.NDArray[Any]) -> None:
    """Circles around unreliable values; ticks at the lower edge where there is none."""
    unreliable = _marked(status == Status.UNRELIABLE)
    if unreliable.size:
        label = STATUS_MEANINGS[Status.UNRELIABLE]
        for column in values.T:
            axes.plot(
                time_s[unreliable], column[unreliable], "o", markersize=3.5, markerfacecolor="none",
                markeredgecolor=_GREY, markeredgewidth=0.7, label=label,
            )  # fmt: skip
            label = "_"
    for code, colour in ((Status.LOST, "black"), (Status.OUTSIDE, _ORANGE), (Status.BEHIND, _PURPLE)):
        missing = _marked(status == code)
        if missing.size:
            axes.plot(
                time_s[missing], np.full(missing.size, 0.02), "|", markersize=7, color=colour,
                transform=axes.get_xaxis_transform(), label=STATUS_MEANINGS[code].replace("_", " "),
            )  # fmt: skip


def _envelope(time_s: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same band with few corners: of frames that share a column of the picture, the lowest and the highest value.

    A long recording has hundreds of frames in each column; drawing them all takes minutes and looks the same.
    """
    share = time_s.size // _COLUMNS
    if share < 4:
        return time_s, lower, upper
    starts = np.arange(0, time_s.size, share)
    # fmin and fmax pass over NaN: a gap shorter than a column shows in the status marks.
    return time_s[starts], np.fmin.reduceat(lower, starts), np.fmax.reduceat(upper, starts)


def _line(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same line with few corners, up and down in each column of the picture."""
    times, lowest, highest = _envelope(time_s, values, values)
    if times.size == time_s.size:
        return time_s, values
    return np.repeat(times, 2), np.column_stack([lowest, highest]).ravel()


def _marked(flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Indices of the flagged frames, at most one in each column of the picture."""
    found = np.flatnonzero(flags)
    share = max(flags.size // _COLUMNS, 1)
    return found[np.unique(found // share, return_index=True)[1]]


def _finish(axes: Axes, time_s: FloatArray) -> Axes:
    axes.grid(visible=True, linewidth=0.4, color="#cccccc")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if time_s.size > 1:
        axes.set_xlim(time_s[0], time_s[-1])
    return axes


def _smaller(image: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], int]:
    """The image averaged over square blocks so that it is no larger than a display, and the blocks' side [px]."""
    factor = int(np.ceil(max(image.shape[:2]) / _DISPLAY_PX))
    factor = min(factor, *image.shape[:2])
    if factor <= 1:
        return image, 1
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, -1)
    mean = blocks.mean(axis=(1, 3)).reshape(rows, columns, *image.shape[2:])
    return mean.astype(np.uint8) if image.ndim == 3 else mean, factor


def _chosen(dataset: xr.Dataset, dim: str, name: str | None) -> str:
    names = _names(dataset, dim)
    if name is None and len(names) == 1:
        return names[0]
    if name not in names:
        raise DatasetError(f"{dim}: expected one of {names}, got {name!r}; name one of these")
    return name


def _names(dataset: xr.Dataset, dim: str) -> list[str]:
    return [str(name) for name in dataset[dim].values]


def _axes_or_new(ax: Axes | None, size: tuple[float, float] = (10, 3.5)) -> Axes:
    if ax is not None:
        return ax
    return Figure(figsize=size, dpi=_DPI, layout="constrained").add_subplot()
