"""Refinement: local correlations along the tracks, and the mixer's updates of position, logits and features."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vfm_sdm.networks.tapir.config import TapirConfig
from vfm_sdm.networks.tapir.features import FeatureGrids, frame_chunks, scale_between
from vfm_sdm.networks.tapir.mixer import MixerState, TemporalMixer
from vfm_sdm.networks.tapir.results import Estimate, PointFeatures
from vfm_sdm.networks.tapir.sampling import correlate_windows

__all__ = ["Refiner", "gather_evidence"]


@dataclass(frozen=True, eq=False)
class Refiner:
    """The refinement of tracks at one resolution.

    Parameters
    ----------
    mixer
        Network that gives the updates.
    config
        Iterations, windows and the initial resolution, in whose pixels positions are.
    """

    mixer: TemporalMixer
    config: TapirConfig

    def refine(
        self,
        grids: FeatureGrids,
        points: PointFeatures,
        start: Estimate,
        *,
        past: Sequence[MixerState] = (),
        frame_chunk: int = 1,
    ) -> tuple[list[Estimate], list[MixerState]]:
        """Estimates after each iteration at one resolution, and the mixer's state after each.

        Parameters
        ----------
        grids
            Features of T frames at this resolution, shape (T, C, h, w) each.
        points
            Features of the N query points at this resolution. Each frame's own copy of them is refined along with the
            position, from these values on.
        start
            Estimate at which the iterations begin: positions, shape (N, T, 2) [px of the initial resolution].
        past
            State of each iteration before these frames; none at the start of a video.
        frame_chunk
            Frames that are correlated at a time.

        Notes
        -----
        Section 3.2 of TAPIR [1]_. The mixer's shifts are in pixels of the resized video.

        References
        ----------
        .. [1] Doersch, C., Yang, Y., Vecerik, M., Gokay, D., Gupta, A., Aytar, Y., Carreira, J., Zisserman, A. (2023).
           TAPIR: tracking any point with per-frame initialization and temporal refinement. IEEE/CVF International
           Conference on Computer Vision.
        """
        to_initial = scale_between(grids.resolution, self.config.initial_resolution, points.lowres)
        estimate = start
        feature = torch.cat([points.hires, points.lowres], dim=-1)[:, None].expand(-1, len(grids.lowres), -1)
        estimates, states = [], []
        for iteration in range(self.config.iterations):
            evidence = gather_evidence(grids, estimate, feature, config=self.config, frame_chunk=frame_chunk)
            update, state = self.mixer(evidence, past[iteration] if past else None)
            shift, occlusion, expected_dist, change = torch.split(update, [2, 1, 1, feature.shape[-1]], dim=-1)
            estimate = Estimate(
                estimate.position + shift * to_initial,
                estimate.occlusion + occlusion[..., 0],
                estimate.expected_dist + expected_dist[..., 0],
            )
            feature = feature + change
            estimates.append(estimate)
            states.append(state)
        return estimates, states


def gather_evidence(
    grids: FeatureGrids, estimate: Estimate, feature: Tensor, *, config: TapirConfig, frame_chunk: int
) -> Tensor:
    """What the mixer sees of every point in every frame.

    Parameters
    ----------
    grids
        Feature grids of T frames, shape (T, C, h, w) each [1].
    estimate
        Positions, shape (N, T, 2) [px of the initial resolution], and logits, shape (N, T) [1].
    feature
        Features of the points in every frame, the fine part first, shape (N, T, C) [1].
    config
        Windows and the initial resolution.
    frame_chunk
        Frames that are correlated at a time.

    Returns
    -------
    evidence
        Two zeros, the two logits, the features and the correlations, shape (N, T, inputs) [1].

    Notes
    -----
    The fine grid is correlated with the fine part of the features, the other grids with the rest.
    """
    fine, coarse = torch.split(feature, [config.hires_channels, config.lowres_channels], dim=-1)
    correlations = []
    for grid, wanted in zip(grids.pyramid, (fine, *[coarse] * (1 + config.pyramid_level)), strict=True):
        size = (grid.shape[2], grid.shape[3])
        cells = estimate.position * scale_between(config.initial_resolution, size, estimate.position)
        windows = [
            correlate_windows(
                grid[frames],
                cells[:, frames],
                wanted[:, frames],
                radius=config.window_radius,
                square_sampling=config.square_sampling,
            )
            for frames in frame_chunks(len(grid), frame_chunk)
        ]
        correlations.append(torch.cat(windows, dim=1))
    logits = torch.stack([estimate.occlusion, estimate.expected_dist], dim=-1)
    return torch.cat([torch.zeros_like(logits), logits, feature, *correlations], dim=-1)
