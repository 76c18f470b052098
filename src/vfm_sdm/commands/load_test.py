"""The command ``load-test``: static levels of every step, and how they compare with what was calculated."""

from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.load_test import Limits, drop_static, judge_load_test, read_steps, write_load_test
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
from vfm_sdm.outputs.plots.load_test import draw_load_test

__all__ = ["load_test"]

_LIMITS = Limits()


@alone_in_run
def load_test(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    steps: Annotated[Path, Parameter(help="Table of the steps, a row each; docs/load-test.md says how.")],
    *,
    axis: Annotated[str, Parameter(help="Axis of the tables and the figure; the files hold all.")] = "vertical",
    ratio: Annotated[
        float, Parameter(help="Limit of the measured deflection over the calculated one.")
    ] = _LIMITS.ratio,
    residual: Annotated[
        float, Parameter(help="Limit of what remains after unloading, over the largest deflection.")
    ] = _LIMITS.residual,
) -> None:
    """Judge a load test: deflection of every step with uncertainty, what remains, and whether limits are exceeded.

    Writes load_test.nc, load_test.csv and figures/load_test.png into the run folder, where `vfm-sdm report` finds them.
    """
    check_elsewhere(steps, run / "load_test.csv")
    plan = read_steps(steps)
    displacement, notes = read_run(run, axis)
    about = about_run(run)
    result = judge_load_test(displacement, plan, Limits(ratio, residual), static=about.static)
    shown = drop_static(result, about.static)
    for table in _tabulate(shown.sel(axis=axis)):
        OUT.print(table)
    note([*notes, *note_static(result, about.static, "load_test.csv")])
    if result.attrs["stillness"] == "found":
        note(["when each step stood was found in the displacement: compare begin and end with the notes of the test"])
    figure = draw_load_test(displacement, shown, axis, about)
    written = [*write_load_test(run, result), save_figure(figure, run, "load_test")]
    say(f"written: {', '.join(map(str, written))}")
    if not np.isfinite(shown["deflection"].sel(axis=axis).values[1:]).any():
        fail(f"no level is known along {axis}: too few samples of points that may move are ok while the steps stood")


def _tabulate(result: xr.Dataset) -> list[Table]:
    """Steps of the points that deflect, and what remains of each."""
    units = result["load"].attrs.get("units") or "1"
    names = [str(name) for name in result["point"].values if np.isfinite(result["largest"].sel(point=name))]
    shown = names[: shown_rows(len(names))]
    limit = result.attrs["ratio_limit"]
    steps = _table(
        Text("Deflection from the first step on, +- 95 %"),
        names,
        (f"load [{units}]", "time [s]", "mm", "+-", "calc. mm", "ratio", f"P(> {limit:g})"),
    )
    for name in shown:
        for step in range(result.sizes["step"]):
            one = result.sel(point=name).isel(step=step)
            steps.add_row(
                name if step == 0 else "",
                f"{float(one['load']):g}",
                f"{float(one['begin_s']):.0f}-{float(one['end_s']):.0f}",
                *(
                    number_text(float(one[key]), form)
                    for key, form in (
                        ("deflection", "{:.3f}"),
                        ("expanded_uncertainty", "{:.3f}"),
                        ("calculated", "{:.3f}"),
                        ("ratio", "{:.3f}"),
                        ("ratio_exceeded", "{:.2f}"),
                    )
                ),
            )
    most = result.attrs["residual_limit"]
    rest = _table(
        Text("After unloading"),
        names,
        (
            "largest mm",
            "residual mm",
            "share %",
            "from",
            "to",
            f"P(> {100 * most:g} %)",
            f"mm/{units}",
        ),
    )
    for name in shown:
        one = result.sel(point=name)
        rest.add_row(
            name,
            *(number_text(float(one[key]), "{:.3f}") for key in ("largest", "residual")),
            *(number_text(float(one[key]), "{:.1f}", 100) for key in ("residual_share", "share_low", "share_high")),
            number_text(float(one["residual_exceeded"]), "{:.2f}"),
            number_text(float(one["flexibility"]), "{:.3g}"),
        )
    return [say_rest(steps, len(names), "load_test.csv"), say_rest(rest, len(names), "load_test.csv")]


def _table(title: Text, names: list[str], columns: tuple[str, ...]) -> Table:
    table = plain_table(title)
    add_name_column(table, "point", names)
    for column in columns:
        table.add_column(Text(column), justify="right")
    return table
