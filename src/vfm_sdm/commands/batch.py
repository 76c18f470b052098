"""The command ``batch``: many sessions, and a table of what came out."""

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.options import WorkerOptions
from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import ERR, OUT, Ending, plain_table, say, say_json
from vfm_sdm.core.statuses import SessionOutcome, Verdict
from vfm_sdm.inputs.session import read_defaults
from vfm_sdm.studies.batch import BatchRow, batch, find_sessions

__all__ = ["batch_command"]

_STYLE = {Verdict.FIT: "green", Verdict.CARE: "yellow", Verdict.NOT_JUDGED: "yellow"}

_WORKERS = WorkerOptions()


def batch_command(
    *sessions: Annotated[str, Parameter(help="Session files, or patterns in quotes: 'sites/*/session.toml'.")],
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder of the run folders, one a session.")],
    defaults: Annotated[Path | None, Parameter(help="TOML file of what the sessions need not say themselves.")] = None,
    as_json: Annotated[bool, Parameter(name="--json", negative="", help="Print the table as JSON alone.")] = False,
    work: WorkerOptions = _WORKERS,
) -> None:
    """Measure many sessions, each into a run folder of its own; a table at the end, also in batch.csv.

    What is finished is reused unless its inputs changed, and one failure does not stop the others. Exit status: 0 where
    every session gave a result that can be used, 1 where one of them failed, else 3 where the data of one did not
    allow a result, else 4 where the audit of one says not to use it.
    """
    found = find_sessions(sessions)
    common = None if defaults is None else read_defaults(defaults)
    done = 0
    with show_progress() as progress, work.executor() as executor:

        def report(row: BatchRow) -> None:
            nonlocal done
            done += 1
            ERR.print(f"{done}/{len(found)} {row.session}: {_say_outcome(row)}", highlight=False, soft_wrap=True)
            progress("sessions", done, len(found))

        progress("sessions", 0, len(found))
        rows = batch(found, output, defaults=common, executor=executor, report=report)
    if as_json:
        table = [{key: _known(value) for key, value in asdict(row).items()} for row in rows]
        say_json({"sessions": table}, indent=2)
    else:
        OUT.print(_tabulate(rows))
        for row in rows:
            if row.reason:
                OUT.print(f"{row.session}: {row.reason}", style="red", highlight=False, soft_wrap=True)
        say(f"written: {output / 'batch.csv'}")
    sys.exit(_ending(rows))


def _ending(rows: Sequence[BatchRow]) -> Ending:
    """Exit status for the worst that became of a session."""
    outcomes = {row.outcome for row in rows}
    if SessionOutcome.FAILED in outcomes:
        return Ending.ERROR
    if SessionOutcome.NO_RESULT in outcomes:
        return Ending.NO_RESULT
    return Ending.REFUSED if Verdict.REFUSED in {row.verdict for row in rows} else Ending.DONE


def _tabulate(rows: Sequence[BatchRow]) -> Table:
    """A line a session: verdict, points that were measured, worst uncertainty and of what, time."""
    title = Text("Sessions; worst uncertainty of a peak-to-peak (k = 2) in mm")
    table = plain_table(title)
    for name in ("session", "verdict", "points", "+- mm", "worst at", "time s"):
        words = name in ("session", "verdict", "worst at")
        table.add_column(Text(name), justify="left" if words else "right", overflow="fold", no_wrap=not words)
    for row in rows:
        known = bool(np.isfinite(row.uncertainty_mm))
        table.add_row(
            Text(row.session),
            Text(_say_outcome(row), style=_style(row)),
            f"{row.measured_points}/{row.points}" if row.points else "-",
            f"{row.uncertainty_mm:.3f}" if known else "-",
            Text(f"{row.point} {row.axis}" if known else ""),
            f"{row.time_s:.0f}" if np.isfinite(row.time_s) else "-",
        )
    return table


def _say_outcome(row: BatchRow) -> str:
    return row.verdict if row.outcome is SessionOutcome.MEASURED and row.verdict else str(row.outcome)


def _style(row: BatchRow) -> str:
    measured = row.outcome is SessionOutcome.MEASURED
    return _STYLE.get(Verdict(row.verdict), "red") if measured and row.verdict else "" if measured else "red"


def _known(value: object) -> object:
    return None if isinstance(value, float) and not np.isfinite(value) else value
