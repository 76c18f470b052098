"""Cameras from the frames' camera tokens, corrected step by step (VGGT, section 3.3)."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.layers import Block, Mlp
from vfm_sdm.networks.vggt.pose import FOV, POSE_SIZE

__all__ = ["CameraHead"]


class CameraHead(nn.Module):
    """Pose vectors of frames (`vfm_sdm.networks.vggt.pose`) from their camera tokens."""

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        width = 2 * config.width
        self.iterations = config.camera_iterations
        self.trunk = nn.Sequential(*(Block(width, config.camera_heads) for _ in range(config.camera_depth)))
        self.token_norm = nn.LayerNorm(width)
        self.trunk_norm = nn.LayerNorm(width)
        self.empty_pose_tokens = nn.Parameter(torch.zeros(1, 1, POSE_SIZE))
        self.embed_pose = nn.Linear(POSE_SIZE, width)
        self.poseLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(width, 3 * width))
        self.pose_branch = Mlp(width, width // 2, POSE_SIZE)

    def forward(self, camera_tokens: Tensor) -> Tensor:
        """Pose vectors after every iteration.

        Parameters
        ----------
        camera_tokens
            Camera tokens of S frames after the aggregator's last layer, shape (S, 2 C) [1].

        Returns
        -------
        poses
            Shape (iterations, S, 9): translation [1], quaternion [1] and fields of view [rad], the latter cut at zero.
        """
        tokens = self.token_norm(camera_tokens.to(self.empty_pose_tokens.dtype)).unsqueeze(0)
        pose = self.empty_pose_tokens.expand(-1, tokens.shape[1], -1)
        raw: Tensor | None = None
        poses = []
        for _ in range(self.iterations):
            increment = self.increment(tokens, pose)
            raw = increment if raw is None else raw + increment
            # What is fed back is not what is reported: the field of view may be negative in between.
            pose = raw
            poses.append(torch.cat([raw[..., : FOV.start], F.relu(raw[..., FOV])], dim=-1)[0])
        return torch.stack(poses)

    def increment(self, tokens: Tensor, pose: Tensor) -> Tensor:
        """Correction of the poses of S frames, shape (1, S, 9).

        Parameters
        ----------
        tokens
            Normalised camera tokens, shape (1, S, 2 C) [1].
        pose
            Poses so far, shape (1, S, 9).
        """
        y: Tensor = self.pose_branch(self.trunk_norm(self.trunk(self.modulated(tokens, pose))))
        return y

    def modulated(self, tokens: Tensor, pose: Tensor) -> Tensor:
        """Camera tokens of S frames shifted, scaled and gated by the poses so far, shape (1, S, 2 C).

        Parameters
        ----------
        tokens
            Normalised camera tokens, shape (1, S, 2 C) [1].
        pose
            Poses so far, shape (1, S, 9).
        """
        shift, scale, gate = self.poseLN_modulation(self.embed_pose(pose)).chunk(3, dim=-1)
        y: Tensor = tokens + gate * (F.layer_norm(tokens, tokens.shape[-1:], eps=1e-6) * (1 + scale) + shift)
        return y
