"""What a tracker is, and how one is found by name; `vfm_sdm.core.parts` lists them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.registry import find, make
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import Method
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.inputs import find_reference
from vfm_sdm.stages.tracking.looks import Look
from vfm_sdm.stages.tracking.standings import Standing

__all__ = [
    "DesignedTracker",
    "SegmentTracker",
    "Targets",
    "Tracker",
    "TrackerOfViews",
    "WithoutStarts",
    "check_later_points",
    "find_tracker",
    "track_whole",
    "tracker_of",
]


@dataclass(frozen=True, eq=False)
class Targets:
    """What is followed in one view.

    Parameters
    ----------
    points
        Positions in the reference frame, shape (P, 2) [px], full-image pixels.
    names
        Point names, length P.
    designs
        Size, warp and mask of each point's subset, for trackers that compare designed ones; ``None`` for a point that
        is not to be tracked.
    segments
        Number of segments of the recording, among which measurements in some frames are shared.
    named
        Frames in which they are named, where these are not all the first one, with the points of each; none of these
        says where its points are as a segment begins.
    """

    points: FloatArray
    names: tuple[str, ...]
    designs: Sequence[SubsetDesign | None] | None = None
    segments: int = 1
    named: tuple[Standing, ...] = ()

    @property
    def homes(self) -> tuple[Standing, ...]:
        """The frames in which they are named, with the points of each."""
        return self.named or (Standing.of_first(self.points),)

    @property
    def named_frames(self) -> IntArray:
        """Number of the frame in which each is named, shape (P,)."""
        numbers = np.zeros(len(self.points), np.int64)
        for one in self.named:
            numbers[one.rows] = one.number
        return numbers

    def of(self, rows: IntArray, points: FloatArray) -> "Targets":
        """Some of them, where they are in another reference frame.

        Parameters
        ----------
        rows
            Which, shape (N,).
        points
            Where they are in it, shape (N, 2) [px].
        """
        names = tuple(self.names[row] for row in rows.tolist())
        designs = None if self.designs is None else [self.designs[row] for row in rows.tolist()]
        return replace(self, points=points, names=names, designs=designs, named=())


class Tracker(Protocol):
    """Follows named points through one view."""

    name: str

    def track(
        self,
        video: Video,
        points2d: FloatArray,
        *,
        names: Sequence[str],
        reference_frame: int = 0,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Tracks dataset of the view (see `vfm_sdm.core.datasets`), every frame registered to the reference frame.

        Parameters
        ----------
        video
            The view; read once, in order.
        points2d
            Positions in the reference frame, shape (P, 2) [px], full-image pixels.
        names
            Point names, length P.
        reference_frame
            Index of the frame in which ``points2d`` are given.
        progress
            Called with ``tracking``, the number of frames done so far and that of all.
        """
        ...


@runtime_checkable
class DesignedTracker(Protocol):
    """A tracker that compares subsets, which can be designed for each point."""

    name: str
    compares_designed_subsets: bool

    def track(
        self,
        video: Video,
        points2d: FloatArray,
        *,
        names: Sequence[str],
        reference_frame: int = 0,
        progress: Progress | None = None,
        designs: Sequence[SubsetDesign | None] | None = None,
    ) -> xr.Dataset:
        """Tracks dataset of the view; see `Tracker.track`.

        Parameters
        ----------
        video, points2d, names, reference_frame, progress
            As in `Tracker.track`.
        designs
            Size, warp and mask of each point's subset; ``None`` for a point that is not to be tracked.
        """
        ...


@runtime_checkable
class TrackerOfViews(Protocol):
    """A tracker that must know which view it follows, as one whose tracks are in files."""

    def of_view(self, view: str) -> Tracker:
        """The tracker for one view.

        Parameters
        ----------
        view
            Its name.

        Raises
        ------
        SessionError
            It cannot follow this view.
        """
        ...


