"""The command ``vfm-sdm``: each command parses, calls one library function, and prints a short summary."""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import cyclopts
import xarray as xr
from cyclopts import Parameter
from rich.console import Console
from rich.prompt import Confirm

from vfm_sdm import __version__
from vfm_sdm.analysis.evaluation import evaluate_run, read_sensors, write_evaluation, write_reference
from vfm_sdm.commands import tables as reports
from vfm_sdm.commands.acceptance import accept, verify
from vfm_sdm.commands.batch import batch_command
from vfm_sdm.commands.demo import run_demo
from vfm_sdm.commands.environment import describe_environment
from vfm_sdm.commands.frames import frames
from vfm_sdm.commands.lens import lens
from vfm_sdm.commands.options import ClockOptions, RecipeOptions, WorkerOptions, name_values
from vfm_sdm.commands.page import page_command
from vfm_sdm.commands.planning import plan
from vfm_sdm.commands.points import points
from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.report import report
from vfm_sdm.commands.terminal import Ending, Terminal, as_json
from vfm_sdm.commands.watch import watch
from vfm_sdm.core.registry import find
from vfm_sdm.core.sensor_datasets import SensorUnits
from vfm_sdm.core.statuses import Verdict
from vfm_sdm.errors import SessionError, VfmSdmError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import fetch_weights, is_licence_accepted, local_weights, weights_folder
from vfm_sdm.outputs.results import first_cause, write_export, write_movement
from vfm_sdm.studies.protocol import run_benchmark
from vfm_sdm.studies.synthetic.presets import PRESETS, PresetName

__all__ = ["app", "main"]

app = cyclopts.App(
    name="vfm-sdm",
    help="Structural displacement in millimetres from two ordinary cameras and one measured length.\n\n"
    "Every command takes --json: its tables are one JSON object then. Exit status: 0 done, 1 the input cannot be used "
    "or a test was not passed, 3 the data did not allow a result, 4 the audit says not to use the result, 130 "
    "interrupted.",
    version=__version__,
    # Nobody needs a word for an empty list.
    default_parameter=Parameter(negative_iterable=()),
    # Else its message would be swallowed.
    suppress_keyboard_interrupt=False,
)

weights = cyclopts.App(name="weights", help="Checkpoints of the vision foundation models: list and fetch them.")
app.command(weights)
app.command(batch_command, name="batch")
app.command(page_command, name="page")
app.command(accept)
app.command(verify)
app.command(report)
app.command(frames)
app.command(lens)
app.command(plan)
app.command(points)
app.command(watch)

_SessionFile = Annotated[Path, Parameter(help="The session's file; docs/session.md explains it.")]
_Output = Annotated[Path, Parameter(name=["--output", "-o"], help="Run folder to write to.")]
_WholeFiles = Annotated[
    bool, Parameter(negative="", help="Hash large recordings as a whole, not by size, time stamp and samples.")
]

_MOVEMENT = "movement"
"""Export of tracks; all others are of displacement."""

_RECIPE, _CLOCK, _WORKERS = RecipeOptions(), ClockOptions(), WorkerOptions()

