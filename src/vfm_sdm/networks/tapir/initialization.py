"""First estimate of every frame on its own, from the cost volume between query feature and coarse grid."""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from vfm_sdm.networks.tapir.config import LOWRES_STRIDE, TapirConfig
from vfm_sdm.networks.tapir.features import FeatureGrids, frame_chunks
from vfm_sdm.networks.tapir.results import Estimate, PointFeatures

__all__ = ["CostVolumeHeads", "initialize", "soft_argmax"]

NEIGHBOURHOOD_CELLS = 5.0
"""Cells nearer than this to the best one take part in the weighted mean."""


class CostVolumeHeads(nn.Module):
    """Position, occlusion and uncertainty from the similarity of a query to every cell of a frame."""

    def __init__(self, config: TapirConfig) -> None:
        super().__init__()
        heatmap, occlusion = config.heatmap_channels, config.occlusion_channels
        self.hid1 = nn.Conv2d(1, heatmap, 3, padding=1)
        self.hid2 = nn.Conv2d(heatmap, 1, 3, padding=1)
        self.hid3 = nn.Conv2d(heatmap, occlusion, 3, stride=2)
        self.hid4 = nn.Linear(occlusion, heatmap)
        self.occ_out = nn.Linear(heatmap, 2)
        self.softmax_temperature = config.softmax_temperature

    def forward(self, queries: Tensor, grid: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position and two logits of every query point in every frame.

        Parameters
        ----------
        queries
            Coarse features of the query points, shape (N, C) [1].
        grid
            Coarse feature grid of T frames, shape (T, C, h, w) [1].

        Returns
        -------
        position, occlusion, expected_dist
            Column and row, shape (N, T, 2) [px of the resized frame], and logits, shape (N, T) [1].

        Notes
        -----
        Section 3.1 of TAPIR [1]_. Memory grows with N T h w.

        References
        ----------
        .. [1] Doersch, C., Yang, Y., Vecerik, M., Gokay, D., Gupta, A., Aytar, Y., Carreira, J., Zisserman, A. (2023).
           TAPIR: tracking any point with per-frame initialization and temporal refinement. IEEE/CVF International
           Conference on Computer Vision.
        """
        cost = torch.einsum("nc,tchw->nthw", queries, grid)
        hidden = F.relu(self.hid1(cost.flatten(0, 1)[:, None]))
        heatmap = self.hid2(hidden)[:, 0] * self.softmax_temperature
        probability = heatmap.flatten(1).softmax(dim=-1).reshape(heatmap.shape)
        position = LOWRES_STRIDE * soft_argmax(probability)

        pooled = F.relu(self.hid3(F.pad(hidden, (0, 2, 0, 2)))).mean(dim=(2, 3))
        logits = self.occ_out(F.relu(self.hid4(pooled)))
        shape = cost.shape[:2]
        return position.reshape(*shape, 2), logits[:, 0].reshape(shape), logits[:, 1].reshape(shape)


def initialize(heads: CostVolumeHeads, grids: FeatureGrids, points: PointFeatures, *, frame_chunk: int = 1) -> Estimate:
    """Estimate of every frame on its own.

    Parameters
    ----------
    heads
        Heads of the network on the cost volume.
    grids
        Feature grids of T frames.
    points
        Features of N query points, shapes (N, C) and (N, C') [1].
    frame_chunk
        Frames that are computed at a time.

    Returns
    -------
    estimate
        Positions, shape (N, T, 2) [px of the resized frame], and logits, shape (N, T) [1].
    """
    parts = [heads(points.lowres, grids.lowres[frames]) for frames in frame_chunks(len(grids.lowres), frame_chunk)]
    return Estimate(*(torch.cat(of_frames, dim=1) for of_frames in zip(*parts, strict=True)))


def soft_argmax(probability: Tensor) -> Tensor:
    """Mean place of a map in the neighbourhood of its largest value.

    Parameters
    ----------
    probability
        Maps, shape (M, h, w) [1]; in the network, one for every frame of every point.

    Returns
    -------
    place
        Mean cell centre as x, y, shape (M, 2) [cells], the corner of the map being (0, 0).

    Examples
    --------
    >>> probability = torch.zeros(1, 8, 8)
    >>> probability[0, 2, 3:5] = 0.5
    >>> soft_argmax(probability).tolist()
    [[4.0, 2.5]]
    """
    height, width = probability.shape[1:]
    y, x = torch.meshgrid(
        torch.arange(height, dtype=probability.dtype, device=probability.device) + 0.5,
        torch.arange(width, dtype=probability.dtype, device=probability.device) + 0.5,
        indexing="ij",
    )
    centres = torch.stack([x.flatten(), y.flatten()], dim=-1)
    flat = probability.flatten(1)
    best = centres[flat.argmax(dim=-1)]
    near = ((centres - best[:, None]) ** 2).sum(dim=-1) < NEIGHBOURHOOD_CELLS**2
    weights = flat * near
    return weights @ centres / weights.sum(dim=-1, keepdim=True).clamp_min(1e-12)
