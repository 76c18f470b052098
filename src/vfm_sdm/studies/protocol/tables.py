"""Tables as the paper prints them, and their files in CSV and Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.core.files import csv_text, write_file

__all__ = ["METRICS", "Case", "Table", "comparison_table", "write_table"]

METRICS = {
    "NRMSE range": "nrmse_range",
    "correlation": "correlation",
    "RPPAE": "rppae",
    "gain": "gain",
    "skill": "skill",
}
"""Columns of a comparison and the field of a `Score` behind each; the first three are the paper's."""

_WHOLE = 0.95
"""Share of the field test's samples below which a score is named in a note."""

Cell = str | float


@dataclass(frozen=True, order=True)
class Case:
    """One measurement instance: a point of a field test along an axis."""

    dataset: str
    point: str
    axis: str


@dataclass(frozen=True)
class Table:
    """A table whose numbers are kept as numbers.

    Parameters
    ----------
    name
        Name of its files.
    title
        Title above the Markdown.
    columns
        Headings of the columns.
    rows
        Cells of each row, as many as columns.
    notes
        Sentences below the Markdown.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


def comparison_table(
    name: str,
    title: str,
    scores: Mapping[str, Mapping[Case, Score]],
    *,
    cases: Sequence[Case],
    missing: Mapping[str, str] | None = None,
    notes: Sequence[str] = (),
) -> Table:
    """Table with one row for each case and one column for each metric and method, then mean and standard deviation.

    Parameters
    ----------
    name, title, notes
        See `Table`.
    scores
        Metrics by method and case; an absent or undefined one becomes NaN and is left out of mean and standard
        deviation.
    cases
        Cases of the rows, in order.
    missing
        Methods that could not run and why; each gets a note and empty columns.
    """
    missing = missing or {}
    methods = [*scores, *missing]
    columns = ["dataset", "point", "axis"] + [f"{metric}: {method}" for metric in METRICS for method in methods]
    values = np.full((len(cases), len(METRICS) * len(methods)), np.nan)
    for row, case in enumerate(cases):
        for number, field in enumerate(METRICS.values()):
            for column, method in enumerate(scores):
                if case in scores[method]:
                    values[row, number * len(methods) + column] = getattr(scores[method][case], field)
    rows: list[tuple[Cell, ...]] = [
        (case.dataset, case.point, case.axis, *line) for case, line in zip(cases, values.tolist(), strict=True)
    ]
    known = [column[np.isfinite(column)] for column in values.T]
    rows.append(("mean", "", "", *(float(np.mean(column)) if column.size else np.nan for column in known)))
    # The paper's tables agree with the standard deviation of the rows themselves, divided by their number.
    rows.append(("std", "", "", *(float(np.std(column)) if column.size else np.nan for column in known)))
    unable = [*_note_incomplete(scores), *(f"{method} could not run: {why}" for method, why in missing.items())]
    return Table(name, title, tuple(columns), tuple(rows), (*notes, *unable))


def _note_incomplete(scores: Mapping[str, Mapping[Case, Score]]) -> list[str]:
    """Cases that were scored on clearly fewer samples than the field test has."""
    most: dict[str, int] = {}
    for by_case in scores.values():
        for case, score in by_case.items():
            most[case.dataset] = max(most.get(case.dataset, 0), score.samples)
    return [
        f"{case.dataset}, {case.point}, {case.axis}: {method} on {score.samples} of {most[case.dataset]} samples only"
        for method, by_case in scores.items()
        for case, score in by_case.items()
        if score.samples < _WHOLE * most[case.dataset]
    ]


def write_table(folder: Path | str, table: Table) -> tuple[Path, Path]:
    """Writes ``name.csv`` (all digits) and ``name.md`` (three digits) and returns their paths.

    Parameters
    ----------
    folder
        Folder of the files.
    table
        Table to write.

    Raises
    ------
    OSError
        The folder cannot be written to.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> table = Table("means", "Means", ("method", "NRMSE"), (("with SGR", 0.15),))
    >>> with TemporaryDirectory() as folder:
    ...     csv_path, _ = write_table(folder, table)
    ...     print(csv_path.read_text())
    method,NRMSE
    with SGR,0.15
    """
    text = csv_text(table.columns, [["" if _is_nan(cell) else cell for cell in row] for row in table.rows])
    lines = [f"# {table.title}", "", _format_row(table.columns), _format_row(["---"] * len(table.columns))]
    lines += [_format_row([_format_cell(cell) for cell in row]) for row in table.rows]
    lines += ["", *(f"- {note}" for note in table.notes)] if table.notes else []
    paths = Path(folder) / f"{table.name}.csv", Path(folder) / f"{table.name}.md"
    for path, content in zip(paths, (text, "\n".join(lines) + "\n"), strict=True):
        write_file(path, content)
    return paths


def _format_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def _format_cell(cell: Cell) -> str:
    if isinstance(cell, str):
        return cell
    return "-" if _is_nan(cell) else f"{cell:.3f}"


def _is_nan(cell: Cell) -> bool:
    return isinstance(cell, float) and bool(np.isnan(cell))
