"""Points followed by a network through patches around them, chunk by chunk, and the status of what it finds."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import Network
from vfm_sdm.inputs.video import RgbArray, Video
from vfm_sdm.networks.availability import choose_weights, require_torch
from vfm_sdm.networks.interface import SEEN, ChunkNetwork, ChunkTracks
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.tracking.chunks import ChunkPlan, ChunkStitcher
from vfm_sdm.stages.tracking.inputs import check_points
from vfm_sdm.stages.tracking.patches import Patch, plan_patches

__all__ = ["NetworkPreset", "NetworkTracker", "PresetNetwork", "follow_with_network"]

_STD_PX = 0.25
"""Standard deviation of a network's position [px]. It is an assumption: networks state none, and without weights none
could be measured. The scatter of a track is seen, and replaces it where it is larger
(`vfm_sdm.stages.tracking.track_noise`)."""
_SURE = 0.5
"""Confidence below which a position is unreliable."""


@dataclass(frozen=True)
class NetworkPreset:
    """How a network sees a recording.

    Parameters
    ----------
    name
        Name in the tracks' attributes.
    plan
        Settings of the chunks.
    side_px, multiple, least_px
        Sizes of the patches [px], see `vfm_sdm.stages.tracking.patches.plan_patches`.
    canvas
        Width and height of the picture that a patch is laid into, at the top left, the rest black [px]; without one
        the network sees the patch alone.
    """

    name: str
    plan: ChunkPlan
    side_px: int
    multiple: int
    least_px: int
    canvas: tuple[int, int] | None = None

    def picture(self, patch: RgbArray) -> RgbArray:
        """Picture that the network is given for a patch.

        Parameters
        ----------
        patch
            Red, green and blue, shape (height, width, 3), height and width in px.

        Examples
        --------
        >>> preset = NetworkPreset("fast", ChunkPlan(32), 28, 14, 14, canvas=(56, 42))
        >>> preset.picture(np.zeros((28, 28, 3), np.uint8)).shape
        (42, 56, 3)
        """
        if self.canvas is None:
            return patch
        width, height = self.canvas
        return np.pad(patch, ((0, height - patch.shape[0]), (0, width - patch.shape[1]), (0, 0)))


@dataclass(frozen=True, eq=False)
class PresetNetwork:
    """A network and how it sees a recording.

    Parameters
    ----------
    network
        Network that follows points through the pictures of a chunk.
    preset
        How it sees the recording.
    """

    network: ChunkNetwork
    preset: NetworkPreset


class NetworkTracker(ABC):
    """A tracker that runs a network.

    Parameters
    ----------
    network
        Weights, preset, device and precision.

    Raises
    ------
    BackendUnavailableError
        PyTorch or the weights are not here.
    """

    name: ClassVar[str]

    def __init__(self, *, network: Network | None = None) -> None:
        require_torch(f"tracker {self.name}")
        self.settings = network or Network()
        self.weights = choose_weights("trackers", self.name, self.settings.weights)

    @property
    def weights_id(self) -> str:
        """Which weights these are, for datasets and for what may be reused."""
        return weights_id(self.weights)

    @property
    @abstractmethod
    def preset(self) -> NetworkPreset:
        """How the network sees a recording."""

    @abstractmethod
    def load(self) -> ChunkNetwork:
        """The network with its weights on its device."""

    @cached_property
    def inference(self) -> ChunkNetwork:
        """The network, loaded when it is first used."""
        return self.load()

    def track(
        self,
        video: Video,
        points2d: FloatArray,
        *,
        names: Sequence[str],
        reference_frame: int = 0,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Tracks of named points; `follow_with_network` says how their status is found.

        Parameters
        ----------
        video
            The view. It is read once, in order.
        points2d
            Positions in the reference frame, shape (P, 2) [px], full-image pixels.
        names
            Point names, length P.
        reference_frame
            Index of the frame in which ``points2d`` are given.
        progress
            Called with ``tracking``, the number of frames done so far and that of all.

        Returns
        -------
        tracks
            Tracks (see `vfm_sdm.core.datasets`), shape (T, P, 2) [px].

        Raises
        ------
        DatasetError
            Points, names or reference frame do not fit the video, or its pictures are too small.
        BackendUnavailableError
            The device has no memory for a few frames.
        """
        tracks = follow_with_network(
            PresetNetwork(self.inference, self.preset),
            video,
            points2d,
            names=names,
            reference_frame=reference_frame,
            progress=progress,
        )
        return tracks.assign_attrs(
            tracker=self.name,
            preset=self.preset.name,
            weights=self.weights_id,
            precision=self.inference.precision,
        )


