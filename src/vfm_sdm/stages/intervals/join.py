"""Displacement of intervals as one dataset of the whole recording, of which only a part is in memory at a time."""

import warnings
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.block_files import ScratchFile, time_variables
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.intervals.division import Interval

__all__ = ["JoinedDisplacement"]

_COARSE = ("displacement_std", "uncertainty", "combined_std", "expanded_uncertainty", "reprojection_error")
"""Variables of which seven digits are more than anybody knows."""
_SETS = "visibility"


class JoinedDisplacement:
    """Displacement that grows interval by interval.

    Parameters
    ----------
    folder
        Folder in which it lies until it is not needed any more; that for temporary files when ``None``.
    """

    def __init__(self, folder: Path | None) -> None:
        self._file = ScratchFile(folder)
        self._facts: list[xr.Dataset] = []
        self._intervals: list[Interval] = []
        self._sets: list[str] = []
        self._ends = [0]

    def append(self, interval: Interval, displacement: xr.Dataset) -> None:
        """Adds the displacement of the next interval.

        Parameters
        ----------
        interval
            The interval.
        displacement
            Its displacement, shape (T, P, 3) [mm], whose time begins with it.
        """
        shifted = displacement["time"].values + interval.begin_s
        block = displacement.assign_coords(time=("time", shifted, displacement["time"].attrs))
        for name in _COARSE:
            if name in block:
                block[name] = block[name].astype(np.float32)
        along = time_variables(block)
        facts = block.drop_vars(along).assign(_summarize(block))
        self._file.append(self._with_common_sets(block)[along])
        self._facts.append(facts)
        self._intervals.append(interval)
        self._ends.append(self._ends[-1] + block.sizes["time"])

    def facts(self) -> xr.Dataset:
        """All that is not of single frames, of all intervals, as of `finish`.

        Raises
        ------
        DatasetError
            There is no interval.
        """
        if not self._facts:
            raise DatasetError(
                "intervals: expected recordings that overlap, got none with frames of all views; check time_offset_s"
            )
        joined = _join_facts(self._facts, self._sets)
        times = {name: [getattr(one, f"{name}_s") for one in self._intervals] for name in ("begin", "end")}
        return joined.assign({f"interval_{name}": ("interval", found, {"units": "s"}) for name, found in times.items()})

    def finish(self, refused: Sequence[bool]) -> xr.Dataset:
        """The whole, shape (T, P, 3) [mm], read from its file where it is looked at.

        Parameters
        ----------
        refused
            Whether an interval is not to be used, of each: its samples are unreliable.

        Notes
        -----
        What is not the same in all intervals is that of the first, and stands beside it for each of them, as
        ``NAME_by_interval`` (interval, ...); ``interval_begin`` and ``interval_end`` [s] say when these were, and
        ``interval_mean``, ``interval_rms`` (about it) and ``interval_std`` (median of what is stated of a sample),
        (interval, point, axis) [mm], what was measured in them.
        """
        for begin, end in ((self._ends[number], self._ends[number + 1]) for number, bad in enumerate(refused) if bad):
            self._file.change("status", slice(begin, end), _distrust)
        return self._file.finish(self.facts())

    def _with_common_sets(self, block: xr.Dataset) -> xr.Dataset:
        """A block whose sets of views are counted through all blocks."""
        if _SETS not in block.dims:
            return block
        names = block[_SETS].values.tolist()
        self._sets += [name for name in names if name not in self._sets]
        numbers = np.array([*(self._sets.index(name) for name in names), -1], dtype=block["seen_by"].dtype)
        return block.assign(seen_by=block["seen_by"].copy(data=numbers[block["seen_by"].values]))


def _distrust(codes: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Codes of `Status`, none of which is OK any more."""
    return np.where(codes == Status.OK, codes.dtype.type(Status.UNRELIABLE), codes)


def _summarize(block: xr.Dataset) -> dict[str, xr.DataArray]:
    """Mean of displacement over an interval, its scatter about it, and its standard deviation [mm], (point, axis)."""
    trusted = block["displacement"].where(block["status"] == Status.OK)
    stated = block["combined_std" if "combined_std" in block else "displacement_std"].where(trusted.notnull())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of points without a sample
        found = {"mean": trusted.mean("time"), "rms": trusted.std("time"), "std": stated.median("time")}
    return {f"interval_{name}": one.assign_attrs(units="mm") for name, one in found.items()}


def _join_facts(facts: list[xr.Dataset], sets: list[str]) -> xr.Dataset:
    """Variables without time of all intervals."""
    first, joined = facts[0], dict[Hashable, xr.DataArray]()
    for name in first.data_vars:
        every = [one[name] for one in facts]
        if _SETS in first[name].dims:
            # A set of views has its values from the first interval in which it is seen.
            found = every[0].reindex({_SETS: sets})
            for one in every[1:]:
                found = found.combine_first(one.reindex({_SETS: sets}))
            joined[name] = found.astype(first[name].dtype).assign_attrs(first[name].attrs)
            continue
        if str(name).startswith("interval_"):
            joined[name] = xr.concat(every, dim="interval").assign_attrs(every[0].attrs)
            continue
        joined[name] = every[0]
        if not all(one.equals(every[0]) for one in every[1:]):
            joined[f"{name}_by_interval"] = xr.concat(every, dim="interval").assign_attrs(every[0].attrs)
    return xr.Dataset(joined, coords={name: c for name, c in first.coords.items() if name != _SETS}, attrs=first.attrs)
