"""Sizes of the network."""

from dataclasses import dataclass

__all__ = ["PoseDiffusionConfig"]


@dataclass(frozen=True)
class PoseDiffusionConfig:
    """Sizes of the network; the defaults are those of the published one.

    Parameters
    ----------
    patch_size, width, encoder_depth, encoder_heads
        Side of a patch [px], channels of a token, blocks, and heads of their attention, of the image encoder.
    channels, depth, heads, hidden
        Channels of a frame, blocks, heads of their attention, and hidden units, of the denoiser.
    head_hidden
        Hidden units of the layer that yields the noise.
    steps
        Steps of the diffusion.
    """

    patch_size: int = 16
    width: int = 384
    encoder_depth: int = 12
    encoder_heads: int = 6
    channels: int = 512
    depth: int = 8
    heads: int = 4
    hidden: int = 1024
    head_hidden: int = 128
    steps: int = 100
