"""What a pan clip showed: its places over a picture, and what the lens that was found leaves of them."""

from io import BytesIO
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION
from vfm_sdm.stages.lens.adjustment import AdjustedClip

__all__ = ["draw_lens", "plot_lens"]

_DPI, _WIDTH_IN = 150, 10.0
_TRACKS = 80
_CELLS, _RINGS = 16, 12
_LEAST = 5
"""Sightings of a cell or ring of which something is shown."""
_ARROW = 0.06
"""Length of the longest mean residual, over the width of the picture."""


def draw_lens(adjusted: AdjustedClip, luma: npt.NDArray[Any]) -> bytes:
    """The figure as PNG.

    Parameters
    ----------
    adjusted
        The adjustment.
    luma
        A picture of the clip, shape (H, W).
    """
    buffer = BytesIO()
    plot_lens(adjusted, luma).savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def plot_lens(adjusted: AdjustedClip, luma: npt.NDArray[Any]) -> Figure:
    """Tracks over a picture; number of sightings and mean residuals over the picture; residuals over the radius.

    Parameters
    ----------
    adjusted
        The adjustment.
    luma
        A picture of the clip, shape (H, W).

    Notes
    -----
    Arrows that all point outwards or inwards at some radius, or residuals across the radius, are what the lens model
    leaves out; empty cells are parts of the picture of which the clip tells nothing.
    """
    height, width = luma.shape
    rows = _WIDTH_IN * height / width
    figure = Figure(figsize=(_WIDTH_IN, 1.72 * rows + 3.4), layout="constrained")
    above, middle, below = figure.subplots(3, 1, height_ratios=(rows, rows, 2.4))
    _draw_tracks(adjusted, luma, above)
    _draw_cells(adjusted, (width, height), middle)
    for axes in (above, middle):
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
        axes.set_aspect("equal")
    _draw_rings(adjusted, below)
    return figure


def _draw_tracks(adjusted: AdjustedClip, luma: npt.NDArray[Any], axes: Axes) -> None:
    seen = adjusted.clip.seen
    axes.imshow(luma, cmap="gray", interpolation="nearest")
    count = np.bincount(seen.point)
    shown = np.argsort(-count, kind="stable")[:_TRACKS]
    for point in shown.tolist():
        path = seen.pixel[seen.point == point]
        axes.plot(*path.T, "-", color=ORANGE, linewidth=0.5, alpha=0.7)
    axes.plot(*seen.pixel.T, ".", color=BLUE, markersize=1.5)
    apart = adjusted.weights < 0.5
    axes.plot(*seen.pixel[apart].T, "x", color=VERMILION, markersize=4, linewidth=0.6)
    title = f"{len(count)} places in {seen.frames} frames over the first picture, paths of {len(shown)} of them"
    axes.set_title(f"{title}; crosses: {int(apart.sum())} sightings that do not agree", loc="left", fontsize=9)


def _draw_cells(adjusted: AdjustedClip, size: tuple[int, int], axes: Axes) -> None:
    """Number of sightings in each cell, and arrows along their mean residuals."""
    pixel, weights = adjusted.clip.seen.pixel, adjusted.weights
    side = size[0] / _CELLS
    edges = [np.arange(-0.5, extent + side - 0.5, side) for extent in size]
    u, v = pixel.T
    count = np.histogram2d(u, v, bins=edges)[0]
    weight = np.histogram2d(u, v, bins=edges, weights=weights)[0]
    sums = [np.histogram2d(u, v, bins=edges, weights=weights * part)[0] for part in adjusted.residuals.T]
    known = count >= _LEAST
    mean = [np.where(known, part / np.maximum(weight, 1e-9), np.nan) for part in sums]
    shown = axes.pcolormesh(*edges, np.where(count > 0, count, np.nan).T, cmap="Blues", vmin=0, alpha=0.7)
    longest = float(np.nanmax(np.hypot(*mean))) if known.any() else 1.0
    centres = np.meshgrid(*[(edge[:-1] + edge[1:]) / 2 for edge in edges], indexing="ij")
    scale = max(longest, 1e-9) / (_ARROW * size[0])
    axes.quiver(*centres, *mean, color=VERMILION, angles="xy", scale_units="xy", scale=scale, width=0.002)
    axes.figure.colorbar(shown, ax=axes, label="sightings in a cell", shrink=0.8)
    axes.set_title(
        f"coverage, and mean residuals of cells: the longest arrow is {longest:.2f} px", loc="left", fontsize=9
    )


def _draw_rings(adjusted: AdjustedClip, axes: Axes) -> None:
    """Residuals along and across the radius, their means in rings with two standard deviations."""
    camera = adjusted.camera.camera
    apart = adjusted.clip.seen.pixel - camera.K[:2, 2]
    radius = np.linalg.norm(apart, axis=1)
    outward = apart / np.maximum(radius, 1e-9)[:, None]
    across = np.column_stack([-outward[:, 1], outward[:, 0]])
    good = adjusted.weights >= 0.5
    edges = np.linspace(0, radius.max() + 1e-6, _RINGS + 1)
    ring = np.searchsorted(edges, radius, side="right") - 1
    for name, direction, colour, shift in (("along", outward, BLUE, -0.1), ("across", across, ORANGE, 0.1)):
        values = (adjusted.residuals * direction).sum(axis=1)
        told = [_mean(values[good & (ring == number)]) for number in range(_RINGS)]
        at = (edges[:-1] + edges[1:]) / 2 + shift * np.diff(edges)
        mean, std = np.array(told).T
        axes.errorbar(at, mean, 2 * std, fmt="o", color=colour, markersize=4, capsize=2, label=f"{name} the radius")
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.set(xlabel="distance from the principal point [px]", ylabel="mean residual [px]")
    axes.set_title(
        f"what lens and turns leave: means and two standard deviations (a sighting: {adjusted.noise_px:.2f} px)",
        loc="left", fontsize=9,
    )  # fmt: skip
    axes.legend(loc="upper center", ncols=2, fontsize=8, frameon=False)
    axes.grid(visible=True, linewidth=0.4, color="#cccccc")


def _mean(values: FloatArray) -> tuple[float, float]:
    if len(values) < _LEAST:
        return np.nan, np.nan
    return float(values.mean()), float(values.std() / np.sqrt(len(values)))
