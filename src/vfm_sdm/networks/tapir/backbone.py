"""Feature grids of single frames: a residual network with instance norms, and BootsTAPIR's extra convolutions."""

from typing import cast

import torch
import torch.nn.functional as F  # noqa: N812 (the field's name for it)
from torch import Tensor, nn

from vfm_sdm.networks.tapir.config import TapirConfig

__all__ = ["ExtraConvs", "ResNet", "normalize_channels"]

STRIDES = (1, 2, 2, 1)
"""Strides of the four residual groups; the first convolution halves the image before them."""


def conv3x3(channels_in: int, channels_out: int, stride: int = 1) -> nn.Conv2d:
    """Bias-free 3 x 3 convolution of feature maps (T, C, h, w) of frames; with stride 2 the caller pads.

    Parameters
    ----------
    channels_in, channels_out
        Channels of the input and of the output.
    stride
        Step of the convolution [cells].

    Examples
    --------
    >>> tuple(conv3x3(2, 4)(torch.zeros(1, 2, 8, 8)).shape)
    (1, 4, 8, 8)
    """
    return nn.Conv2d(channels_in, channels_out, 3, stride, padding=1 if stride == 1 else 0, bias=False)


class ResidualBlock(nn.Module):
    """Pre-activation residual block; the first of a group projects its shortcut from the activated input."""

    def __init__(self, channels_in: int, channels_out: int, *, stride: int, project: bool) -> None:
        super().__init__()
        self.bn_0 = nn.InstanceNorm2d(channels_in, affine=True)
        self.conv_0 = conv3x3(channels_in, channels_out, stride)
        self.bn_1 = nn.InstanceNorm2d(channels_out, affine=True)
        self.conv_1 = conv3x3(channels_out, channels_out)
        self.proj_conv = nn.Conv2d(channels_in, channels_out, 1, stride, bias=False) if project else None
        self.stride = stride

    def forward(self, x: Tensor) -> Tensor:
        """Features of T frames, shape (T, C, h, w), to shape (T, C', h / stride, w / stride) [1]."""
        activated = F.relu(self.bn_0(x))
        shortcut = x if self.proj_conv is None else self.proj_conv(activated)
        # Padding "same" of a strided convolution lies right and below only.
        padded = F.pad(activated, (0, 2, 0, 2)) if self.stride == 2 else activated
        return cast(Tensor, shortcut + self.conv_1(F.relu(self.bn_1(self.conv_0(padded)))))


class ResidualGroup(nn.Module):
    """Two residual blocks; the first may reduce the resolution."""

    def __init__(self, channels_in: int, channels_out: int, stride: int) -> None:
        super().__init__()
        self.blocks = nn.Sequential(
            ResidualBlock(channels_in, channels_out, stride=stride, project=True),
            ResidualBlock(channels_out, channels_out, stride=1, project=False),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Features of T frames, shape (T, C, h, w), to shape (T, C', h / stride, w / stride) [1]."""
        return cast(Tensor, self.blocks(x))


class ResNet(nn.Module):
    """Residual network whose second and fourth group give the fine and the coarse features."""

    def __init__(self, config: TapirConfig) -> None:
        super().__init__()
        channels = (config.group_channels[0], *config.group_channels)
        self.initial_conv = nn.Conv2d(3, channels[0], 7, stride=2, bias=False)
        self.block_groups = nn.ModuleList(
            ResidualGroup(channels[i], channels[i + 1], stride) for i, stride in enumerate(STRIDES)
        )

    def forward(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Fine and coarse features of frames.

        Parameters
        ----------
        frames
            RGB in [-1, 1], shape (T, 3, H, W).

        Returns
        -------
        fine, coarse
            Shapes (T, C, H/4, W/4) and (T, C', H/8, W/8) [1].
        """
        x = self.initial_conv(F.pad(frames, (2, 4, 2, 4)))
        outputs = []
        for group in self.block_groups:
            x = group(x)
            outputs.append(x)
        return outputs[1], outputs[3]


class ExtraConvBlock(nn.Module):
    """Two 3x3 convolutions with a wide hidden layer; the skip carries the normalised input, not the input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layer_norm = nn.LayerNorm(channels)
        self.conv = nn.Conv2d(channels, 4 * channels, 3, padding=1)
        self.conv_1 = nn.Conv2d(4 * channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Features of T frames, shape (T, C, h, w), to the same shape [1]."""
        normalized = self.layer_norm(x.movedim(1, -1)).movedim(-1, 1)
        return cast(Tensor, normalized + self.conv_1(F.gelu(self.conv(normalized), approximate="tanh")))


class ExtraConvs(nn.Module):
    """The convolution blocks that BootsTAPIR adds behind the coarse features."""

    def __init__(self, config: TapirConfig) -> None:
        super().__init__()
        self.blocks = nn.Sequential(*(ExtraConvBlock(config.lowres_channels) for _ in range(config.extra_blocks)))

    def forward(self, x: Tensor) -> Tensor:
        """Features of T frames, shape (T, C, h, w), to the same shape [1]."""
        return cast(Tensor, self.blocks(x))


def normalize_channels(features: Tensor) -> Tensor:
    """Features with a Euclidean norm of one over the channels.

    Parameters
    ----------
    features
        Features of T frames, shape (T, C, h, w) [1].

    Examples
    --------
    >>> features = torch.tensor([3.0, 4.0], dtype=torch.float64).reshape(1, 2, 1, 1)
    >>> normalize_channels(features).flatten().tolist()
    [0.6, 0.8]
    """
    return features / torch.sqrt((features**2).sum(dim=1, keepdim=True).clamp_min(1e-12))
