"""The batch: every session into its own run folder, by any executor, and none stopped by another."""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from vfm_sdm.core.executors import run_tasks
from vfm_sdm.core.statuses import SessionOutcome
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Defaults, open_views, read_session
from vfm_sdm.measurement import measure
from vfm_sdm.studies.batch.table import BatchRow, describe_run, write_rows

__all__ = ["batch"]

_TABLE = "batch.csv"
_LONG = 1.5
"""Segments from which on a recording is divided."""


def batch(
    sessions: Mapping[str, Path],
    folder: Path | str,
    *,
    defaults: Defaults | None = None,
    executor: Executor | None = None,
    report: Callable[[BatchRow], None] | None = None,
) -> list[BatchRow]:
    """Measures sessions, each into ``folder/NAME``, and writes ``folder/batch.csv``.

    What is finished in a run folder is reused unless its inputs changed, and a run that was cut short goes on. The
    table is written anew whenever a session is done, with those that are.

    Parameters
    ----------
    sessions
        Session files by the names of their run folders (`vfm_sdm.studies.batch.find_sessions`).
    folder
        Folder of the run folders.
    defaults
        What the files need not say.
    executor
        Who measures: processes, or a cluster; one session after another in this process when ``None``. Sessions whose
        recordings are of several segments come last, one after another, with their segments shared by all workers.
    report
        Called with the line of each session when it is done.

    Returns
    -------
    rows
        A line a session, in the order given. A session that fails has one that says why.

    Raises
    ------
    ResultsError
        The table cannot be written.
    """
    target = Path(folder)
    write_rows(target / _TABLE, [])  # before any work is done: a table that cannot be written is known now
    # Workers may have another working directory.
    tasks = [_Task(name, file, file.absolute(), target.absolute() / name, defaults) for name, file in sessions.items()]
    rows: dict[int, BatchRow] = {}

    def done(number: int, row: BatchRow) -> None:
        rows[number] = row
        write_rows(target / _TABLE, [rows[one] for one in sorted(rows)])
        if report is not None:
            report(row)

    def measure_all(numbers: list[int], one: Callable[[_Task], BatchRow], workers: Executor | None) -> None:
        chosen = [tasks[number] for number in numbers]
        failed = run_tasks(one, chosen, workers, lambda index, row: done(numbers[index], row))
        for index, error in failed.items():
            done(numbers[index], _failed(chosen[index], _explain(error)))

    long = [] if executor is None else [number for number, task in enumerate(tasks) if _has_segments(task)]
    measure_all([number for number in range(len(tasks)) if number not in long], _measure_one, executor)
    measure_all(long, partial(_measure_one, executor=executor), None)
    return [rows[one] for one in sorted(rows)]


@dataclass(frozen=True)
class _Task:
    """A session with its place: what it is called, its file as named and as found from anywhere, and its run folder."""

    name: str
    named: Path
    file: Path
    run: Path
    defaults: Defaults | None


def _has_segments(task: _Task) -> bool:
    """Whether a recording of a session is of several segments, which workers can share."""
    try:
        session = read_session(task.file, defaults=task.defaults)
        durations_s = [video.info.duration_s or 0.0 for video in open_views(session).values()]
    except VfmSdmError:
        return False  # whoever measures it says what is wrong
    return max(durations_s) >= _LONG * session.method.segment_s


def _measure_one(task: _Task, executor: Executor | None = None) -> BatchRow:
    """The line of a session. An error on purpose is its result: to try again would not help."""
    begin = time.perf_counter()
    try:
        measurement = measure(read_session(task.file, defaults=task.defaults), task.run, executor=executor)
    except VfmSdmError as error:
        return _failed(task, "; ".join(line.strip() for line in str(error).splitlines()))
    return describe_run(task.name, task.named, measurement, time.perf_counter() - begin)


def _failed(task: _Task, reason: str) -> BatchRow:
    return BatchRow(task.name, str(task.named), SessionOutcome.FAILED, reason=reason)


def _explain(error: Exception) -> str:
    """Words for what nobody foresaw."""
    if isinstance(error, BrokenExecutor):
        return (
            "expected its process to end by itself, got it killed or out of memory; run the batch again, which goes on "
            "where it was"
        )
    return f"{type(error).__name__}: {' '.join(str(error).split())}; measure it alone to see where"
