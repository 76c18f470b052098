"""TAPIR put together: offline tracking of a whole video, and online tracking frame by frame."""

from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.networks.tapir.backbone import ExtraConvs, ResNet, normalize_channels
from vfm_sdm.networks.tapir.checks import check_chunks, check_queries, check_resolutions, check_state, check_video
from vfm_sdm.networks.tapir.config import Resolution, TapirConfig
from vfm_sdm.networks.tapir.features import FeatureGrids, frame_chunks, scale_between
from vfm_sdm.networks.tapir.initialization import CostVolumeHeads, initialize
from vfm_sdm.networks.tapir.mixer import EXPANSION, PAST_FRAMES, MixerState, TemporalMixer
from vfm_sdm.networks.tapir.refinement import Refiner
from vfm_sdm.networks.tapir.results import (
    CausalState,
    Estimate,
    OnlineStep,
    PointFeatures,
    QueryFeatures,
    TapirTracks,
    report_tracks,
)

__all__ = ["Tapir"]


class Tapir(nn.Module):
    """Tracker of any point, with the parameter names of the official PyTorch checkpoints.

    Parameters
    ----------
    config
        Architecture and run-time constants; a preset of ``TapirConfig`` for each checkpoint.

    Notes
    -----
    Section 3 of TAPIR [1]_; BootsTAP [2]_ for the extra convolutions. Calculations run in the floating-point type and
    on the device of the parameters. Points do not see one another. Run it under ``torch.inference_mode``, or all
    intermediate values are kept for a backward pass.

    Pixels: the centre of the top-left one is (0.5, 0.5), so that positions in a resized image are in proportion.

    References
    ----------
    .. [1] Doersch, C., Yang, Y., Vecerik, M., Gokay, D., Gupta, A., Aytar, Y., Carreira, J., Zisserman, A. (2023).
       TAPIR: tracking any point with per-frame initialization and temporal refinement. IEEE/CVF International
       Conference on Computer Vision.
    .. [2] Doersch, C., Luc, P., Yang, Y., Gokay, D., Koppula, S., Gupta, A., Heyward, J., Rocco, I., Goroshin, R.,
       Carreira, J., Zisserman, A. (2024). BootsTAP: bootstrapped training for tracking-any-point. Asian Conference on
       Computer Vision.
    """

    def __init__(self, config: TapirConfig) -> None:
        super().__init__()
        self.config = config
        self.resnet_torch = ResNet(config)
        self.extra_convs = ExtraConvs(config) if config.extra_convs else None
        self.torch_cost_volume_track_mods = CostVolumeHeads(config)
        self.torch_pips_mixer = TemporalMixer(config)

    def track(
        self,
        video: Tensor,
        queries: Tensor,
        *,
        resolutions: Sequence[Resolution] | None = None,
        frame_chunk: int = 16,
        query_chunk: int = 16,
    ) -> TapirTracks:
        """Tracks of query points through a whole video.

        Parameters
        ----------
        video
            Frames (T, H, W, 3), RGB in [-1, 1], of any floating-point type and on any device.
        queries
            Points (N, 3) as t (frame index), y, x [px of the video].
        resolutions
            Heights and widths [px] to refine at, multiples of 8; the result is the mean over them. By default 256 x 256
            alone for a video no larger, else in steps of at most a factor 2 up to the video's own size.
        frame_chunk
            Frames that pass the backbone, or are correlated, at a time.
        query_chunk
            Points that are followed at a time.

        Raises
        ------
        DatasetError
            Video, queries or chunks are not as described.
        SessionError
            The network cannot run at a resolution.

        Notes
        -----
        Chunks bound the memory and do not change the result. With the published sizes in float32 there stay the
        feature grids of all frames at one resolution (two while the next is made): 3.4 MB a frame at 256 x 256, in
        proportion to the area. Above that pass, for each point of a chunk, about 0.2 MB per frame of a chunk and
        0.05 MB per frame of the video.
        """
        check_chunks(frame_chunk, query_chunk)
        image_size = check_video(video)
        check_queries(queries, len(video), image_size)
        resolutions = check_resolutions(resolutions, image_size, self.config)
        initial = self.config.initial_resolution
        parts = torch.split(self._like_parameters(queries), query_chunk)
        iterates: list[list[Estimate]] = [[] for _ in parts]
        for grids in self._levels(video, resolutions, frame_chunk):
            for part, estimates in zip(parts, iterates, strict=True):
                points = grids.at(part, image_size)
                if not estimates:
                    first = initialize(self.torch_cost_volume_track_mods, grids, points, frame_chunk=frame_chunk)
                    estimates.append(first.anchored(part, scale_between(image_size, initial, part)))
                else:
                    estimates.extend(self._refine(grids, points, estimates, frame_chunk=frame_chunk)[0])
        return report_tracks(iterates, self.config.iterations, scale_between(initial, image_size, parts[0]))

    def query_features(
        self, frame: Tensor, queries: Tensor, *, resolutions: Sequence[Resolution] | None = None
    ) -> QueryFeatures:
        """Features of points of one frame: what ``step`` follows.

        Parameters
        ----------
        frame
            RGB in [-1, 1], shape (H, W, 3).
        queries
            Points as 0, y, x, shape (N, 3) [frames, px, px].
        resolutions
            Heights and widths to refine at [px], as in `track`.

        Raises
        ------
        DatasetError
            Frame or queries are not as described.
        SessionError
            The network cannot run at a resolution.
        """
        video = frame[None]
        image_size = check_video(video)
        check_queries(queries, 1, image_size)
        resolutions = check_resolutions(resolutions, image_size, self.config)
        queries = self._like_parameters(queries)
        levels = tuple(grids.at(queries, image_size) for grids in self._levels(video, resolutions, 1))
        return QueryFeatures(levels, resolutions, image_size)

    def initial_state(self, n_points: int, *, n_resolutions: int = 1) -> CausalState:
        """Memory of online use before the first frame.

        Parameters
        ----------
        n_points
            Number N of points.
        n_resolutions
            Number of refinement resolutions.

        Returns
        -------
        state
            Zeros, shapes (blocks, N, 2, C) and (blocks, N, 2, 4 C) for the last two frames of every refinement [1].

        Raises
        ------
        SessionError
            The network is not causal.

        Notes
        -----
        Two frames of normalised inputs and activations, for every block and refinement. With the published sizes
        1 MB per point and resolution in float32, whatever the length of the video.
        """
        normalized, activated = self._state_shapes(n_points)
        like = self.torch_pips_mixer.linear.weight
        empty = MixerState(like.new_zeros(normalized), like.new_zeros(activated))
        return CausalState((empty,) * (self.config.iterations * n_resolutions))

    def step(self, frame: Tensor, features: QueryFeatures, state: CausalState) -> OnlineStep:
        """Position of the query points in the next frame of a video.

        Parameters
        ----------
        frame
            RGB in [-1, 1], of the size of the query frame, shape (H, W, 3).
        features
            Result of ``query_features`` for N points.
        state
            Result of ``initial_state`` for the first frame, then of the step before; it is not changed.

        Returns
        -------
        step
            Column and row, shape (N, 2) [px of the frame], logits, shape (N,) [1], and the state after this frame.

        Raises
        ------
        DatasetError
            The frame has another size than the query frame, or the state is not of these points and resolutions.
        SessionError
            The network is not causal.

        Notes
        -----
        The answer is the last iterate at the last resolution. The query frame is no exception: its points are found
        again like any other frame's.
        """
        shapes = self._state_shapes(len(features.points[0].lowres))
        check_state(state, self.config.iterations * len(features.resolutions), shapes)
        image_size = check_video(frame[None])
        if image_size != features.image_size:
            raise DatasetError(
                f"frame: expected the query frame's size {features.image_size}, got {image_size}; resize it"
            )
        estimates: list[Estimate] = []
        states: list[MixerState] = []
        for grids, points in zip(self._levels(frame[None], features.resolutions, 1), features.points, strict=True):
            if not estimates:
                estimates.append(initialize(self.torch_cost_volume_track_mods, grids, points))
            else:
                past = state.refinements[len(states) :]
                refined, after = self._refine(grids, points, estimates, past=past)
                estimates.extend(refined)
                states.extend(after)
        last = estimates[-1]
        tracks = last.position[:, 0] * scale_between(self.config.initial_resolution, image_size, last.position)
        return OnlineStep(tracks, last.occlusion[:, 0], last.expected_dist[:, 0], CausalState(tuple(states)))

    def feature_grids(self, video: Tensor, resolution: Resolution, *, frame_chunk: int = 16) -> FeatureGrids:
        """Feature grids of a video at one resolution.

        Parameters
        ----------
        video
            Frames, RGB in [-1, 1], shape (T, H, W, 3).
        resolution
            Height and width that the frames are resized to [px].
        frame_chunk
            Frames that pass the backbone at a time.
        """
        hires, lowres = [], []
        for frames in frame_chunks(len(video), frame_chunk):
            images = self._like_parameters(video[frames]).movedim(-1, 1)
            images = F.interpolate(images, size=resolution, mode="bilinear", align_corners=False)
            fine, coarse = self.resnet_torch(images)
            if self.extra_convs is not None:
                coarse = self.extra_convs(coarse)
            hires.append(normalize_channels(fine))
            lowres.append(normalize_channels(coarse))
        pyramid = [torch.cat(lowres)]
        for _ in range(self.config.pyramid_level):
            pyramid.append(F.avg_pool2d(pyramid[-1], 2))
        return FeatureGrids(torch.cat(hires), pyramid[0], tuple(pyramid[1:]), resolution)

    def _levels(self, video: Tensor, resolutions: Sequence[Resolution], frame_chunk: int) -> Iterator[FeatureGrids]:
        """Grids for the initialisation, then for each refinement; equal neighbours are made once."""
        grids: FeatureGrids | None = None
        for resolution in (self.config.initial_resolution, *resolutions):
            if grids is None or grids.resolution != resolution:
                grids = self.feature_grids(video, resolution, frame_chunk=frame_chunk)
            yield grids

    def _refine(
        self,
        grids: FeatureGrids,
        points: PointFeatures,
        earlier: Sequence[Estimate],
        *,
        past: Sequence[MixerState] = (),
        frame_chunk: int = 1,
    ) -> tuple[list[Estimate], list[MixerState]]:
        """All refinements at one resolution, from the latest position and the first estimates of the logits."""
        start = Estimate(earlier[-1].position, earlier[0].occlusion, earlier[0].expected_dist)
        refiner = Refiner(self.torch_pips_mixer, self.config)
        return refiner.refine(grids, points, start, past=past, frame_chunk=frame_chunk)

    def _state_shapes(self, n_points: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Shapes of both parts of a mixer state; a network that is not causal has none."""
        if not self.config.causal:
            raise SessionError(
                "online tracking: expected a causal network, got an offline one; load the causal checkpoint"
            )
        shape = (self.config.mixer_blocks, n_points, PAST_FRAMES)
        return (*shape, self.config.mixer_channels), (*shape, EXPANSION * self.config.mixer_channels)

    def _like_parameters(self, values: Tensor) -> Tensor:
        """The values in the type and on the device of the parameters."""
        like = self.torch_pips_mixer.linear.weight
        return values.to(like.device, like.dtype)
