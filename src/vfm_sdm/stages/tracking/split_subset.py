"""Left and right halves of subsets, tracked by themselves: where they move apart, a subset covers two motions."""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX
from vfm_sdm.stages.registration.subsets import RawRegistration, SubsetBank, SubsetDesign

__all__ = ["SplitSubsets"]

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
        self._tried = np.zeros(len(whole), np.int64)

    def advance(self, luma: LumaArray, found: RawRegistration) -> None:
        """Takes the next frame, and where the whole subsets were found in it.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        found
            Registrations of the P whole subsets in it.
        """
        difference = np.full((len(self._whole), 2), np.nan)
        if self._bank is not None and len(self._found) % _EVERY == 0:
            difference, halves = self._measure(self._bank, luma, found)
            if self._whole.designs is not None:
                self._halves[len(self._found)] = halves
            self._tried += found.converged
        self._found.append(difference)

    def differences(self) -> FloatArray:
        """How far the right halves moved beyond the left ones, shape (T, P, 2) [px]; NaN where not tracked.

        Halves of designed subsets that are often not found have too little to follow, and are NaN throughout.
        """
        found = np.stack(self._found)
        if self._whole.designs is None:
            return found
        often = np.isfinite(found).all(axis=2).sum(axis=0) >= _OFTEN * self._tried
        return np.where(often[:, None], found, np.nan)

    def covariances(self) -> FloatArray:
        """Covariances of these differences, shape (T, P, 2, 2) [px2]; NaN where the subsets were not designed."""
        covariances = np.full((len(self._found), len(self._whole), 2, 2), np.nan)
        if self._bank is not None and self._halves:
            stated = self._bank.interpret(RawRegistration.joined(list(self._halves.values()))).covariance
            covariances[list(self._halves)] = stated.reshape(len(self._halves), 2, len(self._whole), 2, 2).sum(axis=1)
        return covariances

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
