"""The command ``repeat``: the same films measured by several people."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr
from cyclopts import Parameter
from rich.table import Table

from vfm_sdm.analysis.repeatability import QUANTITIES, RepeatedRun, compare_runs, write_repeatability
from vfm_sdm.commands.runs import about_run, read_run, save_figure
from vfm_sdm.commands.terminal import (
    OUT,
    add_name_column,
    fail,
    note,
    number_text,
    plain_table,
    say,
    say_rest,
    shown_rows,
)
from vfm_sdm.core.run_folder import SESSION, RunFolder
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.outputs.plots.repeatability import draw_repeatability

__all__ = ["repeat"]

_NAME_ROOM = 12
"""Letters of a name: eight columns of numbers leave no more of 80."""
_COLUMNS = (
    *(f"repeatability{end}" for end in ("", "_low", "_high")),
    "between",
    *(f"reproducibility{end}" for end in ("", "_low", "_high")),
    "stated_std",
)


def repeat(
    runs: Annotated[list[Path], Parameter(help="Run folders of the same films.")],
    *,
    persons: Annotated[
        str, Parameter(help="Who measured each, in their order: anna,anna,ben; else as in [report].")
    ] = "",
    quantity: Annotated[str, Parameter(help="What the table shows; the files hold all.")] = "displacement",
    output: Annotated[Path | None, Parameter(("--output", "-o"), help="Folder to write to; the first run's.")] = None,
) -> None:
    """Compare measurements of the same films by several people: repeatability and reproducibility by point and axis.

    Writes repeatability.nc, repeatability.csv and figures/repeatability.png into the first run folder, where
    `vfm-sdm report` finds them.
    """
    if quantity not in QUANTITIES:
        raise DatasetError(f"--quantity: expected one of {', '.join(QUANTITIES)}, got {quantity}; name one of them")
    named = [name.strip() for name in persons.split(",")] if persons else [_find_person(run) for run in runs]
    if len(named) != len(runs):
        raise DatasetError(f"--persons: expected a name for each of {len(runs)} runs, got {len(named)}; name them all")
    opened, notes = [], []
    for run, name, person in zip(runs, _short_names(runs), named, strict=True):
        displacement, of_run = read_run(run)
        notes += [f"{name}: {text}" for text in of_run]
        opened.append(RepeatedRun(name, person or name, displacement, _films(run), _still_interval(run)))
    result = compare_runs(opened)
    OUT.print(_tabulate(result.sel(quantity=quantity), quantity))
    if not persons and not any(named):
        notes.append("nobody is named: every run counts as another person's; see --persons")
    note([*notes, *_explain(result)])
    folder = runs[0] if output is None else output
    figure = draw_repeatability(result, quantity, about_run(runs[0]))
    written = [*write_repeatability(folder, result), save_figure(figure, folder, "repeatability")]
    say(f"written: {', '.join(map(str, written))}")
    if not np.isfinite(result["consistency"].sel(quantity=quantity).values).any():
        fail("no point is seen by all runs in half of the frames")


def _find_person(run: Path) -> str:
    file = run / SESSION
    stated = read_session(file, check_files=False).report if file.is_file() else None
    return (stated.measured_by or "") if stated is not None else ""


def _films(run: Path) -> dict[str, str]:
    """Hashes of the recordings that a run is made of, by name; not those of sensors and lens files."""
    hashes = RunFolder(run).record.get("input_hashes", {})
    file = run / SESSION
    if not isinstance(hashes, dict) or not file.is_file():
        return {}
    others = {one.file.name for one in read_session(file, check_files=False).sensor}
    return {str(name): str(value) for name, value in hashes.items() if Path(str(name)).name not in others}


def _still_interval(run: Path) -> tuple[float, float] | None:
    file = run / SESSION
    return read_session(file, check_files=False).method.still_interval_s if file.is_file() else None


def _short_names(runs: list[Path]) -> list[str]:
    """Names of the folders; where two are alike, with as much of their paths as tells them apart."""
    parts = [run.resolve().parts for run in runs]
    for depth in range(1, max(map(len, parts)) + 1):
        names = [Path(*one[-depth:]).as_posix() for one in parts]
        if len(set(names)) == len(names):
            break
    return names


def _explain(result: xr.Dataset) -> list[str]:
    """What the numbers rest on."""
    people = Counter(str(name) for name in result["person"].values)
    texts = []
    if len(people) == 1:
        texts.append("all runs are one person's: only repeatability is known")
    elif max(people.values()) == 1:
        texts.append("nobody measured twice: only reproducibility is known")
    texts += _explain_origins(result)
    over = result["consistency"].sel(quantity="displacement")
    wrong = [
        (float(over.sel(point=p, axis=a)), f"{a} of {p}") for p in over["point"].values for a in over["axis"].values
    ]
    wrong = sorted((one for one in wrong if one[0] > 1), reverse=True)
    if wrong:
        listed = ", ".join(f"{where} ({value:.1f})" for value, where in wrong[:3])
        more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        texts.append(f"runs differ by more than the standard uncertainty that they state: {listed}{more}")
    return texts


def _explain_origins(result: xr.Dataset) -> list[str]:
    """What runs measure from, where it is not the same: they differ by a constant then, whoever measured."""
    texts = []
    for name, words in (
        ("origin", "displacement is relative to something else"),
        ("start", "time is zero at other dates"),
    ):
        stated = [str(one) or "not stated" for one in result[name].values]
        if len(set(stated)) > 1:
            listed = "; ".join(f"{run}: {one}" for run, one in zip(result["run"].values, stated, strict=True))
            texts.append(f"{words} from run to run ({listed})")
    points = result["point"].values[result["first_frame_differs"].values.astype(bool)]
    if points.size:
        texts.append(f"the first valid sample is not of the same frame in all runs: {', '.join(map(str, points[:5]))}")
    if points.size or len(set(result["origin"].values.tolist())) > 1:
        texts.append("what differs by a constant from run to run is not in peak_to_peak: compare that")
    return texts


def _tabulate(result: xr.Dataset, quantity: str) -> Table:
    """Standard deviations by point and axis [mm]."""
    names = [str(name) for name in result["point"].values]
    table = plain_table(f"Standard deviation of {quantity} [mm], interval of 95 %", dense=True)
    add_name_column(table, "point", names, room=_NAME_ROOM)
    table.add_column("axis", no_wrap=True)
    for column in ("one person", "from", "to", "between", "all", "from", "to", "stated"):
        table.add_column(column, justify="right", no_wrap=column != "one person")
    for name in names[: shown_rows(len(names))]:
        for number, axis in enumerate(result["axis"].values):
            one = result.sel(point=name, axis=axis)
            table.add_row(
                name if number == 0 else "",
                str(axis),
                *(number_text(float(one[key]), "{:.3f}") for key in _COLUMNS),
            )
    return say_rest(table, len(names), "repeatability.csv")
