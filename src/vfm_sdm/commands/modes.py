"""The command ``modes``: frequencies, damping and shapes of a measured structure."""

from pathlib import Path
from typing import Annotated

import xarray as xr
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.modal import ModalOptions, identify_modes, write_modes
from vfm_sdm.commands.runs import about_run, alone_in_run, read_run, save_figure
from vfm_sdm.commands.terminal import OUT, fail, note, number_text, plain_table, say
from vfm_sdm.core.datasets import IMAGE_PLANE
from vfm_sdm.core.files import write_file
from vfm_sdm.outputs.plots import About
from vfm_sdm.outputs.plots.modes import animate_mode, draw_shapes, draw_stabilisation
from vfm_sdm.outputs.results.universal_modes import trace_order, write_modes_uff

__all__ = ["modes"]

_OPTIONS = ModalOptions()


@alone_in_run
def modes(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    *,
    axis: Annotated[
        tuple[str, ...], Parameter(help="Axis that counts; name it again for more. All that were measured by default.")
    ] = (),
    band: Annotated[
        tuple[float, float] | None,
        Parameter(
            help="Band in Hz, low and high; by default from 8 periods in the record, at least 0.2 Hz, to 0.4 of "
            "the frame rate."
        ),
    ] = None,
    most: Annotated[int, Parameter(help="Modes at most; of more, the clearest.")] = _OPTIONS.most_modes,
    order: Annotated[int, Parameter(help="Highest order of the model.")] = _OPTIONS.most_order,
    animate: Annotated[bool, Parameter(help="Write a film of every mode (GIF).")] = True,
) -> None:
    """Find the modes of a structure: frequency, damping and shape, each with the interval that holds it with 95 %.

    Writes modes.nc, modes.csv, modes.uff and figures/modes*.png, mode_N.gif into the run folder, where `vfm-sdm report`
    finds them. Needs the extra `modal`.
    """  # fmt: skip
    displacement, notes = read_run(run)
    about = about_run(run)
    options = ModalOptions(axis or None, band, most, order)
    found = identify_modes(displacement, options, static=about.static)
    low, high = found.attrs["band_hz"]
    say(
        f"{found.attrs['channels']} channels along {found.attrs['axes']}, {found.attrs['duration_s']:.1f} s at "
        f"{found.attrs['sampling_rate_hz']:.4g} Hz, band {low:.3g} to {high:.3g} Hz, order up to "
        f"{found.attrs['highest_order']}; {found.attrs['detrending']}"
    )
    OUT.print(_tabulate(found))
    note([*notes, *_notes(found)])
    written = [*write_modes(run, found), *_draw(run, found, about, animate=animate)]
    say(f"written: {', '.join(map(str, written))}")
    if not found.sizes["mode"]:
        fail("no mode is clear of noise: record longer, nearer, or when the structure moves more")


def _tabulate(found: xr.Dataset) -> Table:
    table = plain_table("Modes, with 95 % intervals")
    for column in ("mode", "Hz", "from", "to", "damping %", "from", "to", "MPC", "rms mm"):
        table.add_column(Text(column), justify="right", overflow="fold")
    table.add_column(Text("status"), overflow="fold", min_width=9)
    for mode in found["mode"].values:
        one = found.sel(mode=mode)
        table.add_row(
            str(int(mode)),
            *(number_text(float(one[f"frequency{end}"]), "{:.3f}") for end in ("", "_low", "_high")),
            *(number_text(float(one[f"damping_ratio{end}"]), "{:.2f}", 100) for end in ("", "_low", "_high")),
            number_text(float(one["collinearity"]), "{:.2f}"),
            number_text(float(one["rms"]), "{:.3f}"),
            str(one["status"].item()),
        )
    return table


def _notes(found: xr.Dataset) -> list[str]:
    left = [f"{one['frequency_hz']:.3f} Hz ({one['reason']})" for one in found.attrs["left_out"]]
    notes = [f"left out: {', '.join(left)}"] if left else []
    if len(trace_order(found["position"].transpose("point", "axis").values)) < 2:
        notes.append("the places of the points are not known: shapes are drawn by point, and there are no films")
    used, asked = found.attrs["highest_order"], found.attrs["order_asked"]
    if used < asked - asked % 2:
        notes.append(f"the order of the model is {used} at most, not {asked}: channels and record allow no more")
    if found.attrs["frame"] == IMAGE_PLANE:
        notes.append(
            "one view: modes are those of the motion in the picture; what moves towards the camera is not seen"
        )
    if found.attrs["filled_share"] > 0:
        notes.append(
            f"{100 * found.attrs['filled_share']:.1f} % of samples were not ok and were filled by straight lines"
        )
    return notes


def _draw(run: Path, found: xr.Dataset, about: About, *, animate: bool) -> list[Path]:
    """Figures, films and the universal file of the modes."""
    pictures = {"modes": draw_stabilisation(found, about)}
    if found.sizes["mode"]:
        pictures["modes_shapes"] = draw_shapes(found, about)
    written = [save_figure(figure, run, name) for name, figure in pictures.items()]
    if not found.sizes["mode"]:
        return written
    written.append(write_modes_uff(run / "modes.uff", found))
    if animate and len(trace_order(found["position"].transpose("point", "axis").values)) > 1:
        written += [
            write_file(run / "figures" / f"mode_{mode}.gif", animate_mode(found.sel(mode=mode), about))
            for mode in found["mode"].values
        ]
    return written
