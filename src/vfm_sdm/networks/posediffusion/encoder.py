"""The image encoder: a vision transformer, DINO (Caron et al., 2021), at three sizes of the picture."""

from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from vfm_sdm.networks.posediffusion.config import PoseDiffusionConfig
from vfm_sdm.networks.vggt.layers import Mlp, SelfAttention

__all__ = ["ImageFeatures", "scaled_pictures"]

_EPSILON = 1e-6
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_REDUCTIONS = (1, 2, 3)
_MORE_PLACES = 0.1
"""What DINO adds to the number of places when it resizes its table; the coordinates contain it, not the size alone."""


class ImageFeatures(nn.Module):
    """One feature a picture, (N, 3, H, W) to (N, width): the mean of three sizes of the picture."""

    def __init__(self, config: PoseDiffusionConfig) -> None:
        super().__init__()
        self._net = ImageEncoder(config)

    def forward(self, images: Tensor) -> Tensor:
        """Features, shape (N, width), of the pictures of N frames, shape (N, 3, H, W), RGB in 0 .. 1."""
        return torch.stack([self._net(scaled) for scaled in scaled_pictures(images)]).mean(dim=0)


def scaled_pictures(images: Tensor) -> list[Tensor]:
    """Normalised pictures, as large as they are, half and a third as large.

    Parameters
    ----------
    images
        RGB in 0 .. 1, shape (N, 3, H, W).

    Examples
    --------
    >>> [tuple(scaled.shape) for scaled in scaled_pictures(torch.zeros(1, 3, 224, 224))]
    [(1, 3, 224, 224), (1, 3, 112, 112), (1, 3, 74, 74)]
    """
    mean, std = (torch.tensor(values).to(images)[:, None, None] for values in (_MEAN, _STD))
    normalized = (images - mean) / std
    # By the factor: by the rounded size, pixels of the smallest one would lie elsewhere.
    return [
        normalized
        if reduction == 1
        else F.interpolate(normalized, scale_factor=1 / reduction, mode="bilinear", align_corners=False)
        for reduction in _REDUCTIONS
    ]


class ImageEncoder(nn.Module):
    """Class token after the last block, (N, 3, H, W) to (N, width); images are normalised.

    References
    ----------
    .. [1] Caron, M. et al. (2021). Emerging properties in self-supervised vision transformers. International Conference
       on Computer Vision.
    """

    def __init__(self, config: PoseDiffusionConfig) -> None:
        super().__init__()
        width, side = config.width, 224 // config.patch_size
        self.cls_token = nn.Parameter(torch.zeros(1, 1, width))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + side * side, width))
        patches = nn.Conv2d(3, width, config.patch_size, stride=config.patch_size)
        self.patch_embed = nn.Sequential(OrderedDict(proj=patches))
        self.blocks = nn.ModuleList(_Block(width, config.encoder_heads) for _ in range(config.encoder_depth))
        self.norm = nn.LayerNorm(width, eps=_EPSILON)

    def forward(self, images: Tensor) -> Tensor:
        """Class tokens, shape (N, width), of the normalised pictures of N frames, shape (N, 3, H, W) [1]."""
        tokens = self.embed(images)
        for block in self.blocks:
            tokens = block(tokens)
        y: Tensor = self.norm(tokens)[:, 0]
        return y

    def embed(self, images: Tensor) -> Tensor:
        """Tokens that enter the first block, class first, shape (N, 1 + patches, width).

        Parameters
        ----------
        images
            Normalised pictures of N frames, shape (N, 3, H, W) [1]; pixels beyond the last whole patch do not count.
        """
        patches = self.patch_embed(images)
        tokens = torch.cat([self.cls_token.expand(len(images), -1, -1), patches.flatten(2).transpose(1, 2)], dim=1)
        return tokens + self._places(*patches.shape[-2:])

    def _places(self, rows: int, columns: int) -> Tensor:
        """Position terms of all tokens, resampled to the number of patches."""
        class_place, table = self.pos_embed[:, :1], self.pos_embed[:, 1:]
        side = round(table.shape[1] ** 0.5)
        if (rows, columns) == (side, side):
            return self.pos_embed
        grid = table.unflatten(1, (side, side)).permute(0, 3, 1, 2)
        factors = tuple((count + _MORE_PLACES) / side for count in (rows, columns))
        grid = F.interpolate(grid, scale_factor=factors, mode="bicubic", align_corners=False)
        return torch.cat([class_place, grid.flatten(2).transpose(1, 2)], dim=1)


class _Block(nn.Module):
    """Pre-norm transformer block, (N, tokens, C) to (N, tokens, C)."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=_EPSILON)
        self.attn = SelfAttention(channels, heads)
        self.norm2 = nn.LayerNorm(channels, eps=_EPSILON)
        self.mlp = Mlp(channels, 4 * channels)

    def forward(self, x: Tensor) -> Tensor:
        """Tokens of frames after the block, shape (N, tokens, C) [1]."""
        x = x + self.attn(self.norm1(x))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y
