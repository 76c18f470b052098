"""Guided sampling: pose vectors are moved until points that match lie on each other's epipolar lines."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vfm_sdm.networks.posediffusion.pose import FOCAL, POSE_SIZE, QUATERNION, TRANSLATION, decode_pose

__all__ = ["GUIDED_STEPS", "ITERATIONS", "LIMIT_PX2", "PASSES", "Guide", "ImageMatches"]

GUIDED_STEPS = 10
"""So many of the last steps are guided."""
ITERATIONS = 100
LIMIT_PX2 = 10.0
"""Larger errors do not take part [px^2]."""
_MATCHES_PER_FRAME = 10
_RATE, _MOMENTUM = 0.01, 0.9
_LONGEST_STEP = 1e-4
"""Longest step of an iteration, over the length of what is moved."""
_TINY = 1e-6

_ALL = slice(0, POSE_SIZE)
PASSES = ((_ALL, 2), (FOCAL, 1), (QUATERNION, 1), (TRANSLATION, 1), (_ALL, 2))
"""Entries that each pass moves, and its iterations over `ITERATIONS`."""


@dataclass(frozen=True)
class ImageMatches:
    """Points that match, in the network's pictures.

    Parameters
    ----------
    first, second
        Column and row in the one and the other picture, shape (M, 2) [px], from the outer corner of the top-left pixel.
    frames
        Indices of the two frames, shape (M, 2).
    """

    first: Tensor
    second: Tensor
    frames: Tensor


@dataclass(frozen=True)
class Guide:
    """Matches that guide the sampling.

    Parameters
    ----------
    matches
        Points that match.
    size
        Side of the network's pictures [px].
    iterations
        Iterations of a pass; passes over all entries have twice as many.

    Notes
    -----
    The gradient is nearly always longer than the limit, so that every step has one length and the search never comes to
    rest: after hundreds of iterations, rounding decides digits that matter little, and the mean error is what to look
    at.
    """

    matches: ImageMatches
    size: int = 224
    iterations: int = ITERATIONS

    def refine(self, poses: Tensor) -> Tensor:
        """Pose vectors with smaller epipolar errors, shape (N, 9); unchanged where too few matches are near.

        Parameters
        ----------
        poses
            Pose vectors of N frames, shape (N, 9).
        """
        for moved, times in PASSES:
            poses = self.descend(poses, moved, times * self.iterations)
        return poses

    def descend(self, poses: Tensor, moved: slice, iterations: int) -> Tensor:
        """Pose vectors after a descent with momentum, shape (N, 9).

        Parameters
        ----------
        poses
            Pose vectors of N frames, shape (N, 9).
        moved
            Entries that are moved.
        iterations
            How many steps; it ends before where fewer than ten matches a frame are near.
        """
        # Outside of inference mode, in which nothing has a gradient.
        with torch.inference_mode(False):
            poses, matches = poses.clone(), self._own_matches()
            velocity = torch.zeros_like(poses)
            for _ in range(iterations):
                gradient = self._gradient(poses, moved, matches)
                if gradient is None:
                    break
                limit = _LONGEST_STEP / _RATE * poses[gradient != 0].norm()
                gradient = gradient * (limit / (gradient.norm() + _TINY)).clamp(max=1.0)
                velocity = _MOMENTUM * velocity + gradient
                poses = poses - _RATE * velocity
        return poses

    def gradient(self, poses: Tensor, moved: slice = _ALL) -> Tensor | None:
        """Derivative of the mean error of near matches, shape (N, 9) [px^2]; ``None`` where too few are near.

        Parameters
        ----------
        poses
            Pose vectors of N frames, shape (N, 9).
        moved
            Entries that are moved; the others have no derivative.
        """
        with torch.inference_mode(False):
            return self._gradient(poses.clone(), moved, self._own_matches())

    def errors(self, poses: Tensor) -> Tensor:
        """Squared Sampson error of every match, shape (M,) [px^2], for the pose vectors of N frames, shape (N, 9)."""
        return _sampson_errors(fundamental_matrices(poses, self.size), self.matches)

    def enough(self, near: Tensor, frames: int) -> bool:
        """Whether enough matches are near for a descent.

        Parameters
        ----------
        near
            Whether each match is, shape (M,).
        frames
            Number of frames.
        """
        return int(near.sum()) >= _MATCHES_PER_FRAME * frames

    def _own_matches(self) -> ImageMatches:
        found = self.matches
        return ImageMatches(found.first.clone(), found.second.clone(), found.frames.clone())

    def _gradient(self, poses: Tensor, moved: slice, matches: ImageMatches) -> Tensor | None:
        with torch.enable_grad():
            leaf = poses.detach().requires_grad_()
            errors = _sampson_errors(fundamental_matrices(leaf, self.size), matches)
            near = errors < LIMIT_PX2
            if not self.enough(near, len(poses)):
                return None
            (slope,) = torch.autograd.grad(errors[near].mean(), leaf)
        gradient = torch.zeros_like(slope)
        gradient[:, moved] = slope[:, moved]
        return gradient


def fundamental_matrices(poses: Tensor, size: int) -> Tensor:
    """Matrices F with p_j' F[i, j] p_i = 0 for pixels of one point, shape (N, N, 3, 3).

    Parameters
    ----------
    poses
        Pose vectors of N frames, shape (N, 9).
    size
        Side of the network's pictures [px].

    Notes
    -----
    All frames have the mean of their focal lengths here, along x and along y.
    """
    rotation, translation, focal = decode_pose(poses)
    inverse = _inverse_intrinsics(focal.mean(dim=0) * (size / 2), size / 2)
    turn = rotation[None] @ rotation.mT[:, None]
    shift = translation[None] - (turn @ translation[:, None, :, None]).squeeze(-1)
    return inverse.mT @ _cross(shift) @ turn @ inverse


def _inverse_intrinsics(focal: Tensor, center: float) -> Tensor:
    zero, one = torch.zeros_like(focal[0]), torch.ones_like(focal[0])
    rows: Sequence[Sequence[Tensor]] = (
        (1 / focal[0], zero, -center / focal[0]),
        (zero, 1 / focal[1], -center / focal[1]),
        (zero, zero, one),
    )
    return torch.stack([torch.stack(tuple(row)) for row in rows])


def _cross(vectors: Tensor) -> Tensor:
    """Matrices that multiply as the cross product does."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def _sampson_errors(fundamental: Tensor, matches: ImageMatches) -> Tensor:
    """Squared first-order distance from the epipolar constraint, shape (M,) [px^2]."""
    F = fundamental[matches.frames[:, 0], matches.frames[:, 1]]
    one = torch.ones_like(matches.first[:, :1])
    first, second = (torch.cat([points, one], dim=-1)[..., None] for points in (matches.first, matches.second))
    line, line_back = (F @ first).squeeze(-1), (F.mT @ second).squeeze(-1)
    constraint = (second.squeeze(-1) * line).sum(dim=-1)
    return constraint**2 / (line[:, :2].square().sum(dim=-1) + line_back[:, :2].square().sum(dim=-1))
