"""The command ``plan``: what a site will be worth before anybody drives there."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import OUT, fail, plain_table, say
from vfm_sdm.studies.planning.advice import view_angles
from vfm_sdm.studies.planning.from_run import plan_from_run
from vfm_sdm.studies.planning.plan import read_plan
from vfm_sdm.studies.planning.report import PlanReport, list_recordings, study_plan, write_report

__all__ = ["plan"]

_MOST_ADVICE = 6
_LEAST_SHARE = 0.01


def plan(
    site: Annotated[Path, Parameter(help="PLAN.toml, or the folder of a finished run to do better; docs/plan.md.")],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder to write to.")],
    rehearse: Annotated[
        bool, Parameter(negative="", help="Also film the site with the renderer and measure the films: minutes.")
    ] = False,
) -> None:
    """Rehearse a site: uncertainty of every point before driving there, what limits it and what would help most."""
    planned = plan_from_run(site) if site.is_dir() else read_plan(site)
    films = output / "films" if rehearse else None
    with show_progress() as progress:
        report = study_plan(planned, films=films, progress=progress)
    for part in _report(report):
        OUT.print(part)
    written = write_report(output, report)
    say(f"written: {', '.join(map(str, written))}")
    if report.rehearsal is not None and not np.isfinite(report.rehearsal.ratio):
        fail(f"no rehearsal: {report.rehearsal.status}")


def _report(report: PlanReport) -> Iterator[RenderableType]:
    """Tables of uncertainty, sources and recordings, and what would help."""
    yield _uncertainty_table(report)
    yield _share_table(report)
    yield _recording_table(report)
    yield from _further_tables(report)
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


def _further_tables(report: PlanReport) -> Iterator[RenderableType]:
    """Best places of the cameras, and the rehearsal beside its prediction."""
    if (positions := report.positions) is not None:
        title = f"Best places in the area: {positions.left:.0%} of the uncertainty of the given ones is left"
        table = _table(title, ("camera", "from the face [m]", "along [m]"), text=1)
        for one in positions.plan.camera:
            table.add_row(one.name, f"{one.perpendicular_m:.2f}", f"{one.longitudinal_m:.2f}")
        yield table
    if (rehearsal := report.rehearsal) is not None:
        table = _table("Rehearsal: +- k=2 in mm", ("point", "axis", "predicted", "achieved", "error (rms)"), text=2)
        for row in rehearsal.axes:
            figures = (row.predicted_mm, row.achieved_mm, row.error_mm)
            table.add_row(row.point, row.axis, *(f"{one:.3f}" if np.isfinite(one) else "-" for one in figures))
        yield table


def _table(title: str, names: tuple[str, ...], *, text: int) -> Table:
    """A table whose first columns are text and the others numbers."""
    table = plain_table(title)
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
