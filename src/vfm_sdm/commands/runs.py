"""What commands that look into a finished run share: its displacement, what is said of it, and a place for figures."""

from collections.abc import Callable, Collection
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import Concatenate, ParamSpec

import xarray as xr
from matplotlib.figure import Figure

from vfm_sdm.analysis.load_test import find_moved_static
from vfm_sdm.core.files import write_file
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.one_writer import held_alone
from vfm_sdm.core.run_folder import SESSION, RunFolder
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.outputs.plots import About, describe_run

__all__ = ["about_run", "alone_in_run", "check_elsewhere", "note_static", "read_run", "save_figure"]

_DPI = 120
_Options = ParamSpec("_Options")


def alone_in_run(command: Callable[Concatenate[Path, _Options], None]) -> Callable[Concatenate[Path, _Options], None]:
    """A command that no other one of these writes beside: tables, figures and netCDF in a run folder are of one call.

    Parameters
    ----------
    command
        Function of a command, of which the first argument is the run folder.
    """

    @wraps(command)
    def alone(run: Path, /, *args: _Options.args, **options: _Options.kwargs) -> None:
        if not run.is_dir():  # which the command says in its own words, and which must not be made
            command(run, *args, **options)
            return
        expected = "a run folder to which no other command writes results"
        with held_alone(run, "analysis", expected=expected, advice="wait for it"):
            command(run, *args, **options)

    return alone


def read_run(run: Path, axis: str | None = None) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Displacement of a run folder, and notes on what it was made of.

    Parameters
    ----------
    run
        The run folder.
    axis
        Axis that is asked for; any when ``None``.

    Raises
    ------
    DatasetError
        It has no such axis.
    ResultsError
        The folder holds no displacement, or a damaged one.
    """
    displacement = read_displacement(run)
    if axis is not None and axis not in displacement["axis"].values:
        known = ", ".join(map(str, displacement["axis"].values))
        raise DatasetError(f"--axis: expected one of {known}, got {axis}; name one of them")
    return displacement, RunFolder(run).check_whole("displacement", displacement.attrs)


def check_elsewhere(table: Path, written: Path) -> None:
    """Refuses a table that the command's own result would be written over.

    Parameters
    ----------
    table
        File that is read.
    written
        File that is written.

    Raises
    ------
    DatasetError
        They are one file.
    """
    if table.exists() and written.exists() and table.samefile(written):
        raise DatasetError(
            f"{table}: expected a table elsewhere than where results are written, got the same file; rename it"
        )


def note_static(result: xr.Dataset, static: Collection[str], where: str) -> list[str]:
    """What is said of the points of a load test or of passages that must not move and are not shown.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.load_test.judge_load_test` or `vfm_sdm.analysis.load_test.judge_passages`.
    static
        Names of the points that must not move.
    where
        File that holds all points.
    """
    left = sum(str(name) in static for name in result["point"].values)
    if not left:
        return []
    words = "1 static point is" if left == 1 else f"{left} static points are"
    dim = "step" if "deflection" in result else "passage"
    moved = [
        f"static point {one.point} moved by {one.value_mm:.3f} +- {one.expanded_mm:.3f} mm along {one.axis} in {dim} "
        f"{one.number}: a camera moved, or the point did; other points may be wrong by as much"
        for one in find_moved_static(result, static)
    ]
    return [f"{words} left out of table and figure; all in {where}", *moved]


def about_run(run: Path) -> About:
    """What figures say of a run, from the session in its folder; nothing where there is none.

    Parameters
    ----------
    run
        The run folder.
    """
    file = run / SESSION
    return describe_run(read_session(file, check_files=False), None) if file.is_file() else About()


def save_figure(figure: Figure, folder: Path, name: str) -> Path:
    """Writes ``figures/NAME.png``, and returns its path.

    Parameters
    ----------
    figure
        The figure.
    folder
        The run folder.
    name
        Name of the file without its ending.
    """
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return write_file(folder / "figures" / f"{name}.png", buffer.getvalue())
