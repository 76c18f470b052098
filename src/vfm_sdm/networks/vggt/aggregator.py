"""Alternating attention: within each frame, then across all frames (VGGT, section 3.2)."""

from collections.abc import Collection

import torch
from torch import Tensor, nn

from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.encoder import ImageEncoder
from vfm_sdm.networks.vggt.layers import Block
from vfm_sdm.networks.vggt.rotary import rotary_table

__all__ = ["Aggregator"]

_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet's channels, which the encoder was trained with."""


class Aggregator(nn.Module):
    """Tokens of frames after attention to each other.

    The first frame has camera and register tokens of its own; all others share a second set.
    """

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.patch_embed = ImageEncoder(config)
        self.frame_blocks = nn.ModuleList(Block(width, config.heads, normalize=True) for _ in range(config.depth))
        self.global_blocks = nn.ModuleList(Block(width, config.heads, normalize=True) for _ in range(config.depth))
        self.camera_token = nn.Parameter(torch.zeros(1, 2, 1, width))
        self.register_token = nn.Parameter(torch.zeros(1, 2, config.registers, width))

    def forward(
        self, images: Tensor, keep: Collection[int], *, keep_dtype: torch.dtype | None = None
    ) -> dict[int, Tensor]:
        """Tokens after the layers that are asked for.

        Parameters
        ----------
        images
            Shape (S, 3, H, W), RGB in 0 .. 1, sides multiples of the patch.
        keep
            Layers, from 0. The others are dropped at once, and layers beyond the last one are not computed.
        keep_dtype
            Type of the result; the type of the computation when ``None``.

        Returns
        -------
        tokens
            Tokens by layer, shape (S, special + patches, 2 C): after attention within frames, beside those after
            attention across frames.
        """
        tokens = self._first_tokens(images)
        frames, count, width = tokens.shape
        patch = self.config.patch_size
        rotary = rotary_table(
            images.shape[-2] // patch,
            images.shape[-1] // patch,
            special=self.config.special_tokens,
            channels=width // self.config.heads,
            device=tokens.device,
            dtype=tokens.dtype,
        )
        kept: dict[int, Tensor] = {}
        for layer in range(max(keep) + 1):
            within = self.frame_blocks[layer](tokens, rotary)
            across = self.global_blocks[layer](within.reshape(1, frames * count, width), rotary)
            tokens = across.reshape(frames, count, width)
            if layer in keep:
                dtype = keep_dtype or tokens.dtype
                kept[layer] = torch.cat([within.to(dtype), tokens.to(dtype)], dim=-1)
            del within, across  # half a gigabyte that the next layer does not need
        return kept

    def _first_tokens(self, images: Tensor) -> Tensor:
        """Camera token, registers and patches of every frame, shape (S, special + patches, C)."""
        mean, std = (images.new_tensor(values).view(3, 1, 1) for values in (_MEAN, _STD))
        patches = self.patch_embed((images - mean) / std)
        special = torch.cat([self.camera_token, self.register_token], dim=2)[0]
        which = (torch.arange(len(images), device=images.device) > 0).long()
        return torch.cat([special[which].to(patches.dtype), patches], dim=1)
