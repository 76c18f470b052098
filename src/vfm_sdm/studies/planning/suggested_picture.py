"""The first frames with suggested points and their subsets drawn in."""

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from vfm_sdm.core.files import write_file
from vfm_sdm.outputs.plots import plot_points, plot_subsets
from vfm_sdm.outputs.plots.drawing import plain_text
from vfm_sdm.studies.planning.suggestion import Suggestion

__all__ = ["draw_suggestion", "write_picture"]

_DPI = 150
_WIDTH_IN = 10.0
_HEAD_IN = 0.9


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
        places = np.array([one.pixels[number] for one in found.points])
        static = [one.static for one in found.points]
        plot_points(found.frames[view], places, names, axes, static=static)
        plot_subsets(axes, places, [one.subset_px for one in found.points], static)
        axes.set_title(plain_text(f"{view}: squares are subsets; orange: on the structure, blue: static"), loc="left")
    return figure
