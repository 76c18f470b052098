"""The command ``fuse``: one displacement from standstill to a sensor's band, of video and accelerometer."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.fusion import (
    FusionSettings,
    fuse,
    read_session_acceleration,
    search_about_start,
    write_fusion,
)
from vfm_sdm.commands.runs import alone_in_run, read_run, save_figure
from vfm_sdm.commands.terminal import OUT, fail, note, number_text, plain_table, say
from vfm_sdm.core.constants import NORMAL_95
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.core.statuses import FusionStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.outputs.plots import describe_run
from vfm_sdm.outputs.plots.fusion import draw_fusion

__all__ = ["fuse_command"]


@alone_in_run
def fuse_command(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    *,
    sensor: Annotated[str, Parameter(help="Name of an accelerometer, a [[sensor]] of the session.")],
    axis: Annotated[tuple[str, ...], Parameter(help="Axis to fuse; again for each. All of the sensor else.")] = (),
    session: Annotated[
        Path | None, Parameter(help="Session file that names the sensor, where that of the run does not.")
    ] = None,
    search: Annotated[
        float | None,
        Parameter(help="Seconds around --start-lag in which the lag is searched; 5, or 2 by start times."),
    ] = None,
    start_lag: Annotated[
        float | None,
        Parameter(
            help="How much later the sensor's clock shows an event, in seconds, as far as known; by the start times of "
            "video and sensor where the session has both, else 0."
        ),
    ] = None,
) -> None:
    """Fuse a point's displacement with an accelerometer: from standstill to the sensor's band, at the sensor's rate.

    Writes fused.nc, fused.csv and figures/fused.png into the run folder, where `vfm-sdm report` finds them.
    """
    displacement, notes = read_run(run)
    file = session or run / SESSION
    if not file.is_file():
        raise SessionError(f"{file}: expected a session that names the sensor, got none; name it with --session")
    known = read_session(file, check_files=False)
    acceleration, point = read_session_acceleration(known, sensor)
    settings = FusionSettings()
    if search is not None or start_lag is not None:
        about = search_about_start(displacement, acceleration, start_lag_s=start_lag)
        settings = FusionSettings(search=about if search is None else replace(about, search_s=search))
    static = [one.name for one in known.point if one.static]
    fused = fuse(displacement, acceleration, point, axes=axis, static=static, settings=settings)
    if fused.attrs["status"] != FusionStatus.OK:
        note((*notes, *fused.attrs["notes"]))
        fail(f"no fusion: {fused.attrs['status']}; see docs/fuse.md")
        return
    OUT.print(_tabulate(fused))
    note((*notes, *fused.attrs["notes"]))
    figure = draw_fusion(displacement, fused, describe_run(known, None))
    written = [*write_fusion(run, fused), save_figure(figure, run, "fused")]
    say(f"written: {', '.join(map(str, written))}")


def _tabulate(fused: xr.Dataset) -> Table:
    """What was found of sensor and video along every axis."""
    low, high = fused.attrs["band_hz"]
    title = (
        f"{fused.attrs['point']} with {fused.attrs['sensor']}: {low:g} to {high:.0f} Hz, "
        f"{fused.attrs['sampling_rate_hz']:.0f} values a second; +- 95 %"
    )
    table = plain_table(title)
    axes = [str(axis) for axis in fused["axis"].values]
    table.add_column("quantity")
    for axis in axes:
        table.add_column(Text(axis), justify="right")
    rows = (
        ("lag [ms]", "lag", "lag_std", 1e3, "{:.2f}"),
        ("gain, video over sensor", "gain", "gain_std", 1.0, "{:.4f}"),
        ("bias of the sensor [m/s2]", "bias", None, 1.0, "{:.3f}"),
        ("innovation, RMS [mm]", "innovation_rms", None, 1.0, "{:.4f}"),
        ("noise of the video alone [mm]", "video_std", None, 1.0, "{:.4f}"),
    )
    for words, name, std, factor, form in rows:
        cells = [number_text(float(fused[name].sel(axis=axis)), form, factor) for axis in axes]
        if std is not None:
            spreads = [number_text(float(fused[std].sel(axis=axis)), form, factor * NORMAL_95) for axis in axes]
            cells = [f"{cell} +- {spread}" for cell, spread in zip(cells, spreads, strict=True)]
        table.add_row(Text(words), *cells)
    for words, chosen in (("noise, fused [mm]", 0), ("noise, bridged [mm]", 1)):
        kept = fused["displacement_std"].where(fused["status"] == chosen)
        spread = [float(kept.sel(axis=axis).median()) for axis in axes]
        if chosen == 0 or np.isfinite(spread).any():
            table.add_row(Text(words), *(number_text(value, "{:.4f}") for value in spread))
    return table
