"""Trackers that see a recording as a whole, and views without points, as `SegmentTracker` has them."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.tracking.base import DesignedTracker, Targets, Tracker
from vfm_sdm.stages.tracking.looks import Look
from vfm_sdm.stages.tracking.standings import Standing

__all__ = ["InOnePiece", "NoTargets"]


class InOnePiece:
    """Any tracker as one whose only segment is the whole recording.

    Parameters
    ----------
    tracker
        Who follows.
    """

    in_one_piece = True

    def __init__(self, tracker: Tracker) -> None:
        self.tracker, self.name = tracker, tracker.name

    def follow(
        self,
        video: Video,
        reference: Frame | None,
        targets: Targets,
        *,
        start: Sequence[Standing] | None = None,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Tracks of the targets; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        video, reference, targets, start, progress
            As there.
        """
        if targets.designs is not None and isinstance(self.tracker, DesignedTracker):
            return self.tracker.track(
                video, targets.points, names=targets.names, progress=progress, designs=targets.designs
            )
        return self.tracker.track(video, targets.points, names=targets.names, progress=progress)

    def find_starts(self, looks: Sequence[Look], reference: LumaArray, targets: Targets) -> list[None]:
        """Nothing, for there are no segments.

        Parameters
        ----------
        looks, reference, targets
            As of `vfm_sdm.stages.tracking.base.SegmentTracker`.
        """
        return [None] * len(looks)

    def on_one_thread(self) -> "InOnePiece":
        """The same tracker, which may not know how to do without threads."""
        return self

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """The tracks.

        Parameters
        ----------
        record
            Of `follow`.
        targets, info
            As of `vfm_sdm.stages.tracking.base.SegmentTracker`.
        """
        return record


class NoTargets:
    """Who follows nothing, and reads the clock of a view."""

    name = "none"
    in_one_piece = False

    def follow(
        self,
        video: Video,
        reference: Frame | None,
        targets: Targets,
        *,
        start: Sequence[Standing] | None = None,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """When the frames were taken; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        video, reference, targets, start, progress
            As there.
        """
        time_s = np.array([frame.time_s for frame in video.frames()])
        return xr.Dataset(coords={"time": ("time", time_s, {"units": "s"})})

    def find_starts(self, looks: Sequence[Look], reference: LumaArray, targets: Targets) -> list[None]:
        """Nothing.

        Parameters
        ----------
        looks, reference, targets
            As of `vfm_sdm.stages.tracking.base.SegmentTracker`.
        """
        return [None] * len(looks)

    def on_one_thread(self) -> "NoTargets":
        """The same."""
        return self

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """Tracks of no points.

        Parameters
        ----------
        record, targets, info
            As of `vfm_sdm.stages.tracking.base.SegmentTracker`.
        """
        frames = record.sizes["time"]
        nothing = np.zeros((frames, 0, 2)), np.zeros((frames, 0, 2, 2))
        return make_tracks(record["time"].values, (), *nothing, np.full((frames, 0), Status.LOST), attrs={})
