"""The denoiser: from noisy pose vectors of frames and what they show to the noise in the vectors."""

import math

import torch
from torch import Tensor, nn

from vfm_sdm.networks.posediffusion.config import PoseDiffusionConfig
from vfm_sdm.networks.posediffusion.pose import POSE_SIZE

__all__ = ["Denoiser", "embed_poses", "embed_times"]

_FREQUENCIES = 10
_TIMES = 256
_TIME_CHANNELS = 128
_LONGEST = 10_000.0
_POSE_CHANNELS = POSE_SIZE * (2 * _FREQUENCIES + 1)


class Denoiser(nn.Module):
    """A transformer over the frames of a scene; a flag tells the first frame, nothing else their order."""

    def __init__(self, config: PoseDiffusionConfig) -> None:
        super().__init__()
        self.time_embed = _TimeEmbedding()
        self._first = nn.Linear(_POSE_CHANNELS + _TIME_CHANNELS + config.width + 1, config.channels)
        layer = nn.TransformerEncoderLayer(
            config.channels, config.heads, config.hidden, dropout=0.0, batch_first=True, norm_first=True
        )
        self._trunk = nn.TransformerEncoder(layer, config.depth, enable_nested_tensor=False)
        self._last = nn.Sequential(
            nn.Linear(config.channels, config.head_hidden),
            nn.LayerNorm(config.head_hidden),
            nn.ReLU(),
            nn.Linear(config.head_hidden, POSE_SIZE),
        )

    def forward(self, poses: Tensor, features: Tensor, times: Tensor) -> Tensor:
        """The noise in pose vectors, shape (B, N, 9).

        Parameters
        ----------
        poses
            Noisy pose vectors of N frames in B scenes, shape (B, N, 9).
        features
            Image features of the frames, shape (B, N, width) [1].
        times
            Step of each scene, shape (B,), 0 for the last one.
        """
        frames = poses.shape[1]
        time = self.time_embed(times.to(poses.dtype))[:, None].expand(-1, frames, -1)
        first = torch.zeros_like(poses[..., :1])
        first[:, 0] = 1
        joined = torch.cat([embed_poses(poses), time, features, first], dim=-1)
        y: Tensor = self._last(self._trunk(self._first(joined)))
        return y


class _TimeEmbedding(nn.Module):
    """Steps, shape (B,), to (B, 128)."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Sequential(
            nn.Linear(_TIMES, _TIME_CHANNELS), nn.SiLU(), nn.Linear(_TIME_CHANNELS, _TIME_CHANNELS)
        )

    def forward(self, times: Tensor) -> Tensor:
        """Embedding of steps, the same for all frames of a scene, shape (B, 128)."""
        y: Tensor = self.linear(embed_times(times))
        return y


def embed_times(times: Tensor) -> Tensor:
    """Cosines, then sines, of steps at 128 frequencies, shape (B, 256).

    Parameters
    ----------
    times
        Steps, shape (B,).

    Examples
    --------
    >>> embed_times(torch.zeros(1))[0, [0, 127, 128, 255]].tolist()
    [1.0, 1.0, 0.0, 0.0]
    """
    half = _TIMES // 2
    frequencies = torch.exp(-math.log(_LONGEST) * torch.arange(half).to(times) / half)
    angles = times[:, None] * frequencies
    return torch.cat([angles.cos(), angles.sin()], dim=-1)


def embed_poses(poses: Tensor) -> Tensor:
    """Sines and cosines of pose vectors at ten frequencies, then the vectors, shape (..., 189).

    Parameters
    ----------
    poses
        Pose vectors of N frames, shape (..., N, 9).

    Examples
    --------
    >>> tuple(embed_poses(torch.zeros(2, 9)).shape)
    (2, 189)
    """
    frequencies = 2.0 ** torch.arange(_FREQUENCIES).to(poses)
    angles = (poses[..., None] * frequencies).flatten(-2)
    return torch.cat([angles.sin(), angles.cos(), poses], dim=-1)