_out = Terminal()
_err = Console(stderr=True, markup=False)


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: runs a command; an expected error ends with status 1 and its message alone, Ctrl-C with 130.

    Parameters
    ----------
    words
        The command line without the program's name; that of the process when ``None``.
    """
    typed = list(sys.argv[1:] if words is None else words)
    # These two have a form of their own.
    asked = "--json" in typed and not {"batch", "watch"} & {*typed[:2]}
    try:
        with as_json() if asked else nullcontext():
            app([word for word in typed if word != "--json"] if asked else typed)
    except VfmSdmError as error:
        _err.print(f"vfm-sdm: {error}", style="red", highlight=False, soft_wrap=True)
        sys.exit(Ending.ERROR)
    except KeyboardInterrupt:
        _err.print("vfm-sdm: interrupted; finished stages are kept and the next run reuses them")
        sys.exit(Ending.INTERRUPTED)


@app.command
def demo(output: Annotated[Path, Parameter(help="Folder to write to.")] = Path("vfm-sdm-demo")) -> None:
    """Make a synthetic recording of a footbridge, measure it, and compare with the truth."""
    with show_progress() as progress:
        result = run_demo(output, progress=progress)
    for part in reports.measurement_report(result.measurement):
        _out.print(part)
    if result.evaluation is not None:
        _out.print(reports.evaluation_table(result.evaluation))
    _say(f"written: {result.run_folder} (figures in {result.run_folder / 'figures'})")


@app.command(name="measure")
def measure_command(
    session: _SessionFile,
    *,
    output: _Output,
    export: Annotated[
        tuple[str, ...],
        Parameter(
            negative="",
            help="Also write displacement.mat, displacement.uff, or what other packages write (again for each); "
            "movement: tracks as movement_VIEW.nc, for the package movement or plain xarray.",
        ),
    ] = (),
    csv_every: Annotated[
        int, Parameter(help="Write every N-th frame to displacement.csv; the netCDF file has all of them.")
    ] = 1,
    whole_files: _WholeFiles = False,
    work: WorkerOptions = _WORKERS,
) -> None:
    """Measure a session: from recordings to displacement in millimetres, with figures and summary.

    Finished stages and tracked segments in the run folder are reused unless their inputs changed.
    """
    settings = read_session(session)
    if csv_every < 1:
        raise SessionError(f"--csv-every: expected 1 or more, got {csv_every}; leave it out to write every frame")
    of_displacement = [form for form in export if form != _MOVEMENT]
    for form in of_displacement:
        find("writers", form)  # before any work is done
    with show_progress() as progress, work.executor() as executor:
        result = measure(
            settings,
            output,
            progress=progress,
            whole_files=whole_files,
            executor=executor,
            forecast=_forecast(output),
        )
    for part in reports.measurement_report(result):
        _out.print(part)
    _say(f"written: {output} (figures in {output / 'figures'})")
    if _MOVEMENT in export:
        _say(f"written: {', '.join(map(str, write_movement(output, result.tracks)))}")
    if result.displacement is not None:
        if csv_every > 1:
            write_export("csv", output, result.displacement.isel(time=slice(None, None, csv_every)))
        for form in of_displacement:
            _say(f"written: {write_export(form, output, result.displacement)}")
    if cause := first_cause(result.cameras, result.tracks, result.displacement):
        _fail(f"no sample is ok: {cause}")
    if result.audit is not None and result.audit.verdict is Verdict.REFUSED:
        sys.exit(Ending.REFUSED)


@app.command
def cameras(session: _SessionFile, *, output: _Output, whole_files: _WholeFiles = False) -> None:
    """Only cameras, axes and the points' places in every view: writes cameras.toml."""
    settings = read_session(session)
    with show_progress() as progress:
        solution = Measurement(settings, output, progress=progress, whole_files=whole_files).run("cameras").cameras
    for part in reports.camera_report(solution):
        _out.print(part)
    _say(f"written: {output / 'cameras.toml'}")


@app.command
def track(
    session: _SessionFile,
    *,
    output: _Output,
    export: Annotated[
        tuple[Literal["movement"], ...],
        Parameter(negative="", help="Also write movement_VIEW.nc, for the package movement or plain xarray."),
    ] = (),
    whole_files: _WholeFiles = False,
    work: WorkerOptions = _WORKERS,
) -> None:
    """Follow the points in every view: writes cameras.toml, points.nc and tracks.nc. Works with a single view, too."""
    settings = read_session(session)
    with show_progress() as progress, work.executor() as executor:
        measurement = Measurement(settings, output, progress=progress, whole_files=whole_files, executor=executor)
        tracks = measurement.run("tracks").tracks
    _out.print(reports.track_table(tracks))
    written = [output / "tracks.nc", *(write_movement(output, tracks) if export else ())]
    _say(f"written: {', '.join(map(str, written))}")


@app.command
def displacement(
    session: _SessionFile, *, output: _Output, whole_files: _WholeFiles = False, work: WorkerOptions = _WORKERS
) -> None:
    """Only displacement, without audit and figures: writes displacement.nc and displacement.csv."""
    settings = read_session(session)
    with show_progress() as progress, work.executor() as executor:
        measurement = Measurement(settings, output, progress=progress, whole_files=whole_files, executor=executor)
        result = measurement.run("displacement").displacement
    if result is None:
        _fail(f"no displacement: {measurement.cameras.status}")
    _out.print(reports.displacement_table(result))
    _say(f"written: {output / 'displacement.nc'}, {output / 'displacement.csv'}")


