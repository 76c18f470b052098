"""Colours, and the parts that the plots share: axes, names, and lines with no more corners than a picture can show."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STATUS_MEANINGS, Status
from vfm_sdm.errors import DatasetError

__all__ = [
    "AXIS_COLOURS",
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "PURPLE",
    "VERMILION",
    "choose_name",
    "finish_axes",
    "list_names",
    "make_axes",
    "mark_status",
    "plain_text",
    "reduce_band",
    "reduce_line",
]

# The palette of Okabe and Ito, which stays distinguishable with colour-blindness and in grey.
BLUE, VERMILION, GREEN, ORANGE, PURPLE = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7"
GREY = "#555555"
AXIS_COLOURS = (BLUE, VERMILION, GREEN)
"""Colours of the lateral, vertical and longitudinal axis."""
_DPI = 150
_COLUMNS = 2000
"""Columns of a picture that can show something of their own along time."""


def mark_status(axes: Axes, time_s: FloatArray, values: FloatArray, status: npt.NDArray[Any]) -> None:
    """Draws circles around unreliable values, and ticks at the lower edge where there is no value.

    Parameters
    ----------
    axes
        Axes with the lines.
    time_s
        Time stamps, shape (T,) [s].
    values
        Values of C lines, shape (T, C), in the unit of the vertical axis.
    status
        Codes of `vfm_sdm.core.datasets.Status`, shape (T,).
    """
    unreliable = _pick_marks(status == Status.UNRELIABLE)
    if unreliable.size:
        label = STATUS_MEANINGS[Status.UNRELIABLE]
        for column in values.T:
            axes.plot(
                time_s[unreliable], column[unreliable], "o", markersize=3.5, markerfacecolor="none",
                markeredgecolor=GREY, markeredgewidth=0.7, label=label,
            )  # fmt: skip
            label = "_"
    for code, colour in ((Status.LOST, "black"), (Status.OUTSIDE, ORANGE), (Status.BEHIND, PURPLE)):
        missing = _pick_marks(status == code)
        if missing.size:
            axes.plot(
                time_s[missing], np.full(missing.size, 0.02), "|", markersize=7, color=colour,
                transform=axes.get_xaxis_transform(), label=STATUS_MEANINGS[code].replace("_", " "),
            )  # fmt: skip


def reduce_band(time_s: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A band with few corners: the lowest and the highest value of the frames that share a column of the picture.

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    lower, upper
        Limits of the band, shape (T,), in the unit of the vertical axis.

    Returns
    -------
    time_s, lower, upper
        The reduced band, shapes (T',).

    Notes
    -----
    A long recording has hundreds of frames in each column; drawing them all takes minutes and looks the same.

    Examples
    --------
    >>> time_s = np.arange(20000) / 100
    >>> reduced_s, lowest, highest = reduce_band(time_s, np.sin(time_s), np.sin(time_s))
    >>> reduced_s.size, bool(highest.max() == np.sin(time_s).max())
    (2000, True)
    """
    share = time_s.size // _COLUMNS
    if share < 4:
        return time_s, lower, upper
    starts = np.arange(0, time_s.size, share)
    # fmin and fmax pass over NaN: a gap shorter than a column shows in the status marks.
    return time_s[starts], np.fmin.reduceat(lower, starts), np.fmax.reduceat(upper, starts)


def reduce_line(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A line with few corners, up and down in each column of the picture.

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    values
        Values of the line, shape (T,), in the unit of the vertical axis.

    Examples
    --------
    >>> time_s = np.arange(20000) / 100
    >>> [array.size for array in reduce_line(time_s, np.sin(time_s))]
    [4000, 4000]
    """
    times, lowest, highest = reduce_band(time_s, values, values)
    if times.size == time_s.size:
        return time_s, values
    return np.repeat(times, 2), np.column_stack([lowest, highest]).ravel()


def _pick_marks(flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Indices of the flagged frames, at most one in each column of the picture."""
    found = np.flatnonzero(flags)
    share = max(flags.size // _COLUMNS, 1)
    return found[np.unique(found // share, return_index=True)[1]]


def finish_axes(axes: Axes, time_s: FloatArray) -> Axes:
    """The axes with a grid, no frame above and at the right, and the time as their horizontal range.

    Parameters
    ----------
    axes
        Axes with all their lines.
    time_s
        Time stamps of the lines, shape (T,) [s]; the range stays as it is where there are fewer than two.
    """
    axes.grid(visible=True, linewidth=0.4, color="#cccccc")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if time_s.size > 1:
        axes.set_xlim(time_s[0], time_s[-1])
    return axes


def plain_text(name: str) -> str:
    r"""A name as matplotlib shows it to the letter: dollar signs begin no formula.

    Parameters
    ----------
    name
        Name of a point or a view, or a sentence with such names.

    Examples
    --------
    >>> print(plain_text("pier $2$"))
    pier \$2\$
    """
    return name.replace("$", r"\$")


def choose_name(dataset: xr.Dataset, dim: str, name: str | None) -> str:
    """The wanted name of a dimension, or its only one.

    Parameters
    ----------
    dataset
        Dataset with the dimension.
    dim
        Name of the dimension, such as ``point``.
    name
        The wanted name; may be None where there is only one.

    Raises
    ------
    DatasetError
        The dimension has no such name, or several and none is wanted.

    Examples
    --------
    >>> choose_name(xr.Dataset(coords={"point": ["mid"]}), "point", None)
    'mid'
    """
    names = list_names(dataset, dim)
    if name is None and len(names) == 1:
        return names[0]
    if name not in names:
        raise DatasetError(f"{dim}: expected one of {names}, got {name!r}; name one of these")
    return name


def list_names(dataset: xr.Dataset, dim: str) -> list[str]:
    """Names along a dimension of a dataset.

    Parameters
    ----------
    dataset
        Dataset with the dimension.
    dim
        Name of the dimension, such as ``point``.

    Examples
    --------
    >>> list_names(xr.Dataset(coords={"point": ["mid", "quarter"]}), "point")
    ['mid', 'quarter']
    """
    return [str(name) for name in dataset[dim].values]


def make_axes(ax: Axes | None, size: tuple[float, float] = (10, 3.5)) -> Axes:
    """The axes given, or those of a new figure.

    Parameters
    ----------
    ax
        Axes to draw into, if there are any.
    size
        Width and height of a new figure [inch].
    """
    if ax is not None:
        return ax
    return Figure(figsize=size, dpi=_DPI, layout="constrained").add_subplot()