@runtime_checkable
class SegmentTracker(Protocol):
    """A tracker that follows points through a segment of a recording without the segments before it.

    One with an attribute ``takes_later_points``, which is true, also follows points that are named in other frames than
    the first (`Targets.named`); one with an attribute ``at_once`` follows several segments in threads of one process.

    Its `Tracker.track` is `judge` of the record that `follow` makes of the whole recording.
    """

    name: str
    in_one_piece: bool
    """Whether it sees no segments, but recordings as a whole."""

    def follow(
        self,
        video: Video,
        reference: Frame | None,
        targets: Targets,
        *,
        start: Sequence[Standing] | None = None,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """What is seen of the targets, frame by frame, to be judged when the whole recording was seen.

        Parameters
        ----------
        video
            The segment; read once, in order.
        reference
            The reference frame; ``None`` for the first frame of the segment.
        targets
            What is followed.
        start
            What the targets are compared with and where they are as the segment begins, of `find_starts`; with the
            reference frame, and as in it, when left out.
        progress
            Called with ``tracking``, the number of frames done so far and that of all.

        Returns
        -------
        record
            Variables over ``time``, over ``sample`` (measurements in some frames), or over neither, which are alike in
            all segments; see `vfm_sdm.stages.tracking.segments.join_records`.
        """
        ...

    def find_starts(
        self, looks: Sequence[Look], reference: LumaArray, targets: Targets
    ) -> Sequence[Sequence[Standing] | None]:
        """What the targets are compared with and where they are as each segment but the first begins.

        ``None`` stands for the frames in which they are named, and as they are there.

        Parameters
        ----------
        looks
            Looks at those segments.
        reference
            The reference frame, shape (H, W).
        targets
            What is followed.
        """
        ...

    def on_one_thread(self) -> Self:
        """The same tracker for one of several processes that share the processors."""
        ...

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """Tracks of the targets (see `vfm_sdm.core.datasets`), by what was seen of them.

        Parameters
        ----------
        record
            Of `follow`, or of several segments joined.
        targets
            What was followed.
        info
            What is known of the recording.
        """
        ...


class WithoutStarts:
    """What trackers have in common that need not know where targets are as a segment begins."""

    in_one_piece = False

    def find_starts(self, looks: Sequence[Look], reference: LumaArray, targets: Targets) -> list[None]:
        """Nothing, once for each look; see `SegmentTracker.find_starts`.

        Parameters
        ----------
        looks, reference, targets
            As there.
        """
        return [None] * len(looks)

    def on_one_thread(self) -> Self:
        """The tracker itself."""
        return self


def check_later_points(tracker: Tracker, names: Sequence[str]) -> None:
    """Refuses points that come into view later where the tracker begins with the first frame.

    Parameters
    ----------
    tracker
        Who is to follow them.
    names
        Names of the points that are named in another frame than the first.

    Raises
    ------
    SessionError
        There are some, and the tracker does not take them.

    Examples
    --------
    >>> from vfm_sdm.stages.tracking.icgn import IcgnTracker
    >>> check_later_points(IcgnTracker(), ["behind the lorry"])
    """
    if names and not getattr(tracker, "takes_later_points", False):
        raise SessionError(
            f"point {', '.join(map(repr, names))}: expected points of the first frame, with which tracker "
            f'{tracker.name!r} begins, got frame or time_s; choose tracker "icgn" or "template", or begin the '
            "measurement where all points are in view (use_s)"
        )


def track_whole(
    tracker: SegmentTracker, video: Video, targets: Targets, reference_frame: int, progress: Progress | None
) -> xr.Dataset:
    """Tracks of a recording in one piece; see `Tracker.track`.

    Parameters
    ----------
    tracker
        Who follows.
    video
        The view.
    targets
        What is followed.
    reference_frame, progress
        As there.

    Raises
    ------
    DatasetError
        There is no such reference frame.
    """
    record = tracker.follow(video, find_reference(video, reference_frame), targets, progress=progress)
    return tracker.judge(record, targets, video.info).assign_attrs(reference_frame=reference_frame)


def tracker_of(method: Method) -> Tracker:
    """The tracker that a session asks for, with the session's settings.

    Raises
    ------
    BackendUnavailableError
        No tracker has this name, or it cannot run here.
    """
    tracker: Tracker = make("trackers", method)
    return tracker


def find_tracker(name: str, **options: Any) -> Tracker:
    """The tracker of this name, made with the given options.

    Raises
    ------
    BackendUnavailableError
        No tracker has this name, or it cannot run here.
    """
    tracker: Tracker = find("trackers", name).make(**options)
    return tracker
