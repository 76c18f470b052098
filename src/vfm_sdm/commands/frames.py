"""The command ``frames``: pictures from which pixel coordinates of points can be read."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import say
from vfm_sdm.studies.planning.frames import find_frames, write_frames

__all__ = ["frames"]


def frames(
    source: Annotated[Path, Parameter(help="A session's file, the folder of a finished run, or a video.")],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder to write to.")] = Path("frames"),
) -> None:
    """First frames of all views with a grid of pixels, named points and their subsets, as PNG files.

    Points that come into view later stand in their own frames. Of a run, all points are shown where they were found.
    """
    with show_progress() as progress:
        written = list(write_frames(output, find_frames(source, progress=progress)))
    for path in written:
        say(f"written: {path}")
