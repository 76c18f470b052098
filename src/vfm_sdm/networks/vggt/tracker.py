"""Points followed through frames in their feature maps (VGGT, section 3.3; after CoTracker, Karaev et al., 2024)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.correlation import clamp_to, correlate, make_pyramid, sample_linear
from vfm_sdm.networks.vggt.layers import Mlp
from vfm_sdm.networks.vggt.updates import UpdateTransformer

__all__ = ["PointTracker", "PointTracks"]

_STRIDE = 2
"""Image pixels a cell of the feature map."""
_LONGEST_SIDE = 518
"""Length by which displacements are divided where they enter as numbers [cells]."""
_HIGHEST_FREQUENCY = 1000.0
"""Highest frequency of the displacement's embedding [rad a cell]."""


@dataclass(frozen=True, eq=False)
class PointTracks:
    """Where points were found.

    Parameters
    ----------
    positions
        After every iteration: column and row of the image, shape (iterations, G, N, S, 2) [px].
    visibility, confidence
        Shape (G, N, S), 0 to 1.
    """

    positions: Tensor
    visibility: Tensor
    confidence: Tensor


class PointTracker(nn.Module):
    """Iterative tracker on feature maps.

    References
    ----------
    .. [1] Wang, J., Chen, M., Karaev, N., Vedaldi, A., Rupprecht, C., Novotny, D. (2025). VGGT: visual geometry
       grounded transformer. IEEE/CVF Conference on Computer Vision and Pattern Recognition.
    .. [2] Karaev, N., Rocco, I., Graham, B., Neverova, N., Vedaldi, A., Rupprecht, C. (2024). CoTracker: it is better
       to track together. European Conference on Computer Vision.
    """

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        self.config = config
        features = config.features
        self.input_channels = 3 * features + 4
        self.corr_mlp = Mlp(config.levels * (2 * config.radius + 1) ** 2, config.hidden, features)
        self.query_ref_token = nn.Parameter(torch.zeros(1, 2, self.input_channels))
        self.updateformer = UpdateTransformer(config, self.input_channels, features + 2)
        self.fmap_norm = nn.LayerNorm(features)
        self.ffeat_norm = nn.GroupNorm(1, features)
        self.ffeat_updater = nn.Sequential(nn.Linear(features, features), nn.GELU())
        self.vis_predictor = nn.Sequential(nn.Linear(features, 1))
        self.conf_predictor = nn.Sequential(nn.Linear(features, 1))

    def forward(self, features: Tensor, queries: Tensor) -> PointTracks:
        """Tracks of points given in the first frame.

        Parameters
        ----------
        features
            Maps of `vfm_sdm.networks.vggt.feature_head.FeatureHead`, shape (S, features, H / 2, W / 2) [1].
        queries
            Column and row in the first frame, shape (G, N, 2) [px]. The N points of a group see each other through the
            virtual tracks; groups are as if run alone.
        """
        maps = self.fmap_norm(features.permute(0, 2, 3, 1).to(queries.dtype))
        pyramid = make_pyramid(maps, self.config.levels)
        start = queries / _STRIDE
        positions = start.unsqueeze(2).repeat(1, 1, len(maps), 1)
        seen = sample_linear(maps[0], start.flatten(0, 1)).unflatten(0, start.shape[:2])
        tracks = seen.unsqueeze(2).repeat(1, 1, len(maps), 1)
        constant = self._constant_input(start, maps.shape[1:3], len(maps))
        history = []
        for _ in range(self.config.track_iterations):
            update = self.updateformer(self._gather_input(pyramid, tracks, positions) + constant).to(positions.dtype)
            tracks = tracks + self._feature_update(update[..., 2:])
            positions = positions + update[..., :2]
            positions[:, :, 0] = start
            history.append(positions * _STRIDE)
        visibility, confidence = (
            torch.sigmoid(predictor(tracks))[..., 0].to(positions.dtype)
            for predictor in (self.vis_predictor, self.conf_predictor)
        )
        return PointTracks(torch.stack(history), visibility, confidence)

    def _gather_input(self, pyramid: list[Tensor], tracks: Tensor, positions: Tensor) -> Tensor:
        """Input that changes with the iterations, shape (G, N, S, input channels)."""
        windows = correlate(pyramid, tracks.flatten(0, 1), positions.flatten(0, 1), radius=self.config.radius)
        likeness = self.corr_mlp(windows).unflatten(0, tracks.shape[:2]).to(tracks.dtype)
        flow = positions - positions[:, :, :1]
        embedded = embed_flow(flow, self.config.features // 2)
        scaled = flow / _LONGEST_SIDE
        return torch.cat([embedded, scaled, scaled, likeness, tracks], dim=-1)

    def _constant_input(self, start: Tensor, size: torch.Size, frames: int) -> Tensor:
        """Where the points started, and which frame is the first, shape (G, N, S, input channels)."""
        place = embed_place(start, (size[0], size[1]), self.input_channels).unsqueeze(2)
        first, later = self.query_ref_token[0].to(place.dtype)
        return place + torch.cat([first[None], later.expand(frames - 1, -1)])

    def _feature_update(self, update: Tensor) -> Tensor:
        normed = self.ffeat_norm(update.flatten(0, 2)).unflatten(0, update.shape[:3])
        y: Tensor = self.ffeat_updater(normed).to(update.dtype)
        return y


def embed_flow(flow: Tensor, channels: int) -> Tensor:
    """Sines and cosines of displacements.

    Parameters
    ----------
    flow
        Displacements from the first frame, shape (..., 2) [cells].
    channels
        Channels of a component: sine and cosine in turn, of ``channels / 2`` evenly spaced frequencies from zero.

    Returns
    -------
    embedded
        Shape (..., 2 channels) [1]: columns, then rows.

    Notes
    -----
    The highest frequency turns a millionth of a cell into a thousandth: the iterations amplify rounding.

    Examples
    --------
    >>> embed_flow(torch.zeros(1, 2), 4).tolist()
    [[0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0]]
    """
    steps = torch.arange(0, channels, 2, device=flow.device, dtype=torch.float32)
    angles = flow.unsqueeze(-1) * (steps * (_HIGHEST_FREQUENCY / channels)).to(flow.dtype)
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(-3)


def embed_place(positions: Tensor, size: tuple[int, int], channels: int) -> Tensor:
    """Sine and cosine embedding of places on a grid, interpolated linearly between its cells.

    Parameters
    ----------
    positions
        Column and row, shape (..., 2) [cells]; outside the grid, those of its border.
    size
        Rows and columns of the grid.
    channels
        Channels of the embedding: the first half for the column, the second for the row.

    Returns
    -------
    embedded
        Shape (..., channels) [1].

    Examples
    --------
    >>> embed_place(torch.zeros(1, 2), (4, 6), 8).tolist()
    [[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]]
    """
    count = channels // 4
    steps = torch.arange(count, device=positions.device, dtype=torch.float32)
    frequencies = 10000.0 ** (-steps / count)
    place = clamp_to(positions, *size)
    corner = place.floor()
    fraction = (place - corner).unsqueeze(-1)

    def embed(cells: Tensor) -> Tensor:
        angles = cells.float().unsqueeze(-1) * frequencies
        return torch.cat([angles.sin(), angles.cos()], dim=-1).to(positions.dtype)

    table = (1 - fraction) * embed(corner) + fraction * embed(clamp_to(corner + 1, *size))
    return table.flatten(-2)
