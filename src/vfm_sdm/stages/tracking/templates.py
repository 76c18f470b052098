"""Subsets of the reference frame as they look where they were seen last: turned and strained, for a search."""

from dataclasses import replace

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX, SubsetDesign
from vfm_sdm.stages.registration.peaks import cut_subset
from vfm_sdm.stages.registration.subsets import SubsetBank

__all__ = ["WarpedTemplates"]

_STRAIGHT_PX = 0.5
"""A corner of a subset that a turn moves by less is where the search, in whole pixels, expects it [px]."""


class WarpedTemplates:
    """Templates of the subsets of a bank under warps.

    Parameters
    ----------
    reference
        The frame they come from, shape (H, W).
    bank
        The subsets.
    """

    def __init__(self, reference: LumaArray, bank: SubsetBank) -> None:
        self._reference, self._bank = reference, bank

    def cut(self, row: int, affine: FloatArray) -> tuple[LumaArray, SubsetDesign | None]:
        """The subset as it looks under the linear part of a warp, and its design with the mask that goes with it.

        Parameters
        ----------
        row
            Row of a usable subset of the bank.
        affine
            Linear part row by row, shape (4,) [1].

        Returns
        -------
        template
            Shape (S, S) [grey levels].
        design
            ``None`` where the bank has no designs.
        """
        bank, A = self._bank, affine.reshape(2, 2)
        half, center = int(bank.subset_px[row]) // 2, bank.centers[row]
        design = None if bank.designs is None else bank.designs[row]
        if half * np.abs(A - np.eye(2)).sum(axis=1).max() <= _STRAIGHT_PX or np.linalg.det(A) <= 0:
            return cut_subset(self._reference, center, half), design
        back = np.asarray(np.linalg.inv(A), np.float64)
        template = self._warp(self._reference, back, center, half, cv2.INTER_LINEAR)
        if design is None or design.mask is None:
            return template, design
        mask = self._warp(design.mask.astype(np.uint8), back, np.array([half, half]), half, cv2.INTER_NEAREST) > 0
        return template, replace(design, mask=mask) if np.count_nonzero(mask) >= FEWEST_BELIEVED_PX else design

    def _warp(self, image: LumaArray, back: FloatArray, center: FloatArray, half: int, how: int) -> LumaArray:
        """The square around a pixel of an image, of which places come from those under a linear map (2, 2)."""
        middle = np.array([half, half])
        moved = np.column_stack([back, center - back @ middle])
        side = (2 * half + 1, 2 * half + 1)
        flags = how | cv2.WARP_INVERSE_MAP
        turned = cv2.warpAffine(image, moved, side, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return turned.astype(np.uint8) if image.dtype == np.uint8 else turned.astype(np.uint16)
