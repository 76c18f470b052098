"""The command ``field``: displacement of the whole structure along its length, from many points together."""

from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.field import NOT_OF_STRUCTURE, compute_field, extreme_times, write_field
from vfm_sdm.commands.runs import alone_in_run, read_run, save_figure
from vfm_sdm.commands.terminal import OUT, note, number_text, plain_table, say
from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.core.constants import NORMAL_95
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.errors import DatasetError, VfmSdmError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.plots import About, describe_run
from vfm_sdm.outputs.plots.animation import FieldPicture, write_gif, write_mp4
from vfm_sdm.outputs.plots.field import draw_field, draw_heat_map
from vfm_sdm.outputs.results.kept import CAMERAS
from vfm_sdm.outputs.results.vtk import write_vtk
from vfm_sdm.stages.cameras.solution import read_solution

__all__ = ["field_command"]

_LINES = 9
"""Stations that the table lists."""
_NAMED = 8


@alone_in_run
def field_command(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    *,
    axis: Annotated[str, Parameter(help="Axis of the table and the figures; the files hold all.")] = "vertical",
    stations: Annotated[int, Parameter(help="Places along the structure.")] = 61,
    time: Annotated[
        tuple[float, ...],
        Parameter(help="Times of the lines [s]; those of the largest deflections when left out.", show_default=False),
    ] = (),
    animation: Annotated[bool, Parameter(help="Write field.mp4 and field.gif, and field.pvd for ParaView.")] = True,
) -> None:
    """Deflection line of the structure at every time, with its uncertainty, from all points together.

    Writes field.nc, field.csv and figures/field.png into the run folder, where `vfm-sdm report` finds them; over the
    first frame, figures/field_map.png and the magnified motion as field.mp4 and field.gif; and field.pvd for ParaView.
    """
    displacement, notes = read_run(run, axis)
    last = float(displacement["time"].values[-1])
    if any(not 0 <= one <= last for one in time):
        got = ", ".join(map(str, time))
        raise DatasetError(f"--time: expected times from 0 to {last:.2f} s, got {got}; correct them")
    session = read_session(run / SESSION, check_files=False)
    field = compute_field(
        displacement,
        static=[point.name for point in session.point if point.static],
        stations=stations,
        still_interval_s=session.method.still_interval_s,
    )
    times_s = list(time) or extreme_times(field, axis)
    for line in times_s:
        OUT.print(_tabulate(field.sel(time=line, method="nearest"), axis))
    _say_points(field, axis)
    note(notes)
    about = describe_run(session, None)
    figure = draw_field(field, displacement, axis, times_s, about)
    written = [*write_field(run, field, times_s), save_figure(figure, run, "field")]
    if animation:
        written.append(write_vtk(run, field))
    try:
        picture = Measurement(session).frames[session.reference_view.name]
    except VfmSdmError as error:
        note([f"nothing is drawn over the first frame: {error}"])
    else:
        written += _draw_over(run, field, picture, (axis, about), animation=animation)
    say(f"written: {', '.join(map(str, written))}")


def _draw_over(
    run: Path, field: xr.Dataset, picture: LumaArray, shown: tuple[str, About], *, animation: bool
) -> list[Path]:
    """Heat map and animation over the first frame of the reference view; their paths."""
    cameras, _ = read_solution(run / CAMERAS.file)
    if cameras.rig is None or cameras.frame is None:
        return []
    camera, rotation = cameras.rig.cameras[0], cameras.frame.rotation
    places = field["point_place"].transpose("point", "axis").values
    written = [save_figure(draw_heat_map(field, picture, camera.project(places @ rotation), *shown), run, "field_map")]
    if animation:
        used = field["used"].values.astype(bool).any(axis=1)
        moving = FieldPicture.of(picture, camera, places[used], rotation)
        times = field["time"].values
        fps = float(np.clip((len(times) - 1) / (times[-1] - times[0]), 1, 60))
        factor = moving.magnification(field)
        written.append(write_mp4(run / "field.mp4", moving.frames(field, factor), fps))
        written.append(write_gif(run / "field.gif", moving.frames(field, factor), fps))
    return written


def _tabulate(frame: xr.Dataset, axis: str) -> Table:
    """The line at one time, at some stations."""
    table = plain_table(f"Deflection line at {float(frame['time']):.2f} s in mm, {axis}; +- 95 %")
    for column in ("station [m]", "mm", "+-", "common +-"):
        table.add_column(Text(column), justify="right")
    one = frame.sel(axis=axis)
    for row in np.unique(np.linspace(0, one.sizes["station"] - 1, _LINES).round().astype(int)):
        here = one.isel(station=row)
        table.add_row(
            f"{float(here['station']):.2f}",
            number_text(float(here["displacement"]), "{:.3f}"),
            *(number_text(float(here[name]), "{:.3f}", NORMAL_95) for name in ("displacement_std", "common_std")),
        )
    return table


def _say_points(field: xr.Dataset, axis: str) -> None:
    """How many points the field rests on, which are left out, and what was found of their errors."""
    reasons = {
        str(name): str(why)
        for name, why in zip(field["point"].values, field["reason"].values, strict=True)
        if why and why != NOT_OF_STRUCTURE
    }
    one = field.sel(axis=axis)
    shared = 100 * float(one["correlated_share"])
    alike = f"; {shared:.0f} % of that is alike within {float(one['correlation_length']):.2f} m" if shared >= 1 else ""
    say(f"points: {int(one['used'].sum())} used, {len(reasons)} left out along one axis or all")
    say(
        f"a single point errs by {float(one['point_std']):.3f} mm and "
        f"{100 * float(one['gain_scatter']):.1f} % of its motion (standard deviation){alike}"
    )
    by_reason: dict[str, list[str]] = {}
    for name, why in reasons.items():
        # Along which axis each departs stands in field.nc.
        by_reason.setdefault(why.partition(":")[0], []).append(name)
    for why, names in by_reason.items():
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        note([f"left out: {', '.join(names[:_NAMED])}{more}: {why}"])
    frequencies = [value for value in one["shape_frequency"].values.tolist() if np.isfinite(value)]
    if frequencies:
        say(f"shapes in which it moved: {', '.join(f'{value:.2f} Hz' for value in frequencies)}")
