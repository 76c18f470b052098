"""Temporal mixer: depthwise convolutions along time alternate with a perceptron over the channels."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from vfm_sdm.networks.tapir.config import TapirConfig

__all__ = ["MixerState", "TemporalMixer"]

EXPANSION = 4
"""Hidden channels per channel, in time as well as over channels."""
TAPS = 3
"""Frames that a temporal convolution sees."""
PAST_FRAMES = TAPS - 1
"""Frames that a causal convolution sees before the present one."""


@dataclass(frozen=True)
class MixerState:
    """What a causal mixer remembers of the last two frames; zero before the first.

    Parameters
    ----------
    normalized
        Inputs of every block's first temporal convolution, (..., blocks, N, 2, C), oldest frame first.
    activated
        Inputs of its second one, (..., blocks, N, 2, 4 C).
    """

    normalized: Tensor
    activated: Tensor


class TemporalConvolution(nn.Module):
    """Depthwise convolution along time without padding; every channel gives the same number of outputs.

    It is computed as a sum over the taps of shifted copies: for the few frames of online use, torch's grouped
    convolutions were measured 10 to 100 times slower on a CPU.
    """

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(channels_out, 1, TAPS).uniform_(-(TAPS**-0.5), TAPS**-0.5))
        self.bias = nn.Parameter(torch.zeros(channels_out))
        self.outputs = (channels_in, channels_out // channels_in)

    def forward(self, x: Tensor) -> Tensor:
        """Features of T frames, shape (N, T, C'), from those of T + 2, shape (N, T + 2, C).

        The C' / C outputs of a channel lie beside each other.
        """
        frames = x.shape[1] - PAST_FRAMES
        weight = self.weight.view(*self.outputs, TAPS)
        result: Tensor = self.bias.view(self.outputs)
        for tap in range(TAPS):
            result = torch.addcmul(result, x[:, tap : tap + frames, :, None], weight[..., tap])
        return result.flatten(-2)


class ChannelMixer(nn.Module):
    """Perceptron over the channels of each frame."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mlp2_up = nn.Linear(channels, EXPANSION * channels)
        self.mlp2_down = nn.Linear(EXPANSION * channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """Features of points in frames, shape (..., C), to the same shape [1]."""
        result: Tensor = self.mlp2_down(F.gelu(self.mlp2_up(x), approximate="tanh"))
        return result


class MixerBlock(nn.Module):
    """One temporal and one channel step, each behind a norm and beside a skip connection."""

    def __init__(self, channels: int, *, causal: bool) -> None:
        super().__init__()
        self.causal = causal
        self.layer_norm = nn.LayerNorm(channels, bias=False)
        self.mlp1_up = TemporalConvolution(channels, EXPANSION * channels)
        self.mlp1_up_1 = TemporalConvolution(EXPANSION * channels, EXPANSION * channels)
        self.layer_norm_1 = nn.LayerNorm(channels, bias=False)
        self.conv_channels_mixer = ChannelMixer(channels)

    def forward(self, x: Tensor, past: tuple[Tensor, Tensor] | None) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Features after the block, and the inputs that the next frame needs.

        Parameters
        ----------
        x
            Features of T frames, shape (N, T, C) [1].
        past
            Inputs of the two frames before, shapes (N, 2, C) and (N, 2, 4 C); zero where ``None``.

        Returns
        -------
        features, inputs
            Features, shape (N, T, C), and the inputs of the last two frames, shapes (N, 2, C) and (N, 2, 4 C).
        """
        normalized = self._padded(self.layer_norm(x), past[0] if past else None)
        activated = F.gelu(self.mlp1_up(normalized), approximate="tanh")
        activated = self._padded(activated, past[1] if past else None)
        x = x + self.mlp1_up_1(activated).unflatten(-1, (-1, EXPANSION)).sum(dim=-1)
        x = x + self.conv_channels_mixer(self.layer_norm_1(x))
        return x, (normalized[:, -PAST_FRAMES:], activated[:, -PAST_FRAMES:])

    def _padded(self, x: Tensor, past: Tensor | None) -> Tensor:
        """Features (N, T + 2, C): with the past in front if causal, else with a zero frame at either end."""
        if not self.causal:
            return F.pad(x, (0, 0, 1, 1))
        return F.pad(x, (0, 0, PAST_FRAMES, 0)) if past is None else torch.cat([past, x], dim=1)


class TemporalMixer(nn.Module):
    """The network that turns local evidence along a track into an update of it (section 3.2 of TAPIR [1]_).

    References
    ----------
    .. [1] Doersch, C., Yang, Y., Vecerik, M., Gokay, D., Gupta, A., Aytar, Y., Carreira, J., Zisserman, A. (2023).
       TAPIR: tracking any point with per-frame initialization and temporal refinement. IEEE/CVF International
       Conference on Computer Vision.
    """

    def __init__(self, config: TapirConfig) -> None:
        super().__init__()
        features = config.hires_channels + config.lowres_channels
        correlations = config.window_size * (2 + config.pyramid_level)
        channels = config.mixer_channels
        self.linear = nn.Linear(4 + features + correlations, channels)
        self.blocks = nn.ModuleList(MixerBlock(channels, causal=config.causal) for _ in range(config.mixer_blocks))
        self.layer_norm = nn.LayerNorm(channels, bias=False)
        self.linear_1 = nn.Linear(channels, 4 + features)

    def forward(self, evidence: Tensor, state: MixerState | None = None) -> tuple[Tensor, MixerState]:
        """Update of every track, and the state after the last frame.

        Parameters
        ----------
        evidence
            Evidence of T frames, shape (N, T, inputs) [1].
        state
            State after the frame before; the past is zero without one.

        Returns
        -------
        update, state
            Update, shape (N, T, 4 + features) [px of the resized video, 1], and the state, which means something for a
            causal mixer only.
        """
        x = self.linear(evidence)
        pasts = []
        for index, block in enumerate(self.blocks):
            x, past = block(x, (state.normalized[index], state.activated[index]) if state else None)
            pasts.append(past)
        normalized, activated = zip(*pasts, strict=True)
        return self.linear_1(self.layer_norm(x)), MixerState(torch.stack(normalized), torch.stack(activated))
