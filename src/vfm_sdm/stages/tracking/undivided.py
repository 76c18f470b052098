"""Trackers that see a recording as a whole, and views without points, as `SegmentTracker` has them."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.tracking.base import DesignedTracker, Targets, Tracker, WithoutStarts
from vfm_sdm.stages.tracking.standings import Standing

__all__ = ["InOnePiece", "NoTargets"]


class InOnePiece(WithoutStarts):
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


class NoTargets(WithoutStarts):
    """Who follows nothing, and reads the clock of a view."""

    name = "none"

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
