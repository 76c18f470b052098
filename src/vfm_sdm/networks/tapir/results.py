"""What enters and leaves TAPIR: features of query points, tracks, and the memory of online use."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import torch
from torch import Tensor

from vfm_sdm.networks.tapir.config import Resolution
from vfm_sdm.networks.tapir.mixer import MixerState

__all__ = [
    "CausalState",
    "Estimate",
    "OnlineStep",
    "PointFeatures",
    "QueryFeatures",
    "TapirTracks",
    "report_tracks",
    "visible",
]


def visible(occlusion: Tensor, expected_dist: Tensor) -> Tensor:
    """Where a point is more likely seen and well placed than not.

    Parameters
    ----------
    occlusion, expected_dist
        Logits of the network for every point and frame, shape (...) [1].

    Returns
    -------
    visible
        Boolean, shape (...).

    Examples
    --------
    >>> visible(torch.tensor([-4.0, 4.0]), torch.tensor([-4.0, -4.0])).tolist()
    [True, False]
    """
    return torch.sigmoid(-occlusion) * torch.sigmoid(-expected_dist) > 0.5


@dataclass(frozen=True)
class Estimate:
    """One iterate inside the network.

    Parameters
    ----------
    position
        Column and row, shape (N, T, 2) [px of the initial resolution].
    occlusion, expected_dist
        Logits of the point being hidden and of its position being far off, shape (N, T) [1].
    """

    position: Tensor
    occlusion: Tensor
    expected_dist: Tensor

    def anchored(self, queries: Tensor, to_initial: Tensor) -> Self:
        """The estimate with the query points themselves as the positions in their own frames.

        Parameters
        ----------
        queries
            Frame index, row and column, shape (N, 3) [frames, px, px] of the video.
        to_initial
            Factors that scale x, y of the video to the initial resolution, shape (2,) [1].
        """
        frame = queries[:, 0].round().long()
        position = self.position.clone()
        position[torch.arange(len(queries), device=frame.device), frame] = queries[:, [2, 1]] * to_initial
        return replace(self, position=position)


@dataclass(frozen=True)
class TapirTracks:
    """Tracks of N points through T frames.

    Parameters
    ----------
    tracks
        Positions (N, T, 2) as x, y in pixels of the video; the centre of the top-left pixel is (0.5, 0.5).
    occlusion
        Logits (N, T) of the point being hidden.
    expected_dist
        Logits (N, T) of the position being far off (beyond the threshold of the training).
    iterates
        The initialisation and every refinement in turn, each without iterates of its own.
    """

    tracks: Tensor
    occlusion: Tensor
    expected_dist: Tensor
    iterates: tuple["TapirTracks", ...] = ()

    @property
    def visible(self) -> Tensor:
        """Boolean (N, T): neither hidden nor uncertain."""
        return visible(self.occlusion, self.expected_dist)


def report_tracks(chunks: Sequence[Sequence[Estimate]], iterations: int, to_video: Tensor) -> TapirTracks:
    """Tracks of all points: the mean over the resolutions of their last iterates, with every iterate.

    Parameters
    ----------
    chunks
        Estimates of every chunk of points: the initialisation and all refinements in turn, shape (N, T, ...) each.
    iterations
        Refinements per resolution.
    to_video
        Factors from x, y at the initial resolution to pixels of the video, shape (2,) [1].
    """
    iterates = tuple(
        TapirTracks(
            torch.cat([estimate.position for estimate in estimates]) * to_video,
            torch.cat([estimate.occlusion for estimate in estimates]),
            torch.cat([estimate.expected_dist for estimate in estimates]),
        )
        for estimates in zip(*chunks, strict=True)
    )
    last = iterates[iterations::iterations]
    return TapirTracks(
        torch.stack([iterate.tracks for iterate in last]).mean(dim=0),
        torch.stack([iterate.occlusion for iterate in last]).mean(dim=0),
        torch.stack([iterate.expected_dist for iterate in last]).mean(dim=0),
        iterates,
    )


@dataclass(frozen=True)
class PointFeatures:
    """Features of query points at one resolution: fine, shape (N, C), and coarse, shape (N, C') [1]."""

    hires: Tensor
    lowres: Tensor


@dataclass(frozen=True)
class QueryFeatures:
    """Query points as the online network needs them, taken once from the query frame.

    Parameters
    ----------
    points
        Features at the initial resolution, then at each refinement resolution.
    resolutions
        The refinement resolutions, height and width [px].
    image_size
        Height and width of the query frame [px]; later frames have the same.
    """

    points: tuple[PointFeatures, ...]
    resolutions: tuple[Resolution, ...]
    image_size: Resolution


@dataclass(frozen=True)
class CausalState:
    """Memory of online use: one mixer state per refinement, in the order in which they run."""

    refinements: tuple[MixerState, ...]


class OnlineStep(NamedTuple):
    """Result of one online step: tracks (N, 2) as in ``TapirTracks``, logits (N,), and the state for the next frame."""

    tracks: Tensor
    occlusion: Tensor
    expected_dist: Tensor
    state: CausalState

    @property
    def visible(self) -> Tensor:
        """Boolean (N,): neither hidden nor uncertain."""
        return visible(self.occlusion, self.expected_dist)
