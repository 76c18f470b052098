"""Feature map at half the image's resolution: a dense prediction transformer (Ranftl et al., ICCV 2021)."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from vfm_sdm.networks.vggt.config import VggtConfig

__all__ = ["FeatureHead"]

_FRAMES = 8
"""Frames that are computed at a time. They do not depend on each other; more of them only take more memory."""


class FeatureHead(nn.Module):
    """Feature maps of frames from four layers of the aggregator.

    References
    ----------
    .. [1] Ranftl, R., Bochkovskiy, A., Koltun, V. (2021). Vision transformers for dense prediction. IEEE/CVF
       International Conference on Computer Vision.
    """

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        self.config = config
        width = 2 * config.width
        one, two, three, four = config.feature_channels
        self.norm = nn.LayerNorm(width)
        self.projects = nn.ModuleList(nn.Conv2d(width, channels, 1) for channels in config.feature_channels)
        self.resize_layers = nn.ModuleList(
            [
                nn.ConvTranspose2d(one, one, 4, stride=4),
                nn.ConvTranspose2d(two, two, 2, stride=2),
                nn.Identity(),
                nn.Conv2d(four, four, 3, stride=2, padding=1),
            ]
        )
        self.scratch = _Fusion((one, two, three, four), config.features)

    def forward(self, tokens: Mapping[int, Tensor], image_size: tuple[int, int]) -> Tensor:
        """Feature maps.

        Parameters
        ----------
        tokens
            Tokens of S frames by layer, shape (S, special + patches, 2 C) [1].
        image_size
            Height and width of the image [px].

        Returns
        -------
        features
            Shape (S, features, H / 2, W / 2) [1].
        """
        layers = [tokens[layer] for layer in self.config.feature_layers]
        # Never in reduced precision: positions are read off these maps to a fraction of a cell.
        height, width = image_size
        dtype = self.norm.weight.dtype
        shape = (len(layers[0]), self.config.features, height // 2, width // 2)
        # Channels last in memory, as the tracker reads them: another order would be copied.
        found = torch.empty(shape, dtype=dtype, device=layers[0].device, memory_format=torch.channels_last)
        with torch.autocast(found.device.type, enabled=False):
            for start in range(0, len(found), _FRAMES):
                few = slice(start, start + _FRAMES)
                found[few] = self._map_frames([layer[few].to(dtype) for layer in layers], image_size)
        return found

    def _map_frames(self, layers: list[Tensor], image_size: tuple[int, int]) -> Tensor:
        """Feature maps of a few frames, shape (S, features, H / 2, W / 2)."""
        height, width = image_size
        y: Tensor = self.scratch(self.maps(layers, image_size))
        return F.interpolate(y, size=(height // 2, width // 2), mode="bilinear", align_corners=True)

    def maps(self, layers: list[Tensor], image_size: tuple[int, int]) -> list[Tensor]:
        """Maps of the four layers, at 4, 2, 1 and 1/2 cells a patch.

        Parameters
        ----------
        layers
            Tokens of S frames, shape (S, special + patches, 2 C) each [1].
        image_size
            Height and width of the image [px].

        Returns
        -------
        maps
            Shape (S, channels, rows, columns) each [1].
        """
        patch = self.config.patch_size
        grid = (image_size[0] // patch, image_size[1] // patch)
        found = []
        for layer, project, resize in zip(layers, self.projects, self.resize_layers, strict=True):
            patches = self.norm(layer[:, self.config.special_tokens :])
            found.append(resize(project(patches.transpose(1, 2).unflatten(2, grid))))
        return found


class _Fusion(nn.Module):
    """Four maps made into one, from the coarsest to the finest."""

    def __init__(self, channels: tuple[int, ...], features: int) -> None:
        super().__init__()
        for level, count in enumerate(channels, start=1):
            self.add_module(f"layer{level}_rn", nn.Conv2d(count, features, 3, padding=1, bias=False))
            self.add_module(f"refinenet{level}", _FusionStep(features, joins=level < len(channels)))
        self.output_conv1 = nn.Conv2d(features, features, 3, padding=1)
        self.levels = len(channels)

    def forward(self, maps: list[Tensor]) -> Tensor:
        """One map from four, given from fine to coarse, shape (S, channels, rows, columns) each.

        The result has twice the size of the finest one; S is the number of frames.
        """
        reduced = [self.get_submodule(f"layer{level}_rn")(m) for level, m in enumerate(maps, start=1)]
        fused: Tensor | None = None
        for level in range(self.levels, 0, -1):
            finer = reduced[level - 2].shape[-2:] if level > 1 else [2 * n for n in reduced[0].shape[-2:]]
            step = self.get_submodule(f"refinenet{level}")
            fused = step(reduced[level - 1], fused, size=finer)
        y: Tensor = self.output_conv1(fused)
        return y


class _FusionStep(nn.Module):
    """A map joined with the sum of the coarser ones, then enlarged."""

    def __init__(self, features: int, *, joins: bool) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(features, features, 1)
        if joins:
            self.resConfUnit1 = _ResidualUnit(features)
        self.resConfUnit2 = _ResidualUnit(features)

    def forward(self, own: Tensor, coarser: Tensor | None, *, size: list[int]) -> Tensor:
        """Maps of S frames, shape (S, features, rows, columns), joined with coarser ones and enlarged to ``size``."""
        joined = own if coarser is None else coarser + self.resConfUnit1(own)
        enlarged = F.interpolate(self.resConfUnit2(joined), size=size, mode="bilinear", align_corners=True)
        y: Tensor = self.out_conv(enlarged)
        return y


class _ResidualUnit(nn.Module):
    """Two convolutions beside a shortcut that carries the *rectified* input, as the checkpoints were trained with."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(features, features, 3, padding=1)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Maps of S frames, shape (S, features, rows, columns), to the same shape."""
        rectified = F.relu(x)
        y: Tensor = rectified + self.conv2(F.relu(self.conv1(rectified)))
        return y
