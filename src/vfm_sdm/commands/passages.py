"""The command ``passages``: dynamic amplification of vehicles that passed, and influence lines."""

from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.load_test import drop_static, judge_passages, read_axles, read_passages, write_passages
from vfm_sdm.commands.runs import about_run, alone_in_run, check_elsewhere, note_static, read_run, save_figure
from vfm_sdm.commands.terminal import (
    OUT,
    add_name_column,
    fail,
    note,
    number_text,
    plain_table,
    say,
    say_rest,
    shown_rows,
)
from vfm_sdm.core.constants import KM_H
from vfm_sdm.core.statuses import PassageStatus
from vfm_sdm.outputs.plots.load_test import draw_passages

__all__ = ["passages"]


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
    about = about_run(run)
    crossed = judge_passages(displacement, driven, frequency_hz=frequency, axles=of_vehicle, static=about.static)
    shown = drop_static(crossed, about.static)
    OUT.print(_tabulate(shown.sel(axis=axis)))
    say(_tell_frequency(shown.sel(axis=axis)))
    note([*notes, *note_static(crossed, about.static, "passages.csv")])
    figure = draw_passages(displacement, shown, axis, about)
    written = [*write_passages(run, crossed), save_figure(figure, run, "passages")]
    say(f"written: {', '.join(map(str, written))}")
    if not np.isfinite(shown["amplification"].sel(axis=axis).values).any():
        words = sorted(set(shown["status"].sel(axis=axis).values.ravel().tolist())) or ["all points are static"]
        fail(f"no amplification is known along {axis}: {', '.join(words)}")


def _tell_frequency(crossed: xr.Dataset) -> str:
    """Natural frequency by which static and dynamic part are told apart, along one axis, and where it is from."""
    known = crossed["frequency"].values[np.isfinite(crossed["frequency"].values)]
    if not known.size:
        return "natural frequency: none stands clear of the noise; state it with --frequency"
    low, high = (f"{value:.2f}" for value in (known.min(), known.max()))
    between = low if low == high else f"{low} to {high}, by point"
    origin = "given" if crossed.attrs["frequency"] == "given" else "found in the displacement"
    return (
        f"natural frequency [Hz]: {between}, {origin}; the static part lies below cutoffs between it and the passages"
    )


def _tabulate(crossed: xr.Dataset) -> Table:
    """Passages of every point that moved, along one axis."""
    known = np.isfinite(crossed["largest_static"].transpose("passage", "point").values).any(axis=0)
    names = [str(name) for name in crossed["point"].values[known]]
    table = plain_table("Passages, +- 95 %")
    add_name_column(table, "point", names)
    for column in ("time [s]", "km/h", "total mm", "static mm", "+-", "ampl.", "from-to"):
        table.add_column(Text(column), justify="right", no_wrap=column in ("time [s]", "ampl.", "from-to"))
    for name in names[: shown_rows(len(names))]:
        for number in range(crossed.sizes["passage"]):
            one = crossed.sel(point=name).isel(passage=number)
            table.add_row(
                name if number == 0 else "",
                f"{float(one['begin_s']):.1f}-{float(one['end_s']):.1f}",
                number_text(float(one["speed_m_s"]), "{:.1f}", KM_H),
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
