"""The command ``vfm-sdm``: each command parses, calls one library function, and prints a short summary."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import cyclopts
from cyclopts import Parameter
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from vfm_sdm import __version__, reports
from vfm_sdm.demo import run_demo
from vfm_sdm.environment import describe_environment
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.measurement import Run, measure
from vfm_sdm.pipeline import Progress as Callback
from vfm_sdm.results import write_mat, write_uff
from vfm_sdm.session import read_session

__all__ = ["app", "main"]

app = cyclopts.App(
    name="vfm-sdm",
    help="Structural displacement in millimetres from two ordinary cameras and one measured length.",
    version=__version__,
)

_SessionFile = Annotated[Path, Parameter(help="The session's file; docs/session.md explains it.")]
_Output = Annotated[Path, Parameter(name=["--output", "-o"], help="Run folder to write to.")]

_EXPORTS = {"mat": write_mat, "uff": write_uff}

_out = Console()
_err = Console(stderr=True)


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: runs a command; an expected error ends with status 1 and its message alone.

    Parameters
    ----------
    words
        The command line without the program's name; that of the process when ``None``.
    """
    try:
        app(words)
    except VfmSdmError as error:
        _err.print(f"vfm-sdm: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)
    except KeyboardInterrupt:
        _err.print("vfm-sdm: interrupted; finished stages are kept and the next run reuses them")
        sys.exit(130)


@app.command
def demo(output: Annotated[Path, Parameter(help="Folder to write to.")] = Path("vfm-sdm-demo")) -> None:
    """Make a synthetic recording of a footbridge, measure it, and compare with the truth."""
    with _progress() as progress:
        result = run_demo(output, progress=progress)
    for part in reports.measurement_report(result.measurement):
        _out.print(part)
    _out.print(reports.truth_table(result))
    _out.print(f"written: {result.run_folder} (figures in {result.run_folder / 'figures'})")


@app.command(name="measure")
def measure_command(
    session: _SessionFile,
    *,
    output: _Output,
    export: Annotated[
        tuple[Literal["mat", "uff"], ...], Parameter(help="Also write displacement.mat or displacement.uff (UFF 58).")
    ] = (),
) -> None:
    """Measure a session: from recordings to displacement in millimetres, with figures and summary.

    Finished stages in the run folder are reused unless their inputs changed.
    """
    settings = read_session(session)
    with _progress() as progress:
        result = measure(settings, output, progress=progress)
    for part in reports.measurement_report(result):
        _out.print(part)
    _out.print(f"written: {output} (figures in {output / 'figures'})")
    if result.displacement is None:
        _fail(f"no displacement: {result.cameras.status}")
    for form in export:
        _out.print(f"written: {_EXPORTS[form](output, result.displacement)}")


@app.command
def cameras(session: _SessionFile, *, output: _Output) -> None:
    """Only cameras, axes and the points' places in every view: writes cameras.toml."""
    settings = read_session(session)
    with _progress() as progress:
        solution = Run(settings, output, progress).cameras()
    for part in reports.camera_report(solution):
        _out.print(part)
    _out.print(f"written: {output / 'cameras.toml'}")


@app.command
def track(session: _SessionFile, *, output: _Output) -> None:
    """Follow the points in every view: writes cameras.toml and tracks.nc. Works with a single view, too."""
    settings = read_session(session)
    with _progress() as progress:
        run = Run(settings, output, progress)
        tracks = run.tracks(run.cameras())
    _out.print(reports.track_table(tracks))
    _out.print(f"written: {output / 'tracks.nc'}")


@app.command
def displacement(session: _SessionFile, *, output: _Output) -> None:
    """Triangulate finished tracks: writes displacement.nc and displacement.csv."""
    settings = read_session(session)
    with _progress() as progress:
        run = Run(settings, output, progress)
        solution = run.cameras()
        result = run.displacement(solution, run.tracks(solution))
    if result is None:
        _fail(f"no displacement: {solution.status}")
    _out.print(reports.displacement_table(result))
    _out.print(f"written: {output / 'displacement.nc'}, {output / 'displacement.csv'}")


@app.command
def info() -> None:
    """Versions, processors, codecs, and which back ends can run here and why others cannot."""
    for name, lines in describe_environment().items():
        _out.print(f"[bold]{name}[/bold]")
        for line in lines:
            _out.print(f"  {line}", markup=False, highlight=False)


def _fail(reason: str) -> NoReturn:
    """Ends with status 3: the input was right, the data did not allow a result."""
    _err.print(f"vfm-sdm: {reason}", style="red", markup=False, highlight=False, soft_wrap=True)
    sys.exit(3)


@contextmanager
def _progress() -> Iterator[Callback]:
    """A progress bar on the terminal, one line for each thing done; silent where output is not a terminal."""
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=_err, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: int, total: int | None) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield show
