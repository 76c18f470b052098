"""The batch: every session into its own run folder, by any executor, and none stopped by another."""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from pathlib import Path

from vfm_sdm.core.statuses import SessionOutcome
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Defaults, read_session
from vfm_sdm.measurement import measure
from vfm_sdm.studies.batch.table import BatchRow, describe_run, write_rows

__all__ = ["batch"]

_TABLE = "batch.csv"


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
        Who measures a session, such as `vfm_sdm.studies.batch.OneProcessEach`; one after another in this process for
        ``None``.
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
    pool = ThreadPoolExecutor(1) if executor is None else executor
    write_rows(target / _TABLE, [])  # before any work is done: a table that cannot be written is known now
    begun = {
        pool.submit(_measure_one, name, file, target / name, defaults): (name, file) for name, file in sessions.items()
    }
    rows: dict[str, BatchRow] = {}
    try:
        for future in as_completed(begun):
            name, file = begun[future]
            rows[name] = _row_of(future, name, file)
            write_rows(target / _TABLE, [rows[one] for one in sessions if one in rows])
            if report is not None:
                report(rows[name])
    finally:
        for future in begun:
            future.cancel()
        if executor is None:
            pool.shutdown()
    return [rows[name] for name in sessions]


def _measure_one(name: str, file: Path, run: Path, defaults: Defaults | None) -> BatchRow:
    begin = time.perf_counter()
    measurement = measure(read_session(file, defaults=defaults), run)
    return describe_run(name, file, measurement, time.perf_counter() - begin)


def _row_of(future: Future[BatchRow], name: str, file: Path) -> BatchRow:
    """The line of a session that is done, one way or another."""
    error = future.exception()
    if error is None:
        return future.result()
    said = "; ".join(line.strip() for line in str(error).splitlines())
    if isinstance(error, BrokenExecutor):
        said = (
            "expected its process to end by itself, got it killed or out of memory; run the batch again, which goes on "
            "where it was"
        )
    elif not isinstance(error, VfmSdmError):
        said = f"{type(error).__name__}: {said}; measure it alone to see where"
    return BatchRow(name, str(file), SessionOutcome.FAILED, reason=said)