@app.command
def reference(
    *files: Annotated[Path, Parameter(help="CSV files of any usual dialect, one a sensor, on one clock.")],
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="File to write, such as reference.nc.")],
    sensor: Annotated[tuple[str, ...], Parameter(help="Name of the sensor in each file; that of the file else.")] = (),
    column: Annotated[
        tuple[str, ...],
        Parameter(
            help="Which column holds what, such as vertical=-az or 'time=t in ms'; again for each. - reverses the sign."
        ),
    ] = (),
    units: Annotated[
        SensorUnits | None, Parameter(help="Of the files' values; those of their header else, and g where it has none.")
    ] = None,
    rate: Annotated[float | None, Parameter(help="Samples a second, for files without a time column.")] = None,
    recipe: RecipeOptions = _RECIPE,
) -> None:
    """Accelerometers' recordings to reference displacement, by the paper's recipe: writes a netCDF file.

    Recordings of displacement (units mm, m, cm or um) are taken as they are.
    """
    result = read_sensors(
        files,
        sensors=sensor,
        columns=name_values(column, "--column") or None,
        units=units,
        sampling_rate_hz=rate,
        settings=recipe.settings(),
    )
    _out.print(reports.reference_table(result))
    _note(result.attrs.get("notes", ()))
    _say(f"written: {write_reference(output, result)}")


@app.command
def evaluate(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    against: Annotated[
        Path, Parameter(help="truth.nc, a file of `vfm-sdm reference`, or a sensor's CSV file that the session names.")
    ],
    *,
    pair: Annotated[tuple[str, ...], Parameter(help="point=sensor; again for each. Those of the session else.")] = (),
    axis: Annotated[tuple[str, ...], Parameter(help="Axis to compare; again for each.")] = ("lateral", "vertical"),
    band: Annotated[tuple[float, float] | None, Parameter(help="Filter both to these frequencies in Hz.")] = None,
    clock: ClockOptions = _CLOCK,
) -> None:
    """Compare a measurement with a reference: prints the figures and writes evaluation.json into the run folder."""
    result = evaluate_run(
        run,
        against,
        pairs=name_values(pair, "--pair") or None,
        axes=axis,
        band_hz=band,
        clock=clock.settings(),
    )
    _out.print(reports.evaluation_table(result))
    _note(result.notes)
    _say(f"written: {write_evaluation(run, result)}")
    if not result.scored_rows:
        _fail(f"no figures: {result.notes[-1]}")


@app.command(name="benchmark")
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
    for table in reports.benchmark_tables(result):
        _out.print(table)
    _say(f"written: {output / 'README.md'}, tables and figures beside it; {result.seconds / 60:.1f} min")


@weights.command(name="list")
def list_weights() -> None:
    """Every checkpoint: its network, size and licence, and where it lies or how to fetch it."""
    _say(f"weights in {weights_folder()}")
    _out.print(reports.weights_table())


@weights.command
def fetch(
    name: Annotated[str, Parameter(help="As `vfm-sdm weights list` names it.")],
    *,
    accept_licence: Annotated[
        bool, Parameter(negative="", help="Acknowledge the licence of these weights; remembered.")
    ] = False,
) -> None:
    """Download a checkpoint after its licence was acknowledged; a download cut short leaves nothing behind."""
    accepted = accept_licence or _acknowledged(name)
    with show_progress() as progress:
        path = fetch_weights(
            name,
            accept_licence=accepted,
            progress=lambda what, done, total: progress(
                f"{what}, MB", done // 10**6, None if total is None else total // 10**6
            ),
        )
    _say(f"here: {path}")


@app.command
def info() -> None:
    """Versions, processors, codecs, and which back ends can run here and why others cannot."""
    for name, lines in describe_environment().items():
        _out.print(name, style="bold")
        for line in lines:
            _say(f"  {line}")


def _acknowledged(name: str) -> bool:
    """Asks for the licence where a person can answer and has not yet done so."""
    if is_licence_accepted(name) or local_weights(name).is_file() or not sys.stdin.isatty():
        return False
    one = CHECKPOINTS[name]
    for line in (f"{name}: {one.size} from {one.page}", f"licence: {one.licence}, {one.licence_url}", one.remarks):
        _err.print(line, highlight=False)
    return Confirm.ask("Have you read this licence, and do you accept it?", console=_err, default=False)


def _forecast(output: Path) -> Callable[[Mapping[str, xr.Dataset]], None] | None:
    """Prints what the points should measure, unless an earlier run in this folder has done so."""
    return None if (output / "tracks.nc").exists() else lambda expected: _err.print(reports.expectation_table(expected))


def _say(line: str) -> None:
    """Prints a line as it is: the terminal's edge breaks no path."""
    _out.print(line, highlight=False, soft_wrap=True)


def _note(notes: Sequence[str]) -> None:
    """Prints what a reader must know."""
    for note in notes:
        _out.print(f"note: {note}", style="yellow", highlight=False)


def _fail(reason: str) -> NoReturn:
    """Ends with status 3: the input was right, the data did not allow a result."""
    _err.print(f"vfm-sdm: {reason}", style="red", highlight=False, soft_wrap=True)
    sys.exit(Ending.NO_RESULT)
