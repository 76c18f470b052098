"""The commands ``measure``, ``cameras``, ``track`` and ``displacement``: a session as far as its results are wanted."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Literal

import xarray as xr
from cyclopts import Parameter

from vfm_sdm.commands import tables
from vfm_sdm.commands.options import WorkerOptions
from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import ERR, OUT, Ending, fail, say
from vfm_sdm.core.registry import find
from vfm_sdm.core.statuses import Verdict
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.outputs.results import first_cause, write_export, write_movement

__all__ = ["cameras", "displacement", "measure_command", "track"]

_SessionFile = Annotated[Path, Parameter(help="The session's file; docs/session.md explains it.")]
_Output = Annotated[Path, Parameter(name=["--output", "-o"], help="Run folder to write to.")]
_WholeFiles = Annotated[
    bool, Parameter(negative="", help="Hash large recordings as a whole, not by size, time stamp and samples.")
]

_MOVEMENT = "movement"
"""Export of tracks; all others are of displacement."""

_WORKERS = WorkerOptions()


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
    # All files before the first word: who reads the words may stop listening.
    written = [f"{output} (figures in {output / 'figures'})"]
    if _MOVEMENT in export:
        written.append(", ".join(map(str, write_movement(output, result.tracks))))
    cause = first_cause(result.cameras, result.tracks, result.displacement)
    if result.displacement is not None and not cause:
        if csv_every > 1:
            write_export("csv", output, result.displacement.isel(time=slice(None, None, csv_every)))
        written += [str(write_export(form, output, result.displacement)) for form in of_displacement]
    for part in tables.measurement_report(result):
        OUT.print(part)
    for one in written:
        say(f"written: {one}")
    if cause:
        fail(f"no sample is ok: {cause}")
    if result.audit is not None and result.audit.verdict is Verdict.REFUSED:
        sys.exit(Ending.REFUSED)


def cameras(session: _SessionFile, *, output: _Output, whole_files: _WholeFiles = False) -> None:
    """Only cameras, axes and the points' places in every view: writes cameras.toml."""
    settings = read_session(session)
    with show_progress() as progress:
        solution = Measurement(settings, output, progress=progress, whole_files=whole_files).run("cameras").cameras
    for part in tables.camera_report(solution):
        OUT.print(part)
    say(f"written: {output / 'cameras.toml'}")


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
    OUT.print(tables.track_table(tracks))
    written = [output / "tracks.nc", *(write_movement(output, tracks) if export else ())]
    say(f"written: {', '.join(map(str, written))}")


def displacement(
    session: _SessionFile, *, output: _Output, whole_files: _WholeFiles = False, work: WorkerOptions = _WORKERS
) -> None:
    """Only displacement, without audit and figures: writes displacement.nc and displacement.csv."""
    settings = read_session(session)
    with show_progress() as progress, work.executor() as executor:
        measurement = Measurement(settings, output, progress=progress, whole_files=whole_files, executor=executor)
        result = measurement.run("displacement").displacement
    if result is None:
        fail(f"no displacement: {measurement.cameras.status}")
    OUT.print(tables.displacement_table(result))
    say(f"written: {output / 'displacement.nc'}, {output / 'displacement.csv'}")


def _forecast(output: Path) -> Callable[[Mapping[str, xr.Dataset]], None] | None:
    """Prints what the points should measure, unless an earlier run in this folder has done so."""
    return None if (output / "tracks.nc").exists() else lambda expected: ERR.print(tables.expectation_table(expected))
