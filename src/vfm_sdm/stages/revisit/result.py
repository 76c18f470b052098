"""Result of a re-visit: a line a point, and the file that holds it."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vfm_sdm.core.files import csv_text, write_file
from vfm_sdm.core.statuses import RevisitStatus
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["Change", "Revisit", "write_revisit"]


@dataclass(frozen=True)
class Change:
    """Change of one point's rest position.

    Parameters
    ----------
    point
        Name of the point.
    status
        ``ok`` or why there is no value.
    change_mm, std_mm
        Change along each axis and its standard deviation [mm]; NaN where there is none.
    """

    point: str
    status: RevisitStatus
    change_mm: tuple[float, float, float] = (float("nan"),) * 3
    std_mm: tuple[float, float, float] = (float("nan"),) * 3


@dataclass(frozen=True)
class Revisit:
    """A visit beside an earlier one.

    Parameters
    ----------
    baseline
        Name of the earlier session.
    axes
        Names of the axes, those of the earlier visit.
    static
        Static points that were found again.
    changes
        A line for every other point of both visits.
    notes
        What a reader must know.
    scale_ratio, scale_ratio_std
        Lengths of the later visit over the same lengths of the earlier one, and standard deviation [1]; NaN where
        nobody knows.
    """

    baseline: str
    axes: tuple[str, ...]
    static: tuple[str, ...]
    changes: tuple[Change, ...]
    notes: tuple[str, ...] = ()
    scale_ratio: float = float("nan")
    scale_ratio_std: float = float("nan")

    def as_table(self) -> dict[str, Any]:
        """As plain tables, for ``summary.json``."""
        changes = [{**asdict(c), "expanded_mm": [COVERAGE_FACTOR * std for std in c.std_mm]} for c in self.changes]
        return {**asdict(self), "changes": changes}


def write_revisit(path: Path, revisit: Revisit) -> Path:
    """Writes the changes as CSV: a line a point, change and expanded uncertainty (k = 2) along each axis in mm.

    Parameters
    ----------
    path
        The file to make or replace.
    revisit
        What was found.

    Raises
    ------
    ResultsError
        The file cannot be written.
    """
    header = ["point", "status", *(f"{axis}{part} [mm]" for axis in revisit.axes for part in ("", " U"))]
    return write_file(path, csv_text(header, map(_row, revisit.changes)))


def _row(one: Change) -> list[str]:
    pairs = zip(one.change_mm, one.std_mm, strict=True)
    cells = [number for change, std in pairs for number in (change, COVERAGE_FACTOR * std)]
    return [one.point, one.status, *("" if np.isnan(number) else f"{number:.6g}" for number in cells)]
