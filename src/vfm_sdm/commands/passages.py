"""The command ``passages``: dynamic amplification of vehicles that passed, and influence lines."""

from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from cyclopts import Parameter
from rich import box
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.load_test import judge_passages, read_axles, read_passages, write_passages
from vfm_sdm.commands.runs import about_run, alone_in_run, check_elsewhere, read_run, save_figure
from vfm_sdm.commands.terminal import OUT, add_name_column, fail, note, number_text, say, say_rest, shown_rows
from vfm_sdm.core.statuses import PassageStatus
from vfm_sdm.outputs.plots.load_test import draw_passages

__all__ = ["passages"]

_KM_H = 3.6


@alone_in_run
def passages(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    table: Annotated[Path, Parameter(help="Table of the passages, a row each; docs/load-test.md says how.")],
    *,
    axis: Annotated[str, Parameter(help="Axis of the table and the figure; the files hold all.")] = "vertical",
    frequency: Annotated[
        float | None,
        Parameter(help="Natural frequency of the structure [Hz]; found in the displacement when left out."),
    ] = None,
    axles: Annotated[str, Parameter(help="Axles of the vehicle, metres behind the first and kN: 0:60,3.2:120.")] = "",
) -> None:
    """Judge vehicles that passed: dynamic amplification with uncertainty, and displacement against their place.

    Writes passages.nc, passages.csv and figures/passages.png into the run folder, where `vfm-sdm report` finds them.
    """
    check_elsewhere(table, run / "passages.csv")
    driven = read_passages(table)
    of_vehicle = read_axles(axles) if axles else ()
    displacement, notes = read_run(run, axis)
    crossed = judge_passages(displacement, driven, frequency_hz=frequency, axles=of_vehicle)
    OUT.print(_tabulate(crossed.sel(axis=axis)))
    note(notes)
    figure = draw_passages(displacement, crossed, axis, about_run(run))
    written = [*write_passages(run, crossed), save_figure(figure, run, "passages")]
    say(f"written: {', '.join(map(str, written))}")
    if not np.isfinite(crossed["amplification"].sel(axis=axis).values).any():
        words = sorted(set(crossed["status"].sel(axis=axis).values.ravel().tolist()))
        fail(f"no amplification is known along {axis}: {', '.join(words)}")


def _tabulate(crossed: xr.Dataset) -> Table:
    """Passages of every point that moved, along one axis."""
    known = np.isfinite(crossed["largest_static"].transpose("passage", "point").values).any(axis=0)
    names = [str(name) for name in crossed["point"].values[known]]
    table = Table(
        title=Text("Passages, +- 95 %"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    add_name_column(table, "point", names)
    for column in ("time [s]", "km/h", "total mm", "static mm", "+-", "ampl.", "from-to"):
        table.add_column(Text(column), justify="right", no_wrap=column in ("time [s]", "ampl.", "from-to"))
    for name in names[: shown_rows(len(names))]:
        for number in range(crossed.sizes["passage"]):
            one = crossed.sel(point=name).isel(passage=number)
            table.add_row(
                name if number == 0 else "",
                f"{float(one['begin_s']):.1f}-{float(one['end_s']):.1f}",
                number_text(float(one["speed_m_s"]), "{:.1f}", _KM_H),
                *(
                    number_text(float(one[key]), "{:.3f}")
                    for key in ("largest_total", "largest_static", "static_uncertainty", "amplification")
                ),
                _interval(one),
            )
    return say_rest(table, len(names), "passages.csv")


def _interval(one: xr.Dataset) -> str:
    """Limits of the amplification, or why it is not known."""
    low, high = (float(one[f"amplification_{end}"]) for end in ("low", "high"))
    status = str(one["status"].values)
    return f"{low:.3f}-{high:.3f}" if status == PassageStatus.OK else status
