"""The image encoder: a vision transformer with registers, DINOv2 (Oquab et al., 2024; Darcet et al., 2024)."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.layers import Block

__all__ = ["ImageEncoder"]

_EPSILON = 1e-6


class ImageEncoder(nn.Module):
    """Patch tokens of images, (S, 3, H, W) to (S, patches, C); images are normalised, sides multiples of the patch.

    References
    ----------
    .. [1] Oquab, M. et al. (2024). DINOv2: learning robust visual features without supervision. Transactions on Machine
       Learning Research.
    .. [2] Darcet, T., Oquab, M., Mairal, J., Bojanowski, P. (2024). Vision transformers need registers. International
       Conference on Learning Representations.
    """

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        width, side = config.width, config.image_size // config.patch_size
        self.patch_embed = _PatchProjection(width, config.patch_size)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, width))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + side * side, width))
        self.register_tokens = nn.Parameter(torch.zeros(1, config.registers, width))
        # Stored in the checkpoints, without use after training.
        self.mask_token = nn.Parameter(torch.zeros(1, width))
        self.blocks = nn.ModuleList(
            Block(width, config.encoder_heads, epsilon=_EPSILON) for _ in range(config.encoder_depth)
        )
        self.norm = nn.LayerNorm(width, eps=_EPSILON)

    def forward(self, images: Tensor) -> Tensor:
        """Patch tokens, shape (S, patches, C), of the images of S frames, shape (S, 3, H, W), row by row."""
        tokens = self.embed(images)
        for block in self.blocks:
            tokens = block(tokens)
        y: Tensor = self.norm(tokens[:, tokens.shape[1] - self._patches(images) :])
        return y

    def embed(self, images: Tensor) -> Tensor:
        """Tokens that enter the first block: class, registers, patches.

        Parameters
        ----------
        images
            Normalised images of S frames, shape (S, 3, H, W) [1].

        Returns
        -------
        tokens
            Shape (S, 1 + registers + patches, C) [1].
        """
        patches = self.patch_embed(images)
        class_place, places = self._places(*patches.shape[-2:])
        count = len(images)
        return torch.cat(
            [
                (self.cls_token + class_place).expand(count, -1, -1),
                self.register_tokens.expand(count, -1, -1),
                patches.flatten(2).transpose(1, 2) + places,
            ],
            dim=1,
        )

    def _patches(self, images: Tensor) -> int:
        size = self.patch_embed.proj.kernel_size[0]
        return (images.shape[-2] // size) * (images.shape[-1] // size)

    def _places(self, rows: int, columns: int) -> tuple[Tensor, Tensor]:
        """Position terms of the class token and of the patches, resampled to their number."""
        class_place, table = self.pos_embed[:, :1], self.pos_embed[:, 1:]
        side = round(table.shape[1] ** 0.5)
        if (rows, columns) == (side, side):
            return class_place, table
        grid = table.unflatten(1, (side, side)).permute(0, 3, 1, 2).float()
        grid = F.interpolate(grid, size=(rows, columns), mode="bicubic", antialias=True, align_corners=False)
        return class_place, grid.flatten(2).transpose(1, 2).to(table.dtype)


class _PatchProjection(nn.Module):
    """One token of every patch."""

    def __init__(self, width: int, patch_size: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, patch_size, stride=patch_size)

    def forward(self, images: Tensor) -> Tensor:
        """Patches, shape (S, C, rows, columns), of the images of S frames, shape (S, 3, H, W)."""
        y: Tensor = self.proj(images)
        return y
