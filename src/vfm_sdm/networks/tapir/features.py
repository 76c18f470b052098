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
    """Features of T frames: fine (T, C, H/4, W/4), coarse (T, C', H/8, W/8), and the coarse ones pooled further.

    ``resolution`` is the (H, W) the video was resized to.
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
        """Features of query points (N, 3) as t, y, x in pixels of a video of the given size."""

        def sampled(grid: Tensor) -> Tensor:
            height, width = grid.shape[2] / image_size[0], grid.shape[3] / image_size[1]
            return sample_trilinear(grid, queries * queries.new_tensor([1.0, height, width]))

        return PointFeatures(sampled(self.hires), sampled(self.lowres))


def frame_chunks(frames: int, length: int) -> Iterator[slice]:
    """Slices of at most ``length`` that cover the frames in order."""
    for first in range(0, frames, length):
        yield slice(first, min(first + length, frames))


def scale_between(source: Resolution, target: Resolution, like: Tensor) -> Tensor:
    """Factors (2,) that take x, y of a source image of (height, width) to a target image."""
    return torch.tensor([target[1] / source[1], target[0] / source[0]], dtype=like.dtype, device=like.device)
