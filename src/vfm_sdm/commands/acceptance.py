"""The commands ``accept`` and ``verify``: tests of a finished run."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cyclopts
import numpy as np
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.acceptance import (
    Acceptance,
    AcceptanceRow,
    AcceptedRun,
    check_budget,
    check_lengths,
    check_noise_floor,
    check_rigid,
    read_lengths,
    read_run,
    read_steps,
    write_acceptance,
)
from vfm_sdm.commands.terminal import OUT, Ending, note, plain_table, say, shown_rows
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.stages.cameras.solution import read_solution
from vfm_sdm.studies.verification import read_budget_model, verify_run

__all__ = ["accept", "verify"]

accept = cyclopts.App(
    name="accept",
    help="Acceptance tests of a finished run, each against a stated limit; docs/acceptance.md explains them.",
)

_Run = Annotated[Path, Parameter(help="Run folder with displacement.nc.")]
_Limit = Annotated[
    float | None, Parameter(name="--limit", help="Largest amount in mm; what the run itself states when left out.")
]
_STATUS = {Outcome.PASS: Ending.DONE, Outcome.FAIL: Ending.ERROR, Outcome.NOT_POSSIBLE: Ending.NO_RESULT}
_STYLE = {Outcome.PASS: "green", Outcome.FAIL: "red"}

_MOST_ROWS = 60
"""Rows that a table shows."""


@accept.command(name="noise-floor")
def noise_floor(
    run: _Run,
    *,
    limit: _Limit = None,
    interval: Annotated[tuple[float, float] | None, Parameter(help="Beginning and end in s; all else.")] = None,
) -> None:
    """A recording at rest: mean, standard deviation, drift and spectrum of each point and axis in mm."""
    tested = read_run(run)
    _finish(tested, check_noise_floor(tested.displacement, limit_mm=limit, interval_s=interval))


@accept.command
def rigid(
    run: _Run,
    steps: Annotated[Path, Parameter(help="CSV: start_s, end_s, and a column in mm for each axis of the stage.")],
    *,
    limit: _Limit = None,
    slope_limit: Annotated[
        float | None, Parameter(help="Largest error of a slope, such as 0.01; what the run states when left out.")
    ] = None,
) -> None:
    """Steps of a stage: slope, offset and residual of each point and axis, and change of distances between points."""
    tested = read_run(run)
    _finish(tested, check_rigid(tested, read_steps(steps), limit_mm=limit, slope_limit=slope_limit))


@accept.command
def lengths(
    run: _Run,
    known: Annotated[Path, Parameter(help="CSV: point_a, point_b, length_m and, where known, std_m.")],
    *,
    limit: _Limit = None,
    per_metre: Annotated[float, Parameter(help="Part of the limit for each metre of length in mm.")] = 0.0,
) -> None:
    """Known lengths in the volume: error l_measured - l_known after VDI/VDE 2634 Part 1."""
    tested = read_run(run)
    cameras, _ = read_solution(run / "cameras.toml")
    found = check_lengths(tested, cameras, read_lengths(known), limit_mm=limit, limit_per_m=per_metre)
    _finish(tested, found)


@accept.command
def budget(
    run: _Run,
    *,
    monte_carlo: Annotated[int, Parameter(help="Number of trials.")] = 100_000,
    seed: Annotated[int, Parameter(help="Seed of the trials.")] = 0,
) -> None:
    """The linear budget beside the propagation of distributions (JCGM 101), for each point and axis."""
    tested = read_run(run)
    _finish(tested, check_budget(read_budget_model(run), trials=monte_carlo, seed=seed))


def verify(run: Annotated[Path, Parameter(help="Run folder; nothing is written to it.")]) -> None:
    """Compute displacement anew from tracks, cameras and settings, compare hashes and numbers, say what differs."""
    found = verify_run(run)
    for finding in found.findings:
        if finding.outcome is not Outcome.PASS:
            line = f"{finding.what}: {finding.sentence}"
            OUT.print(Text(f" {'differs' if finding.outcome is Outcome.FAIL else 'not compared'}: {line}"))
    same = sum(finding.outcome is Outcome.PASS for finding in found.findings)
    if found.differing:
        OUT.print(f"verify: {len(found.differing)} differ, {same} agree", style="bold red", highlight=False)
        sys.exit(Ending.ERROR)
    if not found.recomputed:
        OUT.print(f"verify: {same} agree, displacement could not be computed anew", style="yellow", highlight=False)
        sys.exit(Ending.NO_RESULT)
    OUT.print(f"verify: all {same} comparisons agree", style="bold green", highlight=False)


def _finish(run: AcceptedRun, result: Acceptance) -> None:
    """Prints a test, writes its file, and ends with its status."""
    OUT.print(_tabulate(result))
    note((*run.notes, *result.notes))
    path = write_acceptance(run, result)
    say(f"written: {path}")
    passed = sum(row.outcome is Outcome.PASS for row in result.rows)
    style = f"bold {_STYLE.get(result.outcome, 'yellow')}"
    OUT.print(f"{result.name}: {result.outcome} ({passed} of {len(result.rows)})", style=style, highlight=False)
    if result.outcome is not Outcome.PASS:
        sys.exit(_STATUS[result.outcome])


def _tabulate(result: Acceptance) -> Table:
    """Every figure beside its limit."""
    title = Text(f"Acceptance: {result.name}; limits: {result.limits}")
    table = plain_table(title)
    for name in ("of", "figure", "value", "limit", "unit", ""):
        table.add_column(Text(name), justify="right" if name in ("value", "limit") else "left")
    rows = _shown(result.rows)
    for row in rows:
        shown = ["-" if np.isnan(value) else f"{value:.4g}" for value in (row.value, row.limit)]
        style = _STYLE.get(row.outcome, "yellow")
        outcome = Text(str(row.outcome), style=style)
        table.add_row(Text(row.subject), row.quantity, *shown, row.units, outcome)
    if len(rows) < len(result.rows):
        left = len(result.rows) - len(rows)
        table.caption, table.caption_justify = f"... and {left} more; all in acceptance_{result.name}.json", "left"
    return table


def _shown(rows: Sequence[AcceptanceRow]) -> Sequence[AcceptanceRow]:
    """All rows where there is room for them, else what was not passed first."""
    if len(rows) <= _MOST_ROWS or shown_rows(len(rows)) == len(rows):
        return rows
    return sorted(rows, key=lambda row: row.outcome is Outcome.PASS)[:_MOST_ROWS]
