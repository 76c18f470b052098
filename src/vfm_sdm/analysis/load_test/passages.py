"""Passages of a vehicle: when each one was on the structure, how fast, and with which axles."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.analysis.load_test.steps import check_units, read_columns
from vfm_sdm.core.constants import KM_H
from vfm_sdm.errors import DatasetError

__all__ = ["Axle", "Passage", "read_axles", "read_passages"]

_SPEEDS = {"m/s": 1.0, "km/h": 1 / KM_H}
_AXLE = re.compile(r"^\s*(?P<place>[0-9.]+)\s*:\s*(?P<load>[0-9.]+)\s*$")


@dataclass(frozen=True)
class Axle:
    """An axle of a vehicle.

    Parameters
    ----------
    behind_m
        Distance behind the first axle [m].
    load_kn
        Its load [kN].
    """

    behind_m: float
    load_kn: float


@dataclass(frozen=True)
class Passage:
    """One crossing.

    Parameters
    ----------
    begin_s, end_s
        When the first axle comes onto the structure and the last one leaves it, on the displacement's clock [s].
    speed_m_s
        Speed [m/s]; NaN where it is not known.
    """

    begin_s: float
    end_s: float
    speed_m_s: float = float("nan")


def read_passages(path: Path | str) -> tuple[Passage, ...]:
    r"""Passages from a table: a row each, in the order in which they were driven.

    Parameters
    ----------
    path
        Text file with columns ``begin_s`` and ``end_s``, and with ``speed [km/h]`` or ``speed [m/s]`` where
        displacement against the vehicle's place is asked for.

    Raises
    ------
    DatasetError
        The file is no such table, a speed has no unit that is known, or passages overlap.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "passages.csv")
    ...     _ = file.write_text("begin_s,end_s,speed [km/h]\n12.4,17.1,18\n40.2,42.0,54\n")
    ...     read_passages(file)[1]
    Passage(begin_s=40.2, end_s=42.0, speed_m_s=15.0)
    """
    columns = read_columns(path)
    lacking = [name for name in ("begin_s", "end_s") if name not in columns]
    if lacking:
        known = ", ".join(columns)
        raise DatasetError(f"{path}: expected columns begin_s and end_s, got {known}; name the columns so")
    check_units(path, columns, {"begin_s": "s", "end_s": "s"})
    begin, end = (np.asarray(columns[name][0]) for name in ("begin_s", "end_s"))
    speed = np.full(len(begin), np.nan)
    if "speed" in columns:
        values, unit = columns["speed"]
        if unit not in _SPEEDS:
            raise DatasetError(
                f"{path}: expected the speed in {' or '.join(_SPEEDS)}, got {unit or 'no unit'}; write speed [km/h]"
            )
        speed = np.asarray(values) * _SPEEDS[unit]
    if not len(begin):
        raise DatasetError(f"{path}: expected a row for each passage, got none; add them")
    edges = np.column_stack([begin, end]).ravel()
    if not (np.isfinite(edges).all() and (np.diff(edges) >= 0).all() and (end > begin).all()):
        raise DatasetError(
            f"{path}: expected passages one after the other, each ending after it begins, got begin_s {begin.tolist()} "
            f"and end_s {end.tolist()}; correct the times"
        )
    if np.any(speed <= 0):
        raise DatasetError(f"{path}: expected speeds above 0, got {min(speed):g} m/s; correct it, or leave it out")
    return tuple(Passage(float(a), float(b), float(v)) for a, b, v in zip(begin, end, speed, strict=True))


def read_axles(text: str) -> tuple[Axle, ...]:
    """Axles of a vehicle from text such as ``0:60,3.2:120,4.5:120``: metres behind the first one, and kN.

    Parameters
    ----------
    text
        An axle each, separated by commas.

    Raises
    ------
    DatasetError
        It cannot be read, the first axle is not at 0, or they are not in order.

    Examples
    --------
    >>> read_axles("0:60, 3.2:120")
    (Axle(behind_m=0.0, load_kn=60.0), Axle(behind_m=3.2, load_kn=120.0))
    """
    try:
        found = [_AXLE.match(part) for part in text.split(",")]
        axles = tuple(Axle(float(one["place"]), float(one["load"])) for one in found if one is not None)
    except ValueError:
        axles = ()
    places = [axle.behind_m for axle in axles]
    sound = len(axles) == len(text.split(",")) and places[0] == 0 and places == sorted(set(places))
    if not sound or min(axle.load_kn for axle in axles) <= 0:
        raise DatasetError(
            f"--axles: expected metres behind the first axle and kN of each, such as 0:60,3.2:120, got {text!r}; "
            "begin with 0 and keep their order"
        )
    return axles
