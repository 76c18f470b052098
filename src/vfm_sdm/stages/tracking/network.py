"""Points followed by a network through patches around them, chunk by chunk, and the status of what it finds."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import Network
from vfm_sdm.inputs.video import Frame, RgbArray, Video, VideoInfo
from vfm_sdm.networks.availability import choose_weights, require_torch
from vfm_sdm.networks.interface import SEEN, ChunkNetwork, ChunkTracks
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.tracking.base import Targets, WithoutStarts
from vfm_sdm.stages.tracking.chunks import ChunkPlan, ChunkStitcher
from vfm_sdm.stages.tracking.inputs import check_points, find_reference
from vfm_sdm.stages.tracking.patches import Patch, plan_patches
from vfm_sdm.stages.tracking.standings import Standing

__all__ = ["NetworkPreset", "NetworkTracker", "PresetNetwork", "fix_reference", "record_with_network"]

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


class NetworkTracker(WithoutStarts, ABC):
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

    def __getstate__(self) -> dict[str, Any]:
        """What is sent to another process, which loads the network itself."""
        return {name: value for name, value in vars(self).items() if name != "inference"}

    def track(
        self,
        video: Video,
        points2d: FloatArray,
        *,
        names: Sequence[str],
        reference_frame: int = 0,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Tracks of named points; `record_with_network` says how their status is found.

        Parameters
        ----------
        video
            The view. It is read once, in order; a reference frame other than the first is fetched in a pass of its own.
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
        targets = Targets(check_points(points2d, names, video), tuple(names))
        record = self.follow(video, find_reference(video, reference_frame), targets, progress=progress)
        return self.judge(fix_reference(record, targets, reference_frame), targets, video.info).assign_attrs(
            reference_frame=reference_frame
        )

    def follow(
        self,
        video: Video,
        reference: Frame | None,
        targets: Targets,
        *,
        start: Sequence[Standing] | None = None,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Places of a segment; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        video, reference, targets, start, progress
            As there; every segment is followed from the reference frame on.

        Notes
        -----
        Threads stay as they are where several processes share the processors: sums of a network may depend on their
        number.
        """
        network = PresetNetwork(self.inference, self.preset)
        record = record_with_network(network, video, reference, targets, progress)
        return record.assign_attrs(precision=self.inference.precision)

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """Tracks of places; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        record, targets, info
            As there.
        """
        attrs = {
            "tracker": self.name,
            "preset": self.preset.name,
            "weights": self.weights_id,
            "source": info.source,
            "image_width": info.width,
            "image_height": info.height,
            "reference_frame": 0,
            **record.attrs,
        }
        values = (record[name].values for name in ("position", "position_covariance", "status"))
        return make_tracks(record["time"].values, targets.names, *values, attrs=attrs)


def record_with_network(
    network: PresetNetwork,
    video: Video,
    reference: Frame | None,
    targets: Targets,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Places of named points through a network.

    Parameters
    ----------
    network
        Network that follows the points, and how it sees the recording.
    video
        The view, or a segment of it; it is read once, in order.
    reference
        The reference frame, which the network sees before the others; ``None`` for the first frame.
    targets
        Points in the reference frame.
    progress
        Called with ``tracking``, the number of frames done so far and that of all.

    Returns
    -------
    record
        ``position`` [px], ``position_covariance`` [px2] and ``status`` of T frames and P points.

    Raises
    ------
    DatasetError
        The video has no frame, or its pictures are too small.
    BackendUnavailableError
        The device has no memory for a few frames.

    Notes
    -----
    The status is ``outside`` where a point left the image; ``lost`` where the network calls it hidden or gives no
    position, or where it left its patch; ``unreliable`` below half the confidence.
    """
    points, preset = targets.points, network.preset
    image_size = (video.info.width, video.info.height)
    patches = plan_patches(
        points, image_size, side_px=preset.side_px, multiple=preset.multiple, least_px=preset.least_px
    )
    followers = [_Follower.of(network, patch, points[patch.rows]) for patch in patches]
    if reference is not None:
        for follower in followers:
            follower.feed(reference)
    time_s: list[float] = []
    for frame in video.frames():
        time_s.append(frame.time_s)
        for follower in followers:
            follower.feed(frame)
        if progress is not None:
            progress("tracking", len(time_s), video.info.frame_count)
    if not time_s and reference is None:
        raise DatasetError("video: expected at least one frame, got none; check the file")
    position = np.full((len(time_s), len(points), 2), np.nan)
    status = np.full((len(time_s), len(points)), int(Status.LOST))
    for follower in followers:
        rows, found = follower.patch.rows, follower.stitcher.finish()
        position[:, rows], status[:, rows] = _judge(found[len(found) - len(time_s) :], follower.patch, image_size)
    covariance = np.where(np.isfinite(position).all(axis=2)[..., None, None], _STD_PX**2 * np.eye(2), np.nan)
    if reference is None:
        covariance[0] *= 0
    return xr.Dataset(
        {
            "position": (("time", "point", "pixel"), position, {"units": "px"}),
            "position_covariance": (("time", "point", "pixel_a", "pixel_b"), covariance, {"units": "px2"}),
            "status": (("time", "point"), status.astype(np.int8)),
        },
        coords={"time": ("time", time_s, {"units": "s"})},
        attrs={"patches": len(patches), "chunk_frames": min(f.stitcher.plan.frames for f in followers)},
    )


def fix_reference(record: xr.Dataset, targets: Targets, frame: int) -> xr.Dataset:
    """A record in which the points are where they were named in a reference frame.

    Parameters
    ----------
    record
        Of T frames and P points.
    targets
        Points in the reference frame.
    frame
        Its number.
    """
    fixed = record.copy(deep=True)
    fixed["position"][frame], fixed["status"][frame] = targets.points, Status.OK
    fixed["position_covariance"][frame] = 0.0
    return fixed


@dataclass(frozen=True, eq=False)
class _Follower:
    """The points of one patch, followed from the reference frame on."""

    preset: NetworkPreset
    patch: Patch
    stitcher: ChunkStitcher

    @classmethod
    def of(cls, network: PresetNetwork, patch: Patch, points: FloatArray) -> "_Follower":
        stitcher = ChunkStitcher(network.network, network.preset.plan, patch.region.from_full(points))
        return cls(network.preset, patch, stitcher)

    def feed(self, frame: Frame) -> None:
        """Takes the next frame."""
        self.stitcher.feed(self.preset.picture(frame.color(self.patch.region)))


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
