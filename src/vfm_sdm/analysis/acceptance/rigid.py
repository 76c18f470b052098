"""Rigid steps: a stage moves what is measured by known amounts."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.analysis.acceptance.records import (
    Acceptance,
    AcceptanceRow,
    AcceptedRun,
    as_number,
    check_limit,
    read_rows,
)
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import DatasetError

__all__ = ["StageStep", "check_rigid", "read_steps"]

_FEWEST_STEPS = 3
_MM_PER_M = 1e3


@dataclass(frozen=True)
class StageStep:
    """One position of a stage, held for a while.

    Parameters
    ----------
    start_s, end_s
        When it was held, on the clock of the measurement [s].
    position_mm
        Position of the stage along axes of the measurement, by name [mm].
    """

    start_s: float
    end_s: float
    position_mm: dict[str, float]


def read_steps(path: Path | str) -> tuple[StageStep, ...]:
    r"""Positions of a stage from a CSV file.

    Parameters
    ----------
    path
        File with the columns ``start_s`` and ``end_s`` [s], and one named after each axis along which the stage moves,
        such as ``vertical`` [mm].

    Raises
    ------
    DatasetError
        The file is not as described, or an interval ends before it begins.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "steps.csv")
    ...     _ = file.write_text("start_s,end_s,vertical\n0,1,0\n2,3,5\n4,5,10\n")
    ...     read_steps(file)[2]
    StageStep(start_s=4.0, end_s=5.0, position_mm={'vertical': 10.0})
    """
    rows = read_rows(path, ("start_s", "end_s"))
    axes = [name for name in rows[0] if name not in ("start_s", "end_s")]
    steps = tuple(
        StageStep(
            as_number(path, row, "start_s"),
            as_number(path, row, "end_s"),
            {axis: as_number(path, row, axis) for axis in axes},
        )
        for row in rows
    )
    if not axes or len(steps) < _FEWEST_STEPS or any(step.end_s <= step.start_s for step in steps):
        raise DatasetError(
            f"{path}: expected {_FEWEST_STEPS} steps or more, each with end_s after start_s, and a column for each "
            f"axis in mm, got {len(steps)} steps along {axes}; complete the file"
        )
    return steps


def check_rigid(
    run: AcceptedRun,
    steps: tuple[StageStep, ...],
    *,
    limit_mm: float | None = None,
    slope_limit: float | None = None,
) -> Acceptance:
    """Slope, offset and residual of each moved point and axis, and how distances between points change.

    Parameters
    ----------
    run
        The run; its points that are not static moved with the stage.
    steps
        Positions of the stage.
    limit_mm
        Largest offset, residual and change of a distance that are accepted [mm]; without one, what the run states.
    slope_limit
        Largest error of a slope that is accepted [1]; without one, what the run states.

    Returns
    -------
    acceptance
        Rows for each point and axis of the stage, and one for each two points.

    Raises
    ------
    DatasetError
        The axes are not those of the measurement, or a limit is not positive.

    Notes
    -----
    A step is the mean of the samples with status ok while it was held, less that of the first step. Offset and slope
    are those of the least-squares line of measured over applied steps; the residual is the largest distance from it.
    An axis along which the stage did not move has no slope, and its residual is cross-talk. A rigid body keeps the
    distances between its points: the largest change from the first step on is stated.

    The run's own limits are expanded uncertainties (k = 2) of a sample at the largest step: of a slope, over that step;
    of a distance, those of both points along it.
    """
    check_limit(limit_mm, "limit")
    check_limit(slope_limit, "slope limit")
    data = run.displacement
    axes, known = list(steps[0].position_mm), [str(axis) for axis in data["axis"].values]
    if not set(axes) <= set(known):
        raise DatasetError(f"steps: expected axes of the measurement, {known}, got {axes}; rename the columns")
    applied = np.array([list(step.position_mm.values()) for step in steps])
    applied = applied - applied[0]
    largest = int(np.linalg.norm(applied, axis=1).argmax())
    moved = {name: _average(data.sel(point=name), steps) for name in run.moving}
    rows: list[AcceptanceRow] = []
    for name, (shift, _, stated) in moved.items():
        for column, axis in enumerate(axes):
            at = known.index(axis)
            fit = _fit(shift[:, at] - shift[0, at], applied[:, column])
            span = float(np.ptp(applied[:, column]))
            own = stated[largest, at] if limit_mm is None else limit_mm
            share = (stated[largest, at] / span if span else np.nan) if slope_limit is None else slope_limit
            subject = f"{name} {axis}"
            rows += [
                AcceptanceRow(subject, "slope - 1", fit[0], float(share), "1"),
                AcceptanceRow(subject, "offset", fit[1], float(own), "mm"),
                AcceptanceRow(subject, "residual", fit[2], float(own), "mm"),
            ]
    for first, second in combinations(moved, 2):
        rows.append(_compare_distance(first, second, moved, largest, limit_mm))
    limits = "stated by the run itself (k = 2)" if limit_mm is None or slope_limit is None else "given"
    details = {"steps": [{"start_s": s.start_s, "end_s": s.end_s, **s.position_mm} for s in steps]}
    return Acceptance("rigid", limits, tuple(rows), details=details)


_Plateaus = tuple[FloatArray, FloatArray, FloatArray]
"""Displacement [mm], position [m] and expanded uncertainty [mm] of a point at each step, shape (S, 3)."""


def _average(of_point: xr.Dataset, steps: tuple[StageStep, ...]) -> _Plateaus:
    """Means over the samples with status ok while each step was held; NaN where there is none."""
    ok, time_s = of_point["status"].values == Status.OK, of_point["time"].values
    stated = (
        of_point["expanded_uncertainty"] if "expanded_uncertainty" in of_point else np.nan * of_point["displacement"]
    )
    found = []
    for step in steps:
        held = ok & (time_s >= step.start_s) & (time_s <= step.end_s)
        series = (of_point["displacement"], of_point["position"], stated)
        nothing = np.full(of_point.sizes["axis"], np.nan)
        found.append([one.values[held].mean(axis=0) if held.any() else nothing for one in series])
    return tuple(np.array(part) for part in zip(*found, strict=True))  # type: ignore[return-value]


def _fit(measured: FloatArray, applied: FloatArray) -> tuple[float, float, float]:
    """Slope less 1 [1], offset and largest residual [mm] of the line of measured over applied steps, (S,) [mm]."""
    known = np.isfinite(measured)
    if known.sum() < _FEWEST_STEPS:
        return float("nan"), float("nan"), float("nan")
    if np.ptp(applied[known]) == 0:
        offset = float(measured[known].mean())
        return float("nan"), offset, float(np.abs(measured[known] - offset).max())
    columns = np.column_stack([applied[known], np.ones(int(known.sum()))])
    slope, offset = np.linalg.lstsq(columns, measured[known])[0]
    return float(slope - 1), float(offset), float(np.abs(measured[known] - columns @ [slope, offset]).max())


def _compare_distance(
    first: str, second: str, moved: dict[str, _Plateaus], largest: int, limit_mm: float | None
) -> AcceptanceRow:
    """Largest change of the distance between two points."""
    (_, a, stated_a), (_, b, stated_b) = moved[first], moved[second]
    distance = np.linalg.norm(a - b, axis=1) * _MM_PER_M
    change = distance - distance[0]
    worst = float(change[np.nanargmax(np.abs(change))]) if np.isfinite(change).any() else float("nan")
    limit = limit_mm
    if limit is None:
        along = (a[0] - b[0]) / max(float(np.linalg.norm(a[0] - b[0])), 1e-12)
        limit = float(np.sqrt(np.sum((along * stated_a[largest]) ** 2 + (along * stated_b[largest]) ** 2)))
    return AcceptanceRow(f"{first} - {second}", "change of distance", worst, limit, "mm")
