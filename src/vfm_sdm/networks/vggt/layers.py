"""Transformer blocks that the encoder, the aggregator and the camera head share."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812  (PyTorch's own abbreviation)

from vfm_sdm.networks.vggt.rotary import RotaryTable, rotate

__all__ = ["Block", "Mlp", "SelfAttention"]


class Mlp(nn.Module):
    """Two linear layers with the exact GELU between them.

    Examples
    --------
    >>> tuple(Mlp(4, 8, 2)(torch.zeros(3, 4)).shape)
    (3, 2)
    """

    def __init__(self, channels: int, hidden: int, out: int | None = None) -> None:
        super().__init__()
        self.fc1 = nn.Linear(channels, hidden)
        self.fc2 = nn.Linear(hidden, out or channels)

    def forward(self, x: Tensor) -> Tensor:
        """Tokens of frames, shape (..., channels), to shape (..., out) [1]."""
        y: Tensor = self.fc2(F.gelu(self.fc1(x)))
        return y


class SelfAttention(nn.Module):
    """Multi-head attention of tokens among themselves, (B, N, C) to (B, N, C).

    Parameters
    ----------
    channels, heads
        Channels of the tokens, and number of heads; every head has ``channels / heads``.
    normalize
        Whether queries and keys are layer-normalised within a head.
    """

    def __init__(self, channels: int, heads: int, *, normalize: bool = False) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        if normalize:
            self.q_norm = nn.LayerNorm(channels // heads)
            self.k_norm = nn.LayerNorm(channels // heads)
        self.normalize = normalize
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor, rotary: RotaryTable | None = None) -> Tensor:
        """Tokens after attention.

        Parameters
        ----------
        x
            Tokens of frames, shape (B, N, C) [1].
        rotary
            Turns queries and keys by the place of their patch.
        """
        query, key, value = self.qkv(x).unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        if self.normalize:
            query, key = self.q_norm(query), self.k_norm(key)
        if rotary is not None:
            # One after the other, so that only one of them is in memory twice.
            query = rotate(query, rotary)
            key = rotate(key, rotary)
        mixed = F.scaled_dot_product_attention(query.to(value.dtype), key.to(value.dtype), value)
        y: Tensor = self.proj(mixed.transpose(1, 2).flatten(2))
        return y


class LayerScale(nn.Module):
    """A branch added to what it branched off, by a learned factor a channel."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(channels))

    def forward(self, x: Tensor, branch: Tensor) -> Tensor:
        """``x + gamma branch`` for tokens of frames, shapes (..., channels) [1], in one pass over memory."""
        return torch.addcmul(x, branch.to(x.dtype), self.gamma)


class Block(nn.Module):
    """Pre-norm transformer block with layer scale, (B, N, C) to (B, N, C).

    Parameters
    ----------
    channels, heads
        As in `SelfAttention`.
    epsilon
        Smallest variance of the layer norms [1]: 1e-6 in the encoder, 1e-5 elsewhere.
    normalize
        As in `SelfAttention`.
    """

    def __init__(self, channels: int, heads: int, *, epsilon: float = 1e-5, normalize: bool = False) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=epsilon)
        self.attn = SelfAttention(channels, heads, normalize=normalize)
        self.ls1 = LayerScale(channels)
        self.norm2 = nn.LayerNorm(channels, eps=epsilon)
        self.mlp = Mlp(channels, 4 * channels)
        self.ls2 = LayerScale(channels)

    def forward(self, x: Tensor, rotary: RotaryTable | None = None) -> Tensor:
        """Tokens after the block.

        Parameters
        ----------
        x
            Tokens of frames, shape (B, N, C) [1].
        rotary
            As in `SelfAttention.forward`.
        """
        x = self.ls1(x, self.attn(self.norm1(x), rotary))
        y: Tensor = self.ls2(x, self.mlp(self.norm2(x)))
        return y
