"""The update transformer of the tracker: attention over time, and between points through virtual tracks.

After CoTracker (Karaev et al., ECCV 2024), which VGGT builds its tracking head on (section 3.3).
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.layers import Mlp

__all__ = ["UpdateTransformer"]


class UpdateTransformer(nn.Module):
    """Corrections of tracks from what was seen along them.

    Parameters
    ----------
    config
        Sizes.
    channels
        Channels of the input.
    out
        Channels of the correction.

    References
    ----------
    .. [1] Karaev, N., Rocco, I., Graham, B., Neverova, N., Vedaldi, A., Rupprecht, C. (2024). CoTracker: it is better
       to track together. European Conference on Computer Vision.
    """

    def __init__(self, config: VggtConfig, channels: int, out: int) -> None:
        super().__init__()
        hidden, heads, depth = config.hidden, config.track_heads, config.track_depth
        self.virtual_tracks = config.virtual_tracks
        # The checkpoints spell it so.
        self.virual_tracks = nn.Parameter(torch.zeros(1, config.virtual_tracks, 1, hidden))
        self.input_norm = nn.LayerNorm(channels)
        self.input_transform = nn.Linear(channels, hidden)
        self.time_blocks = nn.ModuleList(_SelfBlock(hidden, heads) for _ in range(depth))
        self.space_virtual2point_blocks = nn.ModuleList(_CrossBlock(hidden, heads) for _ in range(depth))
        self.space_virtual_blocks = nn.ModuleList(_SelfBlock(hidden, heads) for _ in range(depth))
        self.space_point2virtual_blocks = nn.ModuleList(_CrossBlock(hidden, heads) for _ in range(depth))
        self.output_norm = nn.LayerNorm(hidden)
        self.flow_head = nn.Linear(hidden, out)

    def forward(self, x: Tensor) -> Tensor:
        """Corrections.

        Parameters
        ----------
        x
            What was seen, shape (G, N, S, channels) [1]: G groups that do not see each other, N points of a group that
            do, S frames.

        Returns
        -------
        corrections
            Shape (G, N, S, out) [cells, 1].
        """
        groups, points, frames, _ = x.shape
        start = self.input_transform(self.input_norm(x))
        virtual = self.virual_tracks.expand(groups, -1, frames, -1)
        tracks = torch.cat([start, virtual.to(start.dtype)], dim=1)
        for level, time in enumerate(self.time_blocks):
            tracks = time(tracks.flatten(0, 1)).unflatten(0, (groups, -1))
            own, others = (
                part.transpose(1, 2).flatten(0, 1) for part in tracks.split([points, self.virtual_tracks], 1)
            )
            others = self.space_virtual2point_blocks[level](others, own)
            others = self.space_virtual_blocks[level](others)
            own = self.space_point2virtual_blocks[level](own, others)
            tracks = torch.cat([own, others], dim=1).unflatten(0, (groups, frames)).transpose(1, 2)
        # A correction in reduced precision would itself be rounded, to a 256th of its size.
        with torch.autocast(x.device.type, enabled=False):
            y: Tensor = self.flow_head(self.output_norm((start + tracks[:, :points]).to(x.dtype)))
        return y


class _Attention(nn.Module):
    """Multi-head attention with the parameters of `torch.nn.MultiheadAttention`."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.zeros(3 * channels, channels))
        self.in_proj_bias = nn.Parameter(torch.zeros(3 * channels))
        self.out_proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor, context: Tensor | None = None) -> Tensor:
        """Tokens of frames, shape (B, N, C), that attend to a context, shape (B, M, C), or to themselves."""
        channels = x.shape[-1]
        weight, bias = self.in_proj_weight, self.in_proj_bias
        if context is None:
            query, key, value = F.linear(x, weight, bias).chunk(3, dim=-1)
        else:
            query = F.linear(x, weight[:channels], bias[:channels])
            key, value = F.linear(context, weight[channels:], bias[channels:]).chunk(2, dim=-1)
        split = (part.unflatten(2, (self.heads, -1)).transpose(1, 2) for part in (query, key, value))
        y: Tensor = self.out_proj(F.scaled_dot_product_attention(*split).transpose(1, 2).flatten(2))
        return y


class _SelfBlock(nn.Module):
    """Attention and MLP whose shortcut starts from the *normalised* input, as the checkpoints were trained with."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels)
        self.attn = _Attention(channels, heads)
        self.norm2 = nn.LayerNorm(channels)
        self.mlp = Mlp(channels, 4 * channels)

    def forward(self, x: Tensor) -> Tensor:
        """Tokens of frames, shape (B, N, C), to the same shape."""
        x = self.norm1(x)
        x = x + self.attn(x)
        y: Tensor = x + self.mlp(self.norm2(x))
        return y


class _CrossBlock(nn.Module):
    """Attention to other tokens and MLP, with the same shortcut as in `_SelfBlock`."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels)
        self.norm_context = nn.LayerNorm(channels)
        self.cross_attn = _Attention(channels, heads)
        self.norm2 = nn.LayerNorm(channels)
        self.mlp = Mlp(channels, 4 * channels)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """Tokens of frames, shape (B, N, C), that attend to others, shape (B, M, C)."""
        x = self.norm1(x)
        x = x + self.cross_attn(x, self.norm_context(context))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y
