"""Frames of a recording with points, their subsets and a grid of pixels drawn in."""

from collections.abc import Sequence
from typing import Any

import matplotlib.patheffects as effects
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MultipleLocator

from vfm_sdm.core.arrays import as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.outputs.plots.drawing import BLUE, ORANGE, make_axes, plain_text

__all__ = ["draw_frame", "plot_points", "plot_subsets"]

_DISPLAY_PX = 1920
"""Longest image side that is drawn; a print shows no more."""
_MOST_LABELS = 40
_HALO = (effects.withStroke(linewidth=2.5, foreground="black"),)
_WIDTH_IN = 13.0
_MARGINS_IN = (0.75, 0.5, 0.75, 0.75)
"""Left of the picture, right of it, below and above."""
_LEAST_TICKS = 12
"""Labelled lines across the longer side of a frame, at the least."""
_STEPS_PX = (500, 250, 100, 50, 25, 10, 5, 1, 0.1)
"""Distances between them [px]."""


def plot_points(
    luma: npt.NDArray[Any],
    points2d: npt.ArrayLike,
    names: Sequence[str],
    ax: Axes | None = None,
    *,
    whole: bool = False,
    static: Sequence[bool] = (),
) -> Axes:
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
    whole
        Whether every pixel is drawn, however large the image is.
    static
        Whether each point must not move, length P; those are blue. None when left out.

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
    small, factor = (image, 1) if whole else _shrink(image)
    axes.imshow(
        small,
        cmap="gray",
        vmin=float(small.min()) if image.ndim == 2 and image.dtype != np.uint8 else 0,
        vmax=float(small.max()) if image.ndim == 2 and image.dtype != np.uint8 else 255,
        # The pixels drawn cover whole blocks of the image, whose first begins half a pixel before its centre.
        extent=(-0.5, small.shape[1] * factor - 0.5, small.shape[0] * factor - 0.5, -0.5),
        interpolation="nearest" if whole else "antialiased",
    )
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    still = np.array(static or [False] * len(names), np.bool_)
    for some, colour in ((points[~still], ORANGE), (points[still], BLUE)):
        axes.plot(*some.T, "o", markersize=11, markerfacecolor="none", markeredgecolor=colour, path_effects=_HALO)
        axes.plot(*some.T, "+", markersize=7, markeredgecolor=colour, path_effects=_HALO)
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


def plot_subsets(
    axes: Axes, points2d: npt.ArrayLike, sides_px: Sequence[int], static: Sequence[bool] | None = None
) -> Axes:
    """The squares that are compared around points, at their true size; those of static points in blue.

    Parameters
    ----------
    axes
        Axes with the picture, in full-image pixels.
    points2d
        Positions, shape (P, 2) [px]; NaN where there is none.
    sides_px
        Sides of the squares, length P [px]; 0 where none is known.
    static
        Whether each point must not move, length P; none when None.

    Examples
    --------
    >>> axes = plot_points(np.zeros((48, 64), np.uint8), [[10.0, 20.0]], ["mid"])
    >>> [float(value) for value in plot_subsets(axes, [[10.0, 20.0]], [15]).patches[0].get_bbox().bounds]
    [2.5, 12.5, 15.0, 15.0]
    """
    points = as_float_array(points2d, "points2d", (len(sides_px), 2))
    for (u, v), side, still in zip(points, sides_px, static or [False] * len(sides_px), strict=True):
        if np.isfinite(u + v) and side:
            corner, colour = (u - side / 2, v - side / 2), BLUE if still else ORANGE
            axes.add_patch(
                Rectangle(corner, side, side, fill=False, edgecolor=colour, linewidth=1.4, path_effects=_HALO)
            )
    return axes


def draw_frame(
    luma: npt.NDArray[Any],
    points2d: npt.ArrayLike,
    names: Sequence[str],
    *,
    title: str,
    sides_px: Sequence[int] = (),
    static: Sequence[bool] = (),
) -> Figure:
    """A frame in all its pixels under a labelled grid, from which pixel coordinates can be read.

    Parameters
    ----------
    luma
        Brightness, shape (H, W), or colour, shape (H, W, 3).
    points2d
        Positions of named points, shape (P, 2) [px]; NaN where there is none.
    names
        Their names, length P.
    title
        What stands above.
    sides_px, static
        Sides of their subsets [px] and whether they must not move, length P; nothing is drawn when left out.

    Raises
    ------
    DatasetError
        The array is not an image, or points and names differ in number.

    Notes
    -----
    Saved with the figure's own resolution, every pixel of the frame is one or several whole ones of the picture.

    Examples
    --------
    >>> figure = draw_frame(np.zeros((480, 640), np.uint8), [[10.0, 20.0]], ["mid"], title="left", sides_px=[41])
    >>> float(np.diff(figure.axes[0].get_xticks())[0])
    50.0
    """
    height, width = np.shape(luma)[:2]
    left, right, below, above = _MARGINS_IN
    picture_in = min(_WIDTH_IN, _WIDTH_IN * width / height)
    size = (left + picture_in + right, below + picture_in * height / width + above)
    times = max(1, round(_DISPLAY_PX / max(width, height)))
    figure = Figure(figsize=size, dpi=times * width / picture_in)
    axes = figure.add_axes((left / size[0], below / size[1], picture_in / size[0], 1 - (below + above) / size[1]))
    plot_points(luma, points2d, names, axes, whole=True, static=static)
    if sides_px:
        plot_subsets(axes, points2d, sides_px, static or None)
    _draw_grid(axes, max(width, height))
    axes.set_title(plain_text(title), loc="left")
    return figure


def _draw_grid(axes: Axes, longest_px: int) -> None:
    """Labelled lines on all four sides, with marks between them, at round numbers of pixels."""
    step = next(one for one in _STEPS_PX if longest_px / one >= _LEAST_TICKS)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))
        axis.set_minor_locator(MultipleLocator(step / 5))
    axes.tick_params(which="both", direction="out", top=True, right=True, labeltop=True, labelright=True, labelsize=7)
    axes.grid(which="major", color="white", linewidth=0.35, alpha=0.55)
    axes.grid(which="minor", color="white", linewidth=0.35, alpha=0.18)


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