def follow_with_network(
    network: PresetNetwork,
    video: Video,
    points2d: FloatArray,
    *,
    names: Sequence[str],
    reference_frame: int = 0,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Tracks of named points through a network.

    Parameters
    ----------
    network
        Network that follows the points, and how it sees the recording.
    video
        The view; it is read once, in order. The patches of the frames before the reference frame are held in memory.
    points2d
        Positions in the reference frame, shape (P, 2) [px], full-image pixels.
    names, reference_frame, progress
        As in `vfm_sdm.stages.tracking.base.Tracker.track`.

    Returns
    -------
    tracks
        Tracks (see `vfm_sdm.core.datasets`), shape (T, P, 2) [px].

    Raises
    ------
    DatasetError
        Points, names or reference frame do not fit the video, or its pictures are too small.
    BackendUnavailableError
        The device has no memory for a few frames.

    Notes
    -----
    The status is ``outside`` where a point left the image; ``lost`` where the network calls it hidden or gives no
    position, or where it left its patch; ``unreliable`` below half the confidence.
    """
    points = check_points(points2d, names, video)
    if reference_frame < 0:
        raise DatasetError(f"reference_frame: expected 0 or more, got {reference_frame}; count frames from the first")
    image_size = (video.info.width, video.info.height)
    preset = network.preset
    patches = plan_patches(
        points, image_size, side_px=preset.side_px, multiple=preset.multiple, least_px=preset.least_px
    )
    followers = [_Follower(network.network, preset, patch, points[patch.rows]) for patch in patches]
    time_s: list[float] = []
    for frame in video.frames():
        time_s.append(frame.time_s)
        for follower in followers:
            follower.feed(frame.color(follower.patch.region), before=frame.index < reference_frame)
        if progress is not None:
            progress("tracking", len(time_s), video.info.frame_count)
    if reference_frame >= len(time_s):
        raise DatasetError(
            f"reference_frame: expected a frame {reference_frame}, got a video of {len(time_s)} frames; "
            "name an earlier one"
        )
    position = np.full((len(time_s), len(points), 2), np.nan)
    status = np.full((len(time_s), len(points)), int(Status.LOST))
    for follower in followers:
        rows = follower.patch.rows
        position[:, rows], status[:, rows] = _judge(follower.finish(), follower.patch, image_size)
    covariance = np.where(np.isfinite(position).all(axis=2)[..., None, None], _STD_PX**2 * np.eye(2), np.nan)
    covariance[reference_frame] *= 0
    attrs = {
        "source": video.info.source,
        "image_width": video.info.width,
        "image_height": video.info.height,
        "reference_frame": reference_frame,
        "patches": len(patches),
        "chunk_frames": min(follower.chunk_frames for follower in followers),
    }
    return make_tracks(np.array(time_s), names, position, covariance, status, attrs=attrs)


@dataclass
class _Follower:
    """The points of one patch, followed from the reference frame on, and from there back to the first frame."""

    network: ChunkNetwork
    preset: NetworkPreset
    patch: Patch
    points: FloatArray
    _before: list[RgbArray] = field(default_factory=list)
    _onward: ChunkStitcher | None = None
    _back: ChunkStitcher | None = None

    @property
    def chunk_frames(self) -> int:
        """Frames of a chunk, as far as memory allowed."""
        plans = [stitcher.plan for stitcher in (self._onward, self._back) if stitcher is not None]
        return min((plan.frames for plan in plans), default=self.preset.plan.frames)

    def feed(self, patch: RgbArray, *, before: bool) -> None:
        """Takes the next patch, shape (height, width, 3) [px]: before the reference frame, or from there on."""
        picture = self.preset.picture(patch)
        if before:
            self._before.append(picture)
            return
        if self._onward is None:
            self._onward, self._back = self._make_stitcher(), self._make_stitcher()
            for earlier in (picture, *reversed(self._before)):
                self._back.feed(earlier)
            self._before.clear()
        self._onward.feed(picture)

    def finish(self) -> ChunkTracks:
        """Tracks of all frames in pixels of the patch, once the reference frame was among them."""
        parts = [s.finish() for s in (self._back, self._onward) if s is not None]
        return ChunkTracks.joined(parts[0][:0:-1], parts[1])

    def _make_stitcher(self) -> ChunkStitcher:
        return ChunkStitcher(self.network, self.preset.plan, self.patch.region.from_full(self.points))


def _judge(found: ChunkTracks, patch: Patch, image_size: tuple[int, int]) -> tuple[FloatArray, IntArray]:
    """Positions (T, N, 2) in the full image, NaN where lost or outside, and status codes (T, N)."""
    position = patch.region.to_full(found.positions)
    status = np.where(found.confidence < _SURE, Status.UNRELIABLE, Status.OK)
    within = _inside(found.positions, (patch.region.width, patch.region.height))
    status[~within | ~(found.visibility >= SEEN)] = Status.LOST
    known = np.isfinite(found.positions).all(axis=2)
    status[known & ~_inside(position, image_size)] = Status.OUTSIDE
    gone = (status == Status.LOST) | (status == Status.OUTSIDE)
    return np.where(gone[..., None], np.nan, position), status


def _inside(position: FloatArray, size: tuple[int, int]) -> np.ndarray:
    """Whether places (..., 2) lie in a picture of this width and height, shape (...)."""
    return np.asarray(((position >= -0.5) & (position <= np.array(size) - 0.5)).all(axis=-1))
