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

from vfm_sdm.core.arrays import as_float_array
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
    make_axes,
    mark_status,
    plain_text,
    reduce_band,
    reduce_line,
)

__all__ = ["plot_displacement", "plot_points", "plot_trajectory"]

_DISPLAY_PX = 1920
"""Longest image side that is drawn; a print shows no more."""
_MOST_LABELS = 40
_HALO = (effects.withStroke(linewidth=2.5, foreground="black"),)


def plot_trajectory(tracks: xr.Dataset, ax: Axes | None = None, *, point: str | None = None) -> Axes:
    """Movement of one point in the image against time, relative to its first sample with status ok [px].

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px].
    ax
        Axes to draw into; a new figure when None.
    point
        Name of the point; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no tracks, or no such point.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> position = np.sin(np.arange(90) / 5)[:, None, None] * [1.0, 2.0]
    >>> covariance = np.tile(0.01 * np.eye(2), (90, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(90) / 30, ["mid"], position, covariance, np.zeros((90, 1)), attrs={})
    >>> plot_trajectory(tracks).get_ylabel()
    'movement [px]'
    """
    of_point = check_tracks(tracks).sel(point=choose_name(tracks, "point", point))
    axes = make_axes(ax)
    time_s, status = of_point["time"].values, of_point["status"].values
    position = of_point["position"].values
    good = np.flatnonzero(status == Status.OK)
    moved = position - (position[good[0]] if good.size else np.full(2, np.nan))
    for values, name, colour in zip(moved.T, ("u (right)", "v (down)"), (BLUE, VERMILION), strict=True):
        axes.plot(*reduce_line(time_s, values), color=colour, linewidth=1.0, label=name)
    mark_status(axes, time_s, moved, status)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("movement [px]")
    axes.set_title(plain_text(str(of_point["point"].values)), loc="left")
    return finish_axes(axes, time_s)


def plot_displacement(
    displacement: xr.Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None
) -> Axes:
    """Displacement of one point along one axis against time [mm], with a band of two standard deviations.

    The band is the random part; the systematic part stands in the title, as a percentage of the displacement (k = 2).

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    ax
        Axes to draw into; a new figure when None.
    point, axis
        Names of the point and the axis; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no displacement, or no such point or axis.

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
    >>> plot_displacement(displacement, axis="vertical").get_title(loc="left")
    'mid, vertical'
    """
    check_displacement(displacement)
    names = {"point": choose_name(displacement, "point", point), "axis": choose_name(displacement, "axis", axis)}
    series = displacement.sel(names)
    axes = make_axes(ax)
    time_s, status = series["time"].values, series["status"].values
    values, half_band = series["displacement"].values, 2 * series["displacement_std"].values
    label = "± 2 std (random)"
    if "expanded_uncertainty" in series:
        half_band, label = series["expanded_uncertainty"].values, "expanded uncertainty (k = 2)"
    colour = AXIS_COLOURS[list_names(displacement, "axis").index(names["axis"]) % len(AXIS_COLOURS)]
    band = reduce_band(time_s, values - half_band, values + half_band)
    axes.fill_between(*band, color=colour, alpha=0.25, linewidth=0, label=label)
    axes.plot(*reduce_line(time_s, values), color=colour, linewidth=1.0)
    mark_status(axes, time_s, values[:, None], status)
    scale_std = float(series["scale_std"])
    scale = f"scale ± {200 * scale_std:.2g} % (k = 2)" if np.isfinite(scale_std) else "scale uncertainty not known"
    axes.set_title(plain_text(f"{names['point']}, {names['axis']}"), loc="left")
    axes.set_title(scale, loc="right", fontsize="small", color=GREY)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{names['axis']} [mm]")
    return finish_axes(axes, time_s)


def plot_points(luma: npt.NDArray[Any], points2d: npt.ArrayLike, names: Sequence[str], ax: Axes | None = None) -> Axes:
    """An image with named points drawn in; the axes are full-image pixels.

    Parameters
    ----------
    luma
        Brightness, shape (H, W), or colour, shape (H, W, 3); large images are drawn smaller.
    points2d
        Positions in full-image pixels, shape (P, 2) [px]; points that are NaN are listed below the image.
    names
        Point names, length P.
    ax
        Axes to draw into; a new figure when None.

    Raises
    ------
    DatasetError
        The array is not an image, or points and names differ in number.

    Examples
    --------
    >>> axes = plot_points(np.zeros((48, 64), np.uint8), [[10.0, 20.0], [np.nan, np.nan]], ["mid", "quarter"])
    >>> axes.get_xlabel().splitlines()
    ['u [px]', 'not found here: quarter']
    """
    image = np.asarray(luma)
    if image.ndim not in (2, 3) or image.size == 0 or (image.ndim == 3 and image.shape[2] != 3):
        raise DatasetError(f"luma: expected shape (H, W) or (H, W, 3), got {image.shape}; pass one frame")
    points = as_float_array(points2d, "points2d", (len(names), 2))
    axes = make_axes(ax)
    height, width = image.shape[:2]
    small, factor = _shrink(image)
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
    axes.plot(*points.T, "o", markersize=11, markerfacecolor="none", markeredgecolor=ORANGE, path_effects=_HALO)
    axes.plot(*points.T, "+", markersize=7, markeredgecolor=ORANGE, path_effects=_HALO)
    for (u, v), name in zip(points, names, strict=True):
        if len(names) <= _MOST_LABELS and np.isfinite([u, v]).all():
            left = u > 0.8 * width
            axes.annotate(
                plain_text(name),
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
    axes.set_xlabel(f"u [px]{plain_text(note)}")
    axes.set_ylabel("v [px]")
    return axes


def _shrink(image: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], int]:
    """The image averaged over square blocks so that it is no larger than a display, and the blocks' side [px]."""
    factor = int(np.ceil(max(image.shape[:2]) / _DISPLAY_PX))
    factor = min(factor, *image.shape[:2])
    if factor <= 1:
        return image, 1
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, -1)
    mean = blocks.mean(axis=(1, 3)).reshape(rows, columns, *image.shape[2:])
    return mean.astype(np.uint8) if image.ndim == 3 else mean, factor
