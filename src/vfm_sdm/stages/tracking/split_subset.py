"""Left and right halves of subsets, tracked by themselves: where they move apart, a subset covers two motions."""

from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX
from vfm_sdm.stages.registration.subsets import RawRegistration, SubsetBank, SubsetDesign

__all__ = ["SplitSubsets", "judge_halves"]

_LEAST_SIDE_PX = 11
_EVERY = 4
"""Frames between two measurements: enough for a root mean square, at a small part of the tracking's cost."""
_OFTEN = 0.8
"""Share of the frames that show the whole in which both halves have to be found."""


class SplitSubsets:
    """Squares of half the side in the left and right half of every subset of a bank.

    Parameters
    ----------
    reference
        Image that the subsets were taken from, shape (H, W).
    whole
        The bank of the whole subsets.
    executor
        Threads that share the work.

    Notes
    -----
    The halves have the warps of the whole, and its believed pixels.
    """

    def __init__(self, reference: LumaArray, whole: SubsetBank, executor: Executor) -> None:
        self._whole, self._executor = whole, executor
        self._apart = np.column_stack([whole.subset_px // 4, np.zeros(len(whole))])
        places = np.concatenate([whole.points - self._apart, whole.points + self._apart])
        self._bank = None
        if whole.designs is None:  # all of one size, which need no masks
            half_px = 2 * (int(whole.subset_px.max(initial=0)) // 4) + 1
            if half_px >= _LEAST_SIDE_PX:
                self._bank = SubsetBank.prepare(reference, places, subset_px=half_px, executor=executor)
        else:
            given = [(design, side) for side in (-1, 1) for design in whole.designs]
            designs = [None if design is None else _cut_half(design, side) for design, side in given]
            if any(design is not None for design in designs):
                self._bank = SubsetBank.prepare(reference, places, designs=designs, executor=executor)
        self._found: list[FloatArray] = []
        self._halves: dict[int, RawRegistration] = {}
        self._tried: list[BoolArray] = []

    def advance(self, luma: LumaArray, found: RawRegistration) -> None:
        """Takes the next frame, and where the whole subsets were found in it.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        found
            Registrations of the P whole subsets in it.
        """
        difference, tried = np.full((len(self._whole), 2), np.nan), np.zeros(len(self._whole), np.bool_)
        if self._bank is not None and len(self._found) % _EVERY == 0:
            difference, halves = self._measure(self._bank, luma, found)
            if self._whole.designs is not None:
                self._halves[len(self._found)] = halves
            tried = found.converged
        self._found.append(difference)
        self._tried.append(tried)

    def record(self) -> dict[str, Any]:
        """How far the right halves moved beyond the left ones so far, as variables of a record of tracks.

        ``half_difference`` (time, point, pixel) [px], NaN where not tracked; ``half_tried`` (time, point), whether the
        whole was there to try; and, of designed subsets, ``half_covariance`` [px2].
        """
        shape = (len(self._found), len(self._whole))
        variables: dict[str, Any] = {
            "half_difference": (("time", "point", "pixel"), np.reshape(self._found, (*shape, 2)), {"units": "px"}),
            "half_tried": (("time", "point"), np.reshape(self._tried, shape)),
        }
        if self._whole.designs is not None:
            covariances = np.full((*shape, 2, 2), np.nan)
            if self._bank is not None and self._halves:
                stated = self._bank.interpret(RawRegistration.joined(list(self._halves.values()))).covariance
                covariances[list(self._halves)] = stated.reshape(len(self._halves), 2, shape[1], 2, 2).sum(axis=1)
            variables["half_covariance"] = (("time", "point", "pixel_a", "pixel_b"), covariances, {"units": "px2"})
        return variables

    def _measure(self, bank: SubsetBank, luma: LumaArray, found: RawRegistration) -> tuple[FloatArray, RawRegistration]:
        affine = np.where(found.converged[:, None], found.warps[:, 2:], np.nan).reshape(-1, 2, 2)
        middle, step = self._whole.position(found.rows, found.warps), (affine @ self._apart[..., None])[..., 0]
        both = np.concatenate([affine, affine])
        start = np.concatenate([middle - step, middle + step]) - (both @ bank.offset[..., None])[..., 0]
        rows = np.arange(len(bank))
        raw = bank.run(luma, rows, np.concatenate([start, both.reshape(-1, 4)], axis=1), executor=self._executor)
        place = np.where(raw.converged[:, None], bank.position(rows, raw.warps), np.nan)
        left, right = np.split(place, 2)
        return right - left - 2 * self._apart, raw


def _cut_half(design: SubsetDesign, side: int) -> SubsetDesign | None:
    """The design of the left (-1) or right (1) half of a subset; ``None`` where too little of it is believed."""
    step, middle = design.subset_px // 4, design.subset_px // 2
    half_px = 2 * step + 1
    if half_px < _LEAST_SIDE_PX:
        return None
    left, top = middle + side * step - step, middle - step
    mask = None if design.mask is None else design.mask[top : top + half_px, left : left + half_px]
    if mask is not None and np.count_nonzero(mask) < FEWEST_BELIEVED_PX:
        return None
    return replace(design, subset_px=half_px, mask=mask)


def judge_halves(record: xr.Dataset) -> FloatArray:
    """``half_difference`` of a record, shape (T, P, 2) [px], without halves that are often not found.

    Parameters
    ----------
    record
        With the variables of `SplitSubsets.record`, of one pass or of several joined.

    Notes
    -----
    Halves of designed subsets that are often not found have too little to follow, and are NaN throughout.
    """
    found = record["half_difference"].values
    if "half_covariance" not in record:
        return np.asarray(found)
    often = np.isfinite(found).all(axis=2).sum(axis=0) >= _OFTEN * record["half_tried"].values.sum(axis=0)
    return np.where(often[:, None], found, np.nan)
