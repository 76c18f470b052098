"""Sheets as wide as the text of an A4 page, their legends, and how they are written."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from vfm_sdm.core.files import write_file
from vfm_sdm.errors import ResultsError

__all__ = ["LINE_WIDTH", "WIDTH_IN", "add_legend", "make_figure", "make_panels", "panel_order", "save_figure"]

WIDTH_IN = 6.9
LINE_WIDTH = 0.8
_DPI = 200
_HANDLE_IN, _CHARACTER_IN = 0.6, 0.07
"""Widths of a legend's entry in small print: its line with the gaps, and a character of its text."""
_UPPER_FIRST = ("vertical", "lateral", "longitudinal")


def make_figure(height_in: float) -> Figure:
    """An empty figure as wide as the text of an A4 page.

    Parameters
    ----------
    height_in
        Height of the figure [inch].

    Examples
    --------
    >>> make_figure(3.0).get_size_inches().round(1).tolist()
    [6.9, 3.0]
    """
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06)
    return Figure(figsize=(WIDTH_IN, height_in), dpi=_DPI, layout=layout)


def make_panels(count: int, *, height_in: float, sharey: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure of panels one below the other, with one time axis.

    Parameters
    ----------
    count
        Number of panels.
    height_in
        Height of a panel [inch].
    sharey
        Whether the panels have one vertical scale.

    Examples
    --------
    >>> figure, panels = make_panels(3, height_in=2.0)
    >>> len(panels)
    3
    """
    figure = make_figure(0.7 + height_in * count)
    panels = figure.subplots(count, 1, squeeze=False, sharex=True, sharey=sharey)[:, 0].tolist()
    return figure, panels


def add_legend(figure: Figure, panels: Sequence[Axes], title: str = "") -> Figure:
    """The figure with one legend for all panels, below them so that none covers data, and a title.

    Parameters
    ----------
    figure
        Figure of the panels.
    panels
        Panels whose lines have labels.
    title
        Title of the figure; none when empty.

    Examples
    --------
    >>> figure, panels = make_panels(1, height_in=2.0)
    >>> _ = panels[0].plot([0, 1], [0, 1], label="vision")
    >>> [text.get_text() for text in add_legend(figure, panels).legends[0].get_texts()]
    ['vision']
    """
    entries: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    widest = _HANDLE_IN + _CHARACTER_IN * max(map(len, entries), default=0)
    columns = max(1, min(len(entries), int(WIDTH_IN / widest)))
    figure.legend(
        entries.values(), entries.keys(), loc="outside lower center", ncols=columns, frameon=False, fontsize="small"
    )
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def panel_order(axis: str) -> int:
    """Place of an axis' panel: first those of the paper in its order, then all others.

    Parameters
    ----------
    axis
        Name of a structural axis.

    Examples
    --------
    >>> sorted(["lateral", "vertical"], key=panel_order)
    ['vertical', 'lateral']
    """
    return _UPPER_FIRST.index(axis) if axis in _UPPER_FIRST else len(_UPPER_FIRST)


def save_figure(path: Path | str, figure: Figure) -> Path:
    """Writes a figure as PNG, whole or not at all, and returns its path.

    Parameters
    ----------
    path
        File to write, with the suffix ``.png``.
    figure
        Figure to write, at 200 dots an inch.

    Raises
    ------
    ResultsError
        The name does not end in ``.png``, or the file cannot be written.

    Notes
    -----
    Figures made anew from equal data give equal bytes (with one version of matplotlib). Drawing a figure a second time
    may shift its panels by a pixel.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     print(save_figure(f"{folder}/empty.png", make_figure(1.0)).name)
    empty.png
    """
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise ResultsError(f"{target}: expected a name that ends in .png, got {target.suffix!r}; rename it")
    drawn = BytesIO()
    # Without the entry that names the version of the program that drew it.
    figure.savefig(drawn, format="png", dpi=_DPI, metadata={"Software": None}, pil_kwargs={"compress_level": 6})
    return write_file(target, drawn.getvalue())
