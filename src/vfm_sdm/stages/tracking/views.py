"""All points tracked in every view, each view on its own clock (A of Figure 4)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.allocator import return_free_memory
from vfm_sdm.core.block_files import LONG_BYTES, JoinedBlocks, ScratchFile
from vfm_sdm.core.datasets import Status, frames_of_points
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.video import Video, VideoInfo
from vfm_sdm.stages.tracking.base import (
    DesignedTracker,
    SegmentTracker,
    Targets,
    Tracker,
    TrackerOfViews,
    check_later_points,
)
from vfm_sdm.stages.tracking.frame_clock import check_frames
from vfm_sdm.stages.tracking.inputs import check_points
from vfm_sdm.stages.tracking.lone_errors import include_lone_errors
from vfm_sdm.stages.tracking.segments import (
    TrackedSegments,
    Work,
    join_records,
    plan_segments,
    track_segments,
)
from vfm_sdm.stages.tracking.standings import Standing, include_references
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.stages.tracking.track_noise import include_track_noise
from vfm_sdm.stages.tracking.undivided import InOnePiece, NoTargets

__all__ = ["is_whole", "track_views"]


def track_views(
    videos: Mapping[str, Video],
    points: xr.Dataset,
    tracker: Tracker,
    *,
    subsets: Mapping[str, Mapping[str, SubsetChoice]] | None = None,
    progress: Progress | None = None,
    work: Work | None = None,
) -> dict[str, xr.Dataset]:
    """Tracks of all points in every view, each on its own clock; a point without a position is lost throughout.

    Covariances are raised to the scatter of the tracks, see `include_track_noise`, and those of single samples to how
    far they leave their path, see `include_lone_errors`; what renewed reference frames add is in all of them, see
    `vfm_sdm.stages.tracking.standings.include_references`. The decoder's report on each recording is the attribute
    ``recording`` of its tracks, a table; what could not be tracked is its entry ``untracked``, intervals [s].

    Parameters
    ----------
    videos
        Recordings by view name.
    points
        Points dataset: positions in every view, shape (V, P, 2) [px], in its first frame or in that of number
        ``frame``.
    tracker
        Tracker that follows the points.
    subsets
        What the subset of each point compares, by view and point, for trackers that have subsets to design; a point
        that is refused there has no track.
    progress
        Called with the view and the frames done.
    work
        How recordings are divided, who tracks the segments, and where they are kept.

    Raises
    ------
    VideoError
        A recording cannot be decoded.
    DatasetError
        A position does not lie in its picture.
    SessionError
        A point is named in another frame than the first, which the tracker does not take.
    """
    work = work or Work()
    views = {
        view: _View.of(video, points.sel(view=view), tracker, (subsets or {}).get(view))
        for view, video in videos.items()
    }
    plans = {
        name: plan_segments(view.video, view.tracker, view.targets, work.segment_s) for name, view in views.items()
    }
    tracked = track_segments(plans, work, progress)
    grid = {"grid": points["grid"]} if "grid" in points else {}
    return {name: _finish(name, view, tracked[name], work.folder).assign(grid) for name, view in views.items()}


def is_whole(tracks: Mapping[str, xr.Dataset]) -> bool:
    """Whether every segment of every view was tracked.

    Parameters
    ----------
    tracks
        Tracks by view, shape (T, P, 2) [px].
    """
    return not any(of_view.attrs.get("recording", {}).get("untracked") for of_view in tracks.values())


@dataclass(frozen=True, eq=False)
class _View:
    """A recording, who follows its points, and those that have a position in it."""

    video: Video
    names: list[str]
    targets: Targets
    tracker: SegmentTracker
    subsets: Mapping[str, SubsetChoice] | None

    @classmethod
    def of(
        cls, video: Video, points: xr.Dataset, tracker: Tracker, subsets: Mapping[str, SubsetChoice] | None
    ) -> "_View":
        if isinstance(tracker, TrackerOfViews):
            tracker = tracker.of_view(str(points["view"].item()))
        names = [str(name) for name in points["point"].values]
        positions = points["position"].transpose("point", "pixel").values
        known = np.isfinite(positions).all(axis=1)
        chosen = tuple(name for name, ok in zip(names, known, strict=True) if ok)
        designs = None
        if subsets and isinstance(tracker, DesignedTracker):
            designs = [subsets[name].design for name in chosen]
        numbers = frames_of_points(points, chosen)
        check_later_points(tracker, [name for name, number in zip(chosen, numbers.tolist(), strict=True) if number])
        if not chosen:
            return cls(video, names, Targets(positions[known], chosen), NoTargets(), subsets)
        places = check_points(positions[known], chosen, video)
        targets = Targets(places, chosen, designs, named=Standing.of_named(video, places, numbers))
        return cls(
            video, names, targets, tracker if isinstance(tracker, SegmentTracker) else InOnePiece(tracker), subsets
        )


def _finish(name: str, view: _View, tracked: TrackedSegments, folder: Path | None) -> xr.Dataset:
    """Tracks of a view, of the records of its segments; long ones lie in a file in the folder."""
    joined, passed = join_records(tracked.records(), JoinedBlocks(folder))
    report = passed.report(view.video.info)
    found = _settled(view.tracker.judge(joined, view.targets, view.video.info))
    del joined
    if len(view.targets.names) < len(view.names):
        missing = {
            "status": found["status"].dtype.type(Status.LOST),
            "subset_px": 0,
            "warp": "",
            "shading": 0,
            "believed": 0.0,
            "reference": 0,
        }
        fill = {key: missing.get(str(key), np.nan) for key in found.data_vars}
        found = found.reindex(point=view.names, fill_value=fill)
    if view.subsets:
        found = found.assign(_describe_choices(view.subsets, view.names))
    info = view.video.info
    found.attrs.update(view=name, image_width=info.width, image_height=info.height, pixel_aspect=info.pixel_aspect)
    clock = check_frames(found, alike=report.alike)
    tracks = include_lone_errors(_settled(include_track_noise(_settled(clock.tracks))))
    tracks = include_references(tracks, view.targets.names, [task.start for task in tracked.tasks])
    tracks.attrs["recording"] = {
        **asdict(report),
        "stated_frames": info.frame_count,
        "bits_per_pixel": _bits_per_pixel(info, report.frames),
        "time_scale": info.time_scale,
        **clock.facts,
        "segments": tracked.count,
        "untracked": [list(interval) for interval in tracked.untracked],
        "remarks": [*info.remarks, *tracked.remarks, *clock.facts["remarks"]],
        "doubts": [*info.doubts, *tracked.doubts, *clock.facts["doubts"]],
    }
    del found, clock
    return _settled(_put_by(tracks, folder))


def _put_by(tracks: xr.Dataset, folder: Path | None) -> xr.Dataset:
    """The same tracks, in a file where they are long."""
    if tracks.nbytes <= LONG_BYTES:
        return tracks.load()
    return ScratchFile(folder).write(tracks)


def _settled(tracks: xr.Dataset) -> xr.Dataset:
    """The same tracks; of long ones, memory that it took to make them goes back first."""
    if tracks.nbytes > LONG_BYTES:
        return_free_memory()
    return tracks


def _describe_choices(subsets: Mapping[str, SubsetChoice], names: list[str]) -> dict[str, Any]:
    """Variables that say of each point whether its subset was refused, and which place would do."""
    status = [str(subsets[name].status) if name in subsets else "" for name in names]
    nearest = [subsets[name].nearest if name in subsets else np.full(2, np.nan) for name in names]
    return {
        "subset_status": ("point", np.array(status, dtype=object)),
        "nearest_texture": (("point", "pixel"), np.array(nearest), {"units": "px"}),
    }


def _bits_per_pixel(info: VideoInfo, frames: int) -> float:
    """Size of a video's file over the pixels it holds; NaN for images."""
    pixels = info.width * info.height * max(frames, 1)
    return float("nan") if info.size_bytes is None else 8 * info.size_bytes / pixels
