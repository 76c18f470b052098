"""Error against a parameter of the scene or the recording."""

from collections.abc import Collection, Iterable
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.errors import DatasetError
from vfm_sdm.outputs.plots.drawing import AXIS_COLOURS, GREY, finish_axes
from vfm_sdm.outputs.plots.protocol.layout import LINE_WIDTH, add_legend, make_figure, panel_order

__all__ = ["SensitivityRecord", "plot_sensitivity"]

_METHOD_STYLES = (("o", "-"), ("s", "--"), ("^", ":"), ("D", "-."), ("v", (0, (5, 1, 1, 1, 1, 1))))
_MOST_COLUMNS = 3


class SensitivityRecord(NamedTuple):
    """The error of one method at one value of one parameter; a plain tuple in this order serves as well."""

    parameter: str
    """Name of the parameter with its unit, as it stands at the axis: ``amplitude [px]``."""
    value: float
    method: str
    axis: str
    nrmse: float
    """Range-normalised root mean square error [1]; NaN where the method gave no result."""


def plot_sensitivity(
    records: Iterable[SensitivityRecord | tuple[str, float, str, str, float]], *, log: Collection[str] = ()
) -> Figure:
    """Error [1] against parameters, one panel for each: colours are axes, marks and dashes are methods.

    Where several records share parameter, value, method and axis, the line runs through their mean and each is a dot.
    A value without a result breaks the line and is marked by a cross at the lower edge.

    Parameters
    ----------
    records
        At least one record, in any order (see `SensitivityRecord`).
    log
        Parameters that are drawn on a logarithmic axis.

    Raises
    ------
    DatasetError
        There is no record, a value is not finite, ``log`` names another parameter or one with values <= 0.

    Examples
    --------
    >>> records = [("amplitude [px]", value, "with SGR", "vertical", 0.1 / value) for value in (0.5, 1.0, 2.0)]
    >>> plot_sensitivity(records).axes[0].get_xlabel()
    'amplitude [px]'
    """
    rows = [SensitivityRecord(*record) for record in records]
    parameters = list(dict.fromkeys(row.parameter for row in rows))
    _check_records(rows, parameters, log)
    methods = list(dict.fromkeys(row.method for row in rows))
    axis_names = sorted(dict.fromkeys(row.axis for row in rows), key=panel_order)
    columns = min(len(parameters), _MOST_COLUMNS)
    lines = -(-len(parameters) // columns)
    figure = make_figure(0.8 + 2.3 * lines)
    grid = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel().tolist()
    for panel in grid[len(parameters) :]:
        panel.set_axis_off()
    panels = grid[: len(parameters)]
    for number, (panel, parameter) in enumerate(zip(panels, parameters, strict=True)):
        for axis in axis_names:
            for index, method in enumerate(methods):
                chosen = [row for row in rows if (row.parameter, row.axis, row.method) == (parameter, axis, method)]
                _draw_sensitivity(panel, chosen, index, f"{axis}, {method}")
        panel.set_xscale("log" if parameter in log else "linear")
        panel.set_xticks(sorted({row.value for row in rows if row.parameter == parameter}))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.minorticks_off()
        panel.set_xlabel(parameter)
        finish_axes(panel, np.empty(0))
        if number % columns == 0:
            panel.set_ylabel("NRMSE [1]")
    panels[0].set_ylim(bottom=0)
    return add_legend(figure, panels)


def _check_records(rows: list[SensitivityRecord], parameters: list[str], log: Collection[str]) -> None:
    if not rows:
        raise DatasetError("records: expected at least one, got none; run the study first")
    if not set(log).issubset(parameters):
        raise DatasetError(f"log: expected names out of {parameters}, got {sorted(log)}; correct them")
    for row in rows:
        if not np.isfinite(row.value) or (row.parameter in log and row.value <= 0):
            raise DatasetError(
                f"{row.parameter}: expected finite values, above 0 on a logarithmic axis, got {row.value}; leave it out"
            )


def _draw_sensitivity(panel: Axes, rows: list[SensitivityRecord], method: int, label: str) -> None:
    if not rows:
        return
    axis = rows[0].axis
    colour = AXIS_COLOURS[STRUCTURE_AXES.index(axis)] if axis in STRUCTURE_AXES else GREY
    marker, dashes = _METHOD_STYLES[method % len(_METHOD_STYLES)]
    value, nrmse = (np.array(column, np.float64) for column in ([r.value for r in rows], [r.nrmse for r in rows]))
    steps = np.unique(value)
    mean = np.array([nrmse[value == step].mean() for step in steps])
    fill = colour if method == 0 else "white"
    panel.plot(
        steps, mean, color=colour, linestyle=dashes, linewidth=LINE_WIDTH, marker=marker, markersize=4.5,
        markerfacecolor=fill, label=label,
    )  # fmt: skip
    if len(steps) < len(rows):
        panel.plot(value, nrmse, ".", color=colour, markersize=3, markeredgewidth=0, alpha=0.6)
    missing = np.unique(value[np.isnan(nrmse)])
    if missing.size:
        panel.plot(
            missing, np.full(missing.size, 0.03), "x", color=colour, markersize=5, label="no result",
            transform=panel.get_xaxis_transform(),
        )  # fmt: skip
