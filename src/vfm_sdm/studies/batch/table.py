"""One line a session: what became of it and what it is worth."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

from vfm_sdm.core.files import csv_text, number_cell, write_file
from vfm_sdm.core.statuses import SessionOutcome
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.results import first_cause

__all__ = ["BatchRow", "describe_run", "write_rows"]


@dataclass(frozen=True)
class BatchRow:
    """What became of one session.

    Parameters
    ----------
    session
        Name of the session's run folder.
    file
        File of the session.
    outcome
        What became of it.
    verdict
        Verdict of the audit; empty where there is none.
    measured_points, points
        Points with at least one sample that is ok, and all; static points count only where there are no others.
    uncertainty_mm, point, axis
        Largest expanded uncertainty (k = 2) of a peak-to-peak displacement of these points [mm], and of which; NaN and
        empty where there is none.
    time_s
        Time that it took in this run [s].
    reason
        Why it has no result, in one line; empty where it has one.
    """

    session: str
    file: str
    outcome: SessionOutcome
    verdict: str = ""
    measured_points: int = 0
    points: int = 0
    uncertainty_mm: float = float("nan")
    point: str = ""
    axis: str = ""
    time_s: float = float("nan")
    reason: str = ""


def describe_run(session: str, file: Path, measurement: Measurement, time_s: float) -> BatchRow:
    """The line of a session that was measured to its end.

    Parameters
    ----------
    session
        Name of the run folder.
    file
        File of the session.
    measurement
        The measurement with all its products.
    time_s
        Time that it took [s].
    """
    cause = first_cause(measurement.cameras, measurement.tracks, measurement.displacement)
    outcome = SessionOutcome.NO_RESULT if cause else SessionOutcome.MEASURED
    points = measurement.session.point
    wanted = [one.name for one in points if not one.static] or [one.name for one in points]
    found = {name: row for name, row in measurement.summary["points"].items() if name in wanted}
    known = [
        (axis["expanded_uncertainty_mm"], name, axis_name)
        for name, row in found.items()
        for axis_name, axis in row["axes"].items()
        if axis["expanded_uncertainty_mm"] is not None
    ]
    uncertainty_mm, point, axis = max(known, default=(float("nan"), "", ""))
    return BatchRow(
        session=session,
        file=str(file),
        outcome=outcome,
        verdict="" if measurement.audit is None else str(measurement.audit.verdict),
        measured_points=sum(bool(row["coverage_valid"]) for row in found.values()),
        points=len(wanted),
        uncertainty_mm=uncertainty_mm,
        point=point,
        axis=axis,
        time_s=time_s,
        reason=cause,
    )


def write_rows(path: Path, rows: Iterable[BatchRow]) -> Path:
    """Writes the lines as CSV, whole or not at all, with empty cells for what is not known; returns the path.

    Parameters
    ----------
    path
        The file to make or replace.
    rows
        Sessions in the order of the file.

    Raises
    ------
    ResultsError
        The file cannot be written.
    """
    names = [field.name for field in fields(BatchRow)]
    lines = ([getattr(row, name) for name in names] for row in rows)
    cells = [[number_cell(cell) if isinstance(cell, float) else cell for cell in line] for line in lines]
    return write_file(path, csv_text(names, cells))
