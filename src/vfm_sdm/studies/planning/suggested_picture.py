"""The first frames with suggested points and their subsets drawn in."""

from io import BytesIO
from pathlib import Path

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from vfm_sdm.core.files import write_file
from vfm_sdm.outputs.plots import plot_points
from vfm_sdm.outputs.plots.drawing import BLUE, ORANGE, plain_text
from vfm_sdm.studies.planning.suggestion import SuggestedPoint, Suggestion

__all__ = ["draw_suggestion", "write_picture"]

_DPI = 150
_WIDTH_IN = 10.0
_HEAD_IN = 0.9
_HALO = (effects.withStroke(linewidth=3.0, foreground="black"),)


def write_picture(path: Path | str, found: Suggestion) -> Path:
    """Writes the picture as PNG.

    Parameters
    ----------
    path
        File to write; replaced as a whole.
    found
        Suggested points.
    """
    buffer = BytesIO()
    draw_suggestion(found).savefig(buffer, format="png", dpi=_DPI)
    return write_file(Path(path), buffer.getvalue())


def draw_suggestion(found: Suggestion) -> Figure:
    """First frame of every view, one below the other, with each point's subset at its true size.

    Parameters
    ----------
    found
        Suggested points.
    """
    shapes = [frame.shape for frame in found.frames.values()]
    rows_in = [_WIDTH_IN * height / width + _HEAD_IN for height, width in shapes]
    figure = Figure(figsize=(_WIDTH_IN, sum(rows_in)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(shapes), 1, height_ratios=rows_in))
    names = [one.name for one in found.points]
    for number, (view, axes) in enumerate(zip(found.frames, panels, strict=True)):
        plot_points(found.frames[view], np.array([one.pixels[number] for one in found.points]), names, axes)
        for one in found.points:
            _draw_subset(axes, one, number)
        axes.set_title(plain_text(f"{view}: squares are subsets; orange: on the structure, blue: static"), loc="left")
    return figure


def _draw_subset(axes: Axes, point: SuggestedPoint, view: int) -> None:
    """The square that is compared around a point."""
    u, v = point.pixels[view]
    if np.isfinite(u + v) and point.subset_px:
        corner, side = (u - point.subset_px / 2, v - point.subset_px / 2), point.subset_px
        colour = BLUE if point.static else ORANGE
        axes.add_patch(Rectangle(corner, side, side, fill=False, edgecolor=colour, linewidth=1.4, path_effects=_HALO))
