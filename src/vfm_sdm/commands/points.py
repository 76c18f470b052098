"""The commands ``points``: places that are worth measuring."""

from pathlib import Path
from typing import Annotated

import cyclopts
import numpy as np
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import OUT, fail, note, plain_table, say, say_rest, shown_rows
from vfm_sdm.errors import CameraError, DatasetError, SessionError
from vfm_sdm.inputs.session import read_session, write_session
from vfm_sdm.studies.planning.suggested_picture import write_picture
from vfm_sdm.studies.planning.suggestion import Suggestion, suggest_points

__all__ = ["points"]

points = cyclopts.App(name="points", help="Points of a session: find places that are worth measuring.")


@points.command
def suggest(
    session: Annotated[Path, Parameter(help="A session's file, with or without points; docs/points.md.")],
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="Session file to write, with a picture beside it.")
    ],
    count: Annotated[int, Parameter(help="Points on the structure.")] = 8,
    static: Annotated[int, Parameter(help="Points on still background.")] = 3,
) -> None:
    """Find the best places on the structure, spread along the span, and on still background: no clicks."""
    settings = read_session(session, points_needed=False)
    if output.resolve() == session.resolve():
        raise SessionError(f"{output}: expected another file than the session, whose comments would be lost; name one")
    try:
        with show_progress() as progress:
            found = suggest_points(settings, count=count, static=static, progress=progress)
    except (CameraError, DatasetError) as error:
        # The input was right, the pictures did not allow a result.
        fail(error)
    OUT.print(_tabulate(found))
    note(found.notes)
    written = write_session(output, found.session)
    picture = write_picture(output.with_suffix(".png"), found)
    say(f"written: {written}, {picture}")


def _tabulate(found: Suggestion) -> Table:
    """The points with what they should measure."""
    title = "Suggested points; std and expanded uncertainty U (k = 2) of a sample: lateral, vertical, longitudinal"
    table = plain_table(title)
    for name in ("point", "along [m]", "std [mm]", "U [mm]", "subset", "why"):
        words = name in ("point", "why")
        table.add_column(Text(name), justify="left" if words else "right", overflow="fold", no_wrap=not words)
    for one in found.points[: shown_rows(len(found.points))]:
        std, expanded = (_join(values) for values in (one.std_mm, one.expanded_mm))
        subset = str(one.subset_px) if one.subset_px else "-"
        table.add_row(Text(one.name), f"{one.along_m:.2f}", std, expanded, subset, Text(one.why))
    return say_rest(table, len(found.points), "what --json prints")


def _join(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """Values of three axes in one cell, with two digits."""
    return " ".join("-" if not np.isfinite(value) else f"{value:.3f}" for value in values)
