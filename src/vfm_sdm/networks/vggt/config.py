"""Sizes of the network."""

from dataclasses import dataclass

__all__ = ["VggtConfig"]


@dataclass(frozen=True)
class VggtConfig:
    """Sizes of the network; the defaults are those of the published VGGT-1B.

    Parameters
    ----------
    image_size, patch_size
        Side of the images that the position table was learned for, and of a patch [px].
    width
        Channels of a token.
    registers
        Register tokens, of the encoder and of every frame in the aggregator.
    encoder_depth, encoder_heads
        Blocks of the image encoder, and heads of its attention.
    depth, heads
        Pairs of frame and global blocks in the aggregator, and heads of their attention.
    camera_depth, camera_heads, camera_iterations
        Blocks and heads of the camera head, and how often it corrects the pose.
    feature_layers, feature_channels
        Aggregator layers that the feature head reads, and channels that it makes of each.
    features
        Channels of the feature map, and of a track's feature.
    hidden, track_heads, track_depth
        Channels, heads and rounds of the update transformer.
    virtual_tracks
        Learned tracks through which points of one call see each other.
    levels, radius
        Correlation pyramid, and half the side of its windows [cells].
    track_iterations
        How often a track is corrected.
    """

    image_size: int = 518
    patch_size: int = 14
    width: int = 1024
    registers: int = 4
    encoder_depth: int = 24
    encoder_heads: int = 16
    depth: int = 24
    heads: int = 16
    camera_depth: int = 4
    camera_heads: int = 16
    camera_iterations: int = 4
    feature_layers: tuple[int, ...] = (4, 11, 17, 23)
    feature_channels: tuple[int, ...] = (256, 512, 1024, 1024)
    features: int = 128
    hidden: int = 384
    track_heads: int = 8
    track_depth: int = 6
    virtual_tracks: int = 64
    levels: int = 7
    radius: int = 4
    track_iterations: int = 4

    @property
    def special_tokens(self) -> int:
        """Tokens of a frame that belong to no patch: the camera token and the registers."""
        return 1 + self.registers

    @property
    def smallest_side(self) -> int:
        """Shortest image side for which every level of the correlation pyramid has a cell [px]."""
        return 1 << self.levels
