"""The square in the middle of a picture, which is all that the network sees."""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.networks.interface import RgbFrames

__all__ = ["SquareCrop", "crop_pictures"]


@dataclass(frozen=True)
class SquareCrop:
    """The largest square in the middle of a picture.

    Parameters
    ----------
    left, top, side
        Its first column and row, and its side [px].

    Examples
    --------
    >>> SquareCrop.of(131, 90)
    SquareCrop(left=20, top=0, side=90)
    """

    left: int
    top: int
    side: int

    @classmethod
    def of(cls, width: int, height: int) -> Self:
        """The square of a picture of this size [px]."""
        side = min(width, height)
        return cls((width - side) // 2, (height - side) // 2, side)

    def scale(self, size: int) -> float:
        """How much larger the picture is for the network, whose pictures have this side [px]."""
        return size / self.side

    def from_full(self, points2d: FloatArray, size: int) -> FloatArray:
        """Pixels of the network's picture.

        Parameters
        ----------
        points2d
            Pixels of the full picture, shape (..., 2) [px]. **Both count from the outer corner** of the top-left pixel,
            as the network's principal point does.
        size
            Side of the network's picture [px].

        Examples
        --------
        >>> import numpy as np
        >>> SquareCrop(20, 0, 112).from_full(np.array([20.5, 0.5]), 224).tolist()
        [1.0, 1.0]
        """
        return (points2d - [self.left, self.top]) * self.scale(size)


def crop_pictures(pictures: list[RgbFrames], size: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """Pictures as the network takes them, shape (N, 3, size, size), RGB in 0 .. 1.

    Parameters
    ----------
    pictures
        Red, green and blue, shape (height, width, 3) each.
    size
        Side of the network's pictures [px].
    dtype
        Type of the result.

    Notes
    -----
    Resized bilinearly without a low-pass filter also where pictures shrink: as the published demo does it, unlike the
    training.
    """
    cropped = []
    for picture in pictures:
        square = SquareCrop.of(picture.shape[1], picture.shape[0])
        part = picture[square.top : square.top + square.side, square.left : square.left + square.side]
        # In this order of dimensions in memory, PyTorch sums as it did for the reference numbers.
        pixels = torch.tensor(part).permute(2, 0, 1).contiguous().to(dtype)[None] / 255
        cropped.append(F.interpolate(pixels, size=(size, size), mode="bilinear", align_corners=False))
    return torch.cat(cropped)
