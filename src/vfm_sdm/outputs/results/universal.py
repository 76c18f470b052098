"""Displacement for programs of modal analysis: the universal file, datasets 15, 58 and 164."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, is_even_clock
from vfm_sdm.core.datasets import convert_units
from vfm_sdm.errors import ResultsError
from vfm_sdm.signals.clocks import ROUNDED_STAMPS

__all__ = ["nodes", "to_uff", "units"]

# Codes of the universal file format, datasets 15, 58 and 164.
_TIME_RESPONSE = 1
_DOUBLE = 4
_AXIS_TIME = 17
_AXIS_DISPLACEMENT = 8
_UNITS_SI = 1
_RELATIVE_TEMPERATURE = 2
_BLACK = 1


def to_uff(path: Path, displacement: xr.Dataset) -> None:
    """Writes the universal file format: units, nodes, and a dataset 58 for each point and axis, in SI units (metres).

    Parameters
    ----------
    path
        File to write.
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Raises
    ------
    ResultsError
        There is no value to write.

    Notes
    -----
    Nodes are the points in their order, from 1, at their median positions on the axes (dataset 15; a point without any
    position has no node); directions 1, 2, 3 are the axes in their order. Samples without a
    value are left out; such a series, or one whose frames are unevenly spaced, is written with its time stamps, which
    the format keeps to six digits. A series without any value is left out. Letters outside ASCII become ``?``, line
    breaks in names blanks.

    References
    ----------
    .. [1] Structural Dynamics Research Laboratory, University of Cincinnati, "Universal File Formats", datasets
       15 (nodes), 58 (function at nodal degree of freedom) and 164 (units).
    """
    metres = convert_units(displacement["displacement"], "m").values
    time_s = displacement["time"].values
    records: list[str] = []
    for node, point in enumerate(_names(displacement, "point"), start=1):
        for direction, axis in enumerate(_names(displacement, "axis"), start=1):
            series = metres[:, node - 1, direction - 1]
            found = np.isfinite(series)
            if found.any():
                label = (point, axis)
                records += _dataset_58(time_s[found], series[found], label=label, node=node, direction=direction)
    if not records:
        raise ResultsError("expected at least one value, got none; look at the tracks' status first")
    text = "\n".join([*units(), *_dataset_15(displacement), *records]) + "\n"
    path.write_bytes(text.encode("ascii", errors="replace"))


def units() -> list[str]:
    """Dataset 164 as lines, the units of the file: metre, newton, kelvin."""
    factors = "".join(_fortran(value, 25, 17) for value in (1.0, 1.0, 1.0))
    return [
        "    -1",
        "   164",
        f"{_UNITS_SI:10d}{'SI: Meter (newton)':<20s}{_RELATIVE_TEMPERATURE:10d}",
        factors,
        _fortran(273.15, 25, 17),
        "    -1",
    ]


def _dataset_15(displacement: xr.Dataset) -> list[str]:
    """Nodes: number, coordinate systems, colour, and place along the axes [m]; none where no position is known."""
    position = displacement["position"].transpose("time", "point", "axis").values
    found = [of_point[np.isfinite(of_point).all(axis=1)] for of_point in position.swapaxes(0, 1)]
    return nodes(np.array([np.median(one, axis=0) if one.size else np.full(3, np.nan) for one in found]))


def nodes(places: FloatArray) -> list[str]:
    """Dataset 15 as lines: nodes from 1, at places of shape (P, 3) [m]; those without a place have none.

    Parameters
    ----------
    places
        Places on the axes, shape (P, 3) [m].
    """
    lines = [
        f"{node:10d}{0:10d}{0:10d}{_BLACK:10d}" + "".join(f"{value:13.5E}" for value in place)
        for node, place in enumerate(places, start=1)
        if np.isfinite(place).all()
    ]
    return ["    -1", "    15", *lines, "    -1"] if lines else []


def _dataset_58(
    time_s: FloatArray, metres: FloatArray, *, label: tuple[str, str], node: int, direction: int
) -> list[str]:
    """One function: heading, degree of freedom, abscissa, axes and values."""
    interval = (time_s[-1] - time_s[0]) / (time_s.size - 1) if time_s.size > 1 else 0.0
    even = time_s.size > 1 and is_even_clock(time_s, interval, tolerance=ROUNDED_STAMPS)
    dof = f" {'NONE':<10s}{node:10d}{direction:4d} {'NONE':<10s}{0:10d}{0:4d}"
    return [
        "    -1",
        "    58",
        "".join(letter if letter.isprintable() else " " for letter in " ".join(label))[:80],
        f"displacement along {label[1]}"[:80],
        "NONE",
        "vfm-sdm",
        "NONE",
        f"{_TIME_RESPONSE:5d}{0:10d}{1:5d}{0:10d}{dof}",
        f"{_DOUBLE:10d}{time_s.size:10d}{int(even):10d}{time_s[0]:13.5E}{interval if even else 0.0:13.5E}{0.0:13.5E}",
        _axis_record(_AXIS_TIME, "Time", "s"),
        _axis_record(_AXIS_DISPLACEMENT, "Displacement", "m"),
        _axis_record(0, "NONE", "NONE"),
        _axis_record(0, "NONE", "NONE"),
        *(_even_values(metres) if even else _uneven_values(time_s, metres)),
        "    -1",
    ]


def _axis_record(kind: int, label: str, units: str) -> str:
    length = 1 if kind == _AXIS_DISPLACEMENT else 0  # displacement is a length to the power of one
    return f"{kind:10d}{length:5d}{0:5d}{0:5d} {label:<20s} {units:<20s}"


def _even_values(values: FloatArray) -> Iterator[str]:
    for start in range(0, values.size, 4):
        yield "".join(f"{value:20.12E}" for value in values[start : start + 4])


def _uneven_values(time_s: FloatArray, values: FloatArray) -> Iterator[str]:
    pairs = [f"{time:13.5E}{value:20.12E}" for time, value in zip(time_s, values, strict=True)]
    for start in range(0, len(pairs), 2):
        yield "".join(pairs[start : start + 2])


def _fortran(value: float, width: int, digits: int) -> str:
    """A number as FORTRAN's D format writes it."""
    return f"{value:{width}.{digits}E}".replace("E", "D")


def _names(data: xr.Dataset, dim: str) -> list[str]:
    return [str(name) for name in data[dim].values]
