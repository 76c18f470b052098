"""The command ``plan``: what a site will be worth before anybody drives there."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich import box
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from vfm_sdm.studies.planning.advice import view_angles
from vfm_sdm.studies.planning.plan import read_plan
from vfm_sdm.studies.planning.report import PlanReport, list_recordings, study_plan, write_report

__all__ = ["plan"]

_MOST_ADVICE = 6
_LEAST_SHARE = 0.01
_out = Console(markup=False)


def plan(
    site: Annotated[Path, Parameter(help="PLAN.toml; docs/plan.md explains it.")],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder to write to.")],
) -> None:
    """Rehearse a site: uncertainty of every point before driving there, what limits it and what would help most."""
    report = study_plan(read_plan(site))
    for part in _report(report):
        _out.print(part)
    written = write_report(output, report)
    _out.print(f"written: {', '.join(map(str, written))}", highlight=False, soft_wrap=True)


def _report(report: PlanReport) -> Iterator[RenderableType]:
    """Tables of uncertainty, sources and recordings, and what would help."""
    yield _uncertainty_table(report)
    yield _share_table(report)
    yield _recording_table(report)
    for note in report.prediction.adjusted.notes:
        yield Text(f"note: {note}", style="yellow")
    yield Text(f"limited by: {report.limiting}", style="bold")
    if not report.advice:
        yield Text("No single reading, lens or place would help much.")
    table = _table("What would help most: uncertainty that is left of today's", ("left", "with"), text=2)
    for one in report.advice[:_MOST_ADVICE]:
        table.add_row(f"{one.left:.0%}", one.sentence)
    if report.advice:
        yield table


def _table(title: str, names: tuple[str, ...], *, text: int) -> Table:
    """A table whose first columns are text and the others numbers."""
    table = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for number, name in enumerate(names):
        table.add_column(Text(name), justify="left" if number < text else "right", overflow="fold")
    return table


def _uncertainty_table(report: PlanReport) -> Table:
    names = ("point", "axis", "amplitude", "+- k=2", "detect", "scale %")
    table, last = _table("Predicted, in mm", names, text=2), ""
    for one in report.prediction.axes:
        shown = one.point if one.point != last else ""
        last = one.point
        scale = f"{100 * one.scale_std:.2f}" if np.isfinite(one.scale_std) else "-"
        swing = f"{one.amplitude_mm:.2f}" if one.axis in report.prediction.laid.plan.motion.by_axis else "-"
        table.add_row(shown, one.axis, swing, f"{one.expanded_mm:.3f}", f"{one.detection_mm:.4f}", scale)
    return table


def _share_table(report: PlanReport) -> Table:
    table = _table("Shares of the variance, over points and moving axes", ("source", "%"), text=1)
    for one in report.shares:
        if one.share >= _LEAST_SHARE:
            table.add_row(one.source, f"{100 * one.share:.0f}")
    return table


def _recording_table(report: PlanReport) -> Table:
    laid = report.prediction.laid
    table = _table("Recordings", ("camera", "view [deg]", "frames", "file [MB]"), text=1)
    for one in list_recordings(laid.plan, view_angles(laid)):
        size = f"{one.megabytes:.0f}" if np.isfinite(one.megabytes) else "-"
        table.add_row(one.camera, f"{one.view_deg:.0f}", str(one.frames), size)
    return table
