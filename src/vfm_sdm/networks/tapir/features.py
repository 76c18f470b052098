"""Feature grids of a video at one resolution, and the features of query points in them."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from vfm_sdm.networks.tapir.config import Resolution
from vfm_sdm.networks.tapir.results import PointFeatures
from vfm_sdm.networks.tapir.sampling import sample_trilinear

__all__ = ["FeatureGrids", "frame_chunks", "scale_between"]


@dataclass(frozen=True)
class FeatureGrids:
    """Features of the frames of a video that was resized to one resolution.

    Parameters
    ----------
    hires
        Fine features, shape (T, C, H/4, W/4) [1].
    lowres
        Coarse features, shape (T, C', H/8, W/8) [1].
    pooled
        The coarse features pooled further, each to half the size of the one before.
    resolution
        Height H and width W that the video was resized to [px].
    """

    hires: Tensor
    lowres: Tensor
    pooled: tuple[Tensor, ...]
    resolution: Resolution

    @property
    def pyramid(self) -> tuple[Tensor, ...]:
        """The grids that the refinement correlates with, finest first."""
        return (self.hires, self.lowres, *self.pooled)

    def at(self, queries: Tensor, image_size: Resolution) -> PointFeatures:
        """Features of query points.

        Parameters
        ----------
        queries
            Frame index, row and column, shape (N, 3) [frames, px, px].
        image_size
            Height and width of the video that the pixels belong to [px].

        Returns
        -------
        features
            Shapes (N, C) and (N, C') [1].
        """

        def sampled(grid: Tensor) -> Tensor:
            height, width = grid.shape[2] / image_size[0], grid.shape[3] / image_size[1]
            return sample_trilinear(grid, queries * queries.new_tensor([1.0, height, width]))

        return PointFeatures(sampled(self.hires), sampled(self.lowres))


def frame_chunks(frames: int, length: int) -> Iterator[slice]:
    """Slices that cover the frames in order.

    Parameters
    ----------
    frames
        Number of frames, the first dimension of what is sliced.
    length
        Frames of a slice; the last one may be shorter.

    Examples
    --------
    >>> [(chunk.start, chunk.stop) for chunk in frame_chunks(5, 2)]
    [(0, 2), (2, 4), (4, 5)]
    """
    for first in range(0, frames, length):
        yield slice(first, min(first + length, frames))


def scale_between(source: Resolution, target: Resolution, like: Tensor) -> Tensor:
    """Factors that take x, y of a source image to a target image, shape (2,) [px of the target per px of the source].

    Parameters
    ----------
    source, target
        Height and width of the images [px].
    like
        A tensor of the device and the type of the result.

    Examples
    --------
    >>> scale_between((240, 320), (480, 320), torch.zeros(1)).tolist()
    [1.0, 2.0]
    """
    return torch.tensor([target[1] / source[1], target[0] / source[0]], dtype=like.dtype, device=like.device)
