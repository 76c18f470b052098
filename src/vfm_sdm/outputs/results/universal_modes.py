"""Modes for programs of modal analysis: the universal file, datasets 15, 55, 82 and 164."""

from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.files import write_file
from vfm_sdm.outputs.results.universal import nodes, units

__all__ = ["trace_order", "write_modes_uff"]

# Codes of the universal file format, dataset 55.
_STRUCTURAL, _COMPLEX_FIRST_ORDER, _TRANSLATIONS, _DISPLACEMENT, _COMPLEX = 1, 3, 2, 8, 5
_PER_NODE = 3
_BLACK = 1
_NODES_A_LINE = 8


def trace_order(places: np.ndarray) -> list[int]:
    """Points with a place along the structure's longer way: the line that is drawn through them.

    Parameters
    ----------
    places
        Places on the axes, shape (P, 3) [m].

    Examples
    --------
    >>> trace_order(np.array([[0, 0, 5.0], [0, 0, 1], [np.nan] * 3, [0, 0, 3]]))
    [1, 3, 0]
    """
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    if not known.size:
        return []
    along = int(np.argmax(np.ptp(places[known], axis=0)))
    return [int(i) for i in known[np.argsort(places[known, along], kind="stable")]]


def write_modes_uff(path: Path, modes: xr.Dataset) -> Path:
    """Writes modes in the universal file format: units, nodes, the line through them, and a dataset 55 a mode.

    Parameters
    ----------
    path
        File to write.
    modes
        Of `vfm_sdm.analysis.modal.identify_modes`.

    Raises
    ------
    ResultsError
        The file cannot be written.

    Notes
    -----
    Nodes are numbered as those of ``displacement.uff``: the points in their order, from 1; directions 1, 2, 3 are the
    axes in theirs. Shapes are complex, with poles ``-z w + i w sqrt(1 - z^2)`` [rad/s]; where a shape is not
    known along an axis, zero stands, and a point of which nothing is known is left out.

    References
    ----------
    .. [1] Structural Dynamics Research Laboratory, University of Cincinnati, "Universal File Formats", datasets
       15 (nodes), 55 (data at nodes), 82 (trace lines) and 164 (units).
    """
    places = modes["position"].transpose("point", "axis").values
    known = np.isfinite(modes["shape"].values).any(axis=(0, 2))
    lines = [*units(), *nodes(places)]
    trace = [node + 1 for node in trace_order(places) if known[node]]
    if len(trace) > 1:
        lines += [
            "    -1",
            "    82",
            f"{1:10d}{len(trace):10d}{_BLACK:10d}",
            "points in their order along the structure",
        ]
        lines += [
            "".join(f"{node:10d}" for node in trace[first : first + _NODES_A_LINE])
            for first in range(0, len(trace), _NODES_A_LINE)
        ]
        lines.append("    -1")
    for number in range(modes.sizes["mode"]):
        lines += _dataset_55(modes.isel(mode=number), number + 1, known)
    return write_file(path, "\n".join(lines) + "\n")


def _dataset_55(one: xr.Dataset, number: int, known: np.ndarray) -> list[str]:
    frequency, damping = float(one["frequency"]), float(one["damping_ratio"])
    angular = 2 * np.pi * frequency
    pole = angular * complex(-damping, np.sqrt(1 - damping**2))
    shape = np.nan_to_num(one["shape"].transpose("point", "axis").values)
    # Of a single view two axes are known: a node has three translations in the file.
    shape = np.pad(shape, ((0, 0), (0, _PER_NODE - shape.shape[1])))
    head = (_STRUCTURAL, _COMPLEX_FIRST_ORDER, _TRANSLATIONS, _DISPLACEMENT, _COMPLEX, _PER_NODE)
    lines = [
        "    -1",
        "    55",
        f"mode {number}",
        f"{frequency:.4f} Hz, damping {100 * damping:.3f} %",
        "vfm-sdm",
        "NONE",
        "NONE",
        "".join(f"{value:10d}" for value in head),
        "".join(f"{value:10d}" for value in (2, 6, 0, number)),
        "".join(f"{value:13.5E}" for value in (pole.real, pole.imag, 1.0, 0.0, 1.0, 0.0)),
    ]
    for node in np.flatnonzero(known):
        lines.append(f"{node + 1:10d}")
        lines.append("".join(f"{value:13.5E}" for entry in shape[node] for value in (entry.real, entry.imag)))
    return [*lines, "    -1"]
