"""All points tracked in every view, each view on its own clock (A of Figure 4)."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.products import Resume
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.tracking.base import DesignedTracker, Tracker
from vfm_sdm.stages.tracking.frame_clock import check_frames
from vfm_sdm.stages.tracking.lone_errors import include_lone_errors
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.stages.tracking.track_noise import include_track_noise

__all__ = ["track_views"]


def track_views(
    videos: Mapping[str, Video],
    points: xr.Dataset,
    tracker: Tracker,
    *,
    subsets: Mapping[str, Mapping[str, SubsetChoice]] | None = None,
    progress: Progress | None = None,
    resume: Resume[dict[str, xr.Dataset]] | None = None,
) -> dict[str, xr.Dataset]:
    """Tracks of all points in every view, each on its own clock; a point without a position is lost throughout.

    Covariances are raised to the scatter of the tracks, see `include_track_noise`, and those of single samples to how
    far they leave their path, see `include_lone_errors`. The decoder's report on each recording is the attribute
    ``recording`` of its tracks, a table.

    Parameters
    ----------
    videos
        Recordings by view name.
    points
        Points dataset: positions in the first frame of every view, shape (V, P, 2) [px].
    tracker
        Tracker that follows the points.
    subsets
        What the subset of each point compares, by view and point, for trackers that have subsets to design; a point
        that is refused there has no track.
    progress
        Called with the view and the frames done.
    resume
        Views that were done before this run, and how to keep those that are.

    Raises
    ------
    VideoError
        A recording cannot be decoded.
    DatasetError
        A position does not lie in its picture.
    """
    done = (None if resume is None else resume.found) or {}
    tracks: dict[str, xr.Dataset] = {}
    for view, video in videos.items():
        if view in done:
            tracks[view] = done[view]
            continue
        if tracks and resume is not None:
            resume.keep(tracks)
        chosen = None if subsets is None else subsets.get(view)
        found = _track_view(video, points.sel(view=view), tracker, chosen, _named(progress, view))
        if chosen:
            found = found.assign(_describe_choices(chosen, [str(name) for name in found["point"].values]))
        found.attrs.update(view=view, image_width=video.info.width, image_height=video.info.height)
        found.attrs["pixel_aspect"] = video.info.pixel_aspect
        clock = check_frames(found, alike=video.report.alike)
        tracks[view] = include_lone_errors(include_track_noise(clock.tracks))
        tracks[view].attrs["recording"] = {
            **asdict(video.report),
            "stated_frames": video.info.frame_count,
            "bits_per_pixel": _bits_per_pixel(video),
            "time_scale": video.info.time_scale,
            **clock.facts,
            "remarks": [*video.info.remarks, *clock.facts["remarks"]],
            "doubts": [*video.info.doubts, *clock.facts["doubts"]],
        }
    return tracks


def _track_view(
    video: Video,
    points: xr.Dataset,
    tracker: Tracker,
    subsets: Mapping[str, SubsetChoice] | None,
    progress: Progress | None,
) -> xr.Dataset:
    """Tracks of one view; rows of NaN and status lost for the points that have no position."""
    names = [str(name) for name in points["point"].values]
    positions = points["position"].transpose("point", "pixel").values
    known = np.isfinite(positions).all(axis=1)
    if not known.any():
        return _lost_tracks(np.array([frame.time_s for frame in video.frames()]), names)
    chosen = [name for name, ok in zip(names, known, strict=True) if ok]
    if subsets and isinstance(tracker, DesignedTracker):
        designs = [subsets[name].design for name in chosen]
        tracks = tracker.track(video, positions[known], names=chosen, progress=progress, designs=designs)
    else:
        tracks = tracker.track(video, positions[known], names=chosen, progress=progress)
    if known.all():
        return tracks
    missing = {
        "status": tracks["status"].dtype.type(Status.LOST),
        "subset_px": 0,
        "warp": "",
        "shading": 0,
        "believed": 0.0,
    }
    return tracks.reindex(point=names, fill_value={name: missing.get(str(name), np.nan) for name in tracks.data_vars})


def _describe_choices(subsets: Mapping[str, SubsetChoice], names: list[str]) -> dict[str, Any]:
    """Variables that say of each point whether its subset was refused, and which place would do."""
    status = [str(subsets[name].status) if name in subsets else "" for name in names]
    nearest = [subsets[name].nearest if name in subsets else np.full(2, np.nan) for name in names]
    return {
        "subset_status": ("point", np.array(status, dtype=object)),
        "nearest_texture": (("point", "pixel"), np.array(nearest), {"units": "px"}),
    }


def _lost_tracks(time_s: FloatArray, names: list[str]) -> xr.Dataset:
    """Tracks of points none of which has a position."""
    shape = (len(time_s), len(names))
    nothing = np.full((*shape, 2), np.nan), np.full((*shape, 2, 2), np.nan)
    return make_tracks(time_s, names, *nothing, np.full(shape, Status.LOST), attrs={})


def _named(progress: Progress | None, view: str) -> Progress | None:
    """Progress that also says which view it is about."""
    return None if progress is None else lambda what, done, total: progress(f"{what} {view}", done, total)


def _bits_per_pixel(video: Video) -> float:
    """Size of a video's file over the pixels it holds; NaN for images."""
    pixels = video.info.width * video.info.height * max(video.report.frames, 1)
    return float("nan") if video.info.size_bytes is None else 8 * video.info.size_bytes / pixels
