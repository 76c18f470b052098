"""The command ``benchmark``: the paper's protocol on virtual field tests."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import OUT, number_text, plain_table, say
from vfm_sdm.studies.protocol import Benchmark, run_benchmark
from vfm_sdm.studies.protocol import Table as ProtocolTable
from vfm_sdm.studies.synthetic.presets import PRESETS, PresetName

__all__ = ["benchmark_command"]

_CASE_COLUMNS, _SUMMARY_ROWS = 3, 2
"""Columns that name a case, and rows of mean and standard deviation at the end of a table."""


def benchmark_command(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder to write to.")],
    size: Annotated[
        Literal["small", "full"], Parameter(help="small: minutes; full: 4K, 16 s, an hour or two.")
    ] = "small",
    data: Annotated[tuple[PresetName, ...], Parameter(help="Field tests; all when left out.")] = PRESETS,
    sensitivity: Annotated[bool, Parameter(help="Also study how errors grow as conditions get worse.")] = True,
) -> None:
    """The paper's protocol on virtual field tests: every table and figure, against truth and accelerometers.

    What is finished in the folder is not done again, so a run that was cut short goes on where it was.
    """
    with show_progress() as progress:
        result = run_benchmark(output, size=size, names=data, sensitivity=sensitivity, progress=progress)
    for table in _tabulate(result):
        OUT.print(table)
    say(f"written: {output / 'README.md'}, tables and figures beside it; {result.seconds / 60:.1f} min")


def _tabulate(benchmark: Benchmark) -> Iterator[RenderableType]:
    """Every case with SGR against truth and against the accelerometers; field tests outside the assumptions apart."""
    for against in ("truth", "accelerometers"):
        title = Text(f"Protocol, with SGR, against {against}")
        yield _score_table(title, benchmark.tables[f"refinement_against_{against}"], ": with SGR")
    outside = benchmark.tables["outside_assumptions"]
    if len(outside.rows) > _SUMMARY_ROWS:
        yield _score_table(Text(outside.title, style="red"), outside, ": with SGR")


def _score_table(title: Text, source: ProtocolTable, suffix: str) -> Table:
    table = plain_table(title)
    chosen = [n for n, name in enumerate(source.columns) if n < _CASE_COLUMNS or name.endswith(suffix)]
    for n in chosen:
        name = source.columns[n].removesuffix(suffix)
        table.add_column(Text(name), justify="left" if n < _CASE_COLUMNS else "right", no_wrap=n < _CASE_COLUMNS)
    for row in source.rows:
        table.add_row(*(c if isinstance(c := row[n], str) else number_text(c, "{:.3f}") for n in chosen))
    return table
