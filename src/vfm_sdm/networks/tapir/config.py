"""What a TAPIR checkpoint was built with; nothing of it except the sizes can be read from the file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from vfm_sdm.errors import SessionError

__all__ = ["LOWRES_STRIDE", "Resolution", "TapirConfig", "check_resolution", "refinement_resolutions"]

Resolution = tuple[int, int]
"""Height and width in pixels that a video is resized to."""

LOWRES_STRIDE = 8
"""Pixels of the resized video per cell of the coarse feature grid."""


@dataclass(frozen=True, kw_only=True)
class TapirConfig:
    """Architecture and run-time constants of one TAPIR checkpoint.

    Parameters
    ----------
    pyramid_level
        How many times the coarse feature grid is halved for the correlations of the refinement.
    extra_convs
        Whether convolution blocks with a wide hidden layer follow the backbone (BootsTAPIR).
    causal
        Whether the temporal convolutions look at the past only, as online use needs. Offline and causal checkpoints
        have the same keys and shapes, so the file cannot tell: it is for the user to say.
    softmax_temperature
        Factor on the position heat map before its softmax; touches the initial positions only. The published PyTorch
        network uses 20 (the default, as the PyTorch checkpoints are run with it), the recipe BootsTAPIR was trained
        with in JAX says 10.
    square_sampling
        Whether both coordinates of a correlation window are divided by the grid's *height* when it is sampled, as the
        published network does. For a grid that is not square, x is then looked up wrongly by the ratio of width to
        height; square grids (every video up to 256 x 256 by default) don't notice. The default reproduces published
        results; False divides x by the width, which is what was meant.
    iterations
        Refinements per resolution.
    initial_resolution
        Height and width [px] of the resized video in which positions are initialised and kept.
    window_radius
        A correlation window has ``2 * window_radius + 1`` cells a side.
    group_channels
        Channels of the four residual groups; the second is the fine feature grid, the fourth the coarse one.
    extra_blocks
        Number of extra convolution blocks, if there are any.
    heatmap_channels, occlusion_channels
        Hidden channels of the two heads on the cost volume.
    mixer_channels, mixer_blocks
        Width and depth of the temporal mixer.

    Raises
    ------
    SessionError
        A number is out of its range.
    """

    pyramid_level: int = 1
    extra_convs: bool = True
    causal: bool = False
    softmax_temperature: float = 20.0
    square_sampling: bool = True
    iterations: int = 4
    initial_resolution: Resolution = (256, 256)
    window_radius: int = 3
    group_channels: tuple[int, int, int, int] = (64, 128, 256, 256)
    extra_blocks: int = 5
    heatmap_channels: int = 16
    occlusion_channels: int = 32
    mixer_channels: int = 512
    mixer_blocks: int = 12

    def __post_init__(self) -> None:
        counts = (
            self.iterations,
            self.extra_blocks,
            self.heatmap_channels,
            self.occlusion_channels,
            self.mixer_channels,
            self.mixer_blocks,
            *self.group_channels,
        )
        if min(counts) < 1 or len(self.group_channels) != 4:
            raise SessionError(
                f"TapirConfig: expected four group_channels and every count at least 1, got {self}; correct it"
            )
        if min(self.pyramid_level, self.window_radius) < 0:
            raise SessionError(
                f"TapirConfig: expected pyramid_level and window_radius of at least 0, got {self.pyramid_level} and "
                f"{self.window_radius}; correct them"
            )
        if not (math.isfinite(self.softmax_temperature) and self.softmax_temperature > 0):
            raise SessionError(
                f"softmax_temperature: expected a positive number, got {self.softmax_temperature}; use 20 or 10"
            )
        check_resolution(self.initial_resolution, self.pyramid_level)

    @property
    def hires_channels(self) -> int:
        """Channels of the fine feature grid."""
        return self.group_channels[1]

    @property
    def lowres_channels(self) -> int:
        """Channels of the coarse feature grid."""
        return self.group_channels[3]

    @property
    def window_size(self) -> int:
        """Correlations per pyramid entry."""
        return (2 * self.window_radius + 1) ** 2

    @classmethod
    def bootstapir(cls, *, softmax_temperature: float = 20.0, square_sampling: bool = True) -> Self:
        """BootsTAPIR that sees the whole video (``bootstapir_checkpoint_v2.pt``).

        Parameters
        ----------
        softmax_temperature, square_sampling
            As in `TapirConfig`.

        Examples
        --------
        >>> config = TapirConfig.bootstapir()
        >>> config.pyramid_level, config.extra_convs, config.causal
        (1, True, False)
        """
        return cls(softmax_temperature=softmax_temperature, square_sampling=square_sampling)

    @classmethod
    def bootstapir_causal(cls, *, softmax_temperature: float = 20.0, square_sampling: bool = True) -> Self:
        """BootsTAPIR that sees the past only (``causal_bootstapir_checkpoint.pt``).

        Parameters
        ----------
        softmax_temperature, square_sampling
            As in `TapirConfig`.

        Examples
        --------
        >>> TapirConfig.bootstapir_causal().causal
        True
        """
        return cls(causal=True, softmax_temperature=softmax_temperature, square_sampling=square_sampling)

    @classmethod
    def tapir_panning(cls, *, softmax_temperature: float = 20.0, square_sampling: bool = True) -> Self:
        """Plain TAPIR, trained on panning cameras (``tapir_checkpoint_panning.pt``).

        Parameters
        ----------
        softmax_temperature, square_sampling
            As in `TapirConfig`.

        Examples
        --------
        >>> TapirConfig.tapir_panning().pyramid_level
        0
        """
        return cls(
            pyramid_level=0, extra_convs=False, softmax_temperature=softmax_temperature, square_sampling=square_sampling
        )


def refinement_resolutions(image_size: Resolution, initial: Resolution) -> tuple[Resolution, ...]:
    """Resolutions at which a video is refined by default.

    Parameters
    ----------
    image_size
        Height and width of the video [px].
    initial
        Resolution of the initialisation [px].

    Returns
    -------
    resolutions
        Height and width [px], shape (height, width) each, in the order of refinement.

    Notes
    -----
    Only the initial one where the video is no larger; else from there to the full size in the fewest geometric steps
    of at most a factor 2, each side rounded down to a multiple of 8.

    Examples
    --------
    >>> refinement_resolutions((480, 640), (256, 256))
    ((256, 256), (344, 400), (480, 640))
    """
    enlargement = [full / first for full, first in zip(image_size, initial, strict=True)]
    if max(enlargement) <= 1:
        return (initial,)
    steps = math.ceil(math.log2(max(enlargement)))

    def side(axis: int, step: int) -> int:
        length = initial[axis] * math.pow(enlargement[axis], step / steps)
        # a power that should be whole may come out a rounding error below it
        return LOWRES_STRIDE * math.floor(length / LOWRES_STRIDE + 1e-9)

    return tuple((side(0, step), side(1, step)) for step in range(steps + 1))


def check_resolution(resolution: Sequence[int], pyramid_level: int) -> Resolution:
    """The resolution as (height, width), if the network can run at it.

    Parameters
    ----------
    resolution
        Height and width [px].
    pyramid_level
        How many times the coarse feature grid is halved.

    Raises
    ------
    SessionError
        A side is not a multiple of 8, or so small that the pyramid has an empty grid or the backbone a single cell.

    Examples
    --------
    >>> check_resolution([256, 320], 1)
    (256, 320)
    """
    smallest = LOWRES_STRIDE * 2 ** max(pyramid_level, 1)
    if len(resolution) != 2 or any(side % LOWRES_STRIDE or side < smallest for side in resolution):
        raise SessionError(
            f"resolution: expected height and width in multiples of {LOWRES_STRIDE} px from {smallest} px on, "
            f"got {tuple(resolution)}; round the sides"
        )
    return int(resolution[0]), int(resolution[1])
