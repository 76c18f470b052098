"""The traditional monocular baseline: target tracking by normalised cross-correlation, and a scale factor."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from copy import copy

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.threads import thread_pool
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.registration.peaks import correlation_peaks, cut_subset, has_rival
from vfm_sdm.stages.registration.subsets import SubsetBank, check_subset_px
from vfm_sdm.stages.tracking.base import Targets, WithoutStarts, track_whole
from vfm_sdm.stages.tracking.inputs import check_correlations, check_counts, check_points, follow_frames
from vfm_sdm.stages.tracking.standings import Standing, join_points

__all__ = ["DIVISIONS", "TemplateTracker"]

DIVISIONS = 16
"""Resolution of the tracker: parts of a pixel (paper, section Quantitative results)."""

_PEAKS = 4

_Located = tuple[FloatArray, FloatArray, FloatArray, IntArray]
"""Positions, covariances, correlations and status codes of one frame."""


class TemplateTracker(WithoutStarts):
    """Follows targets by normalised cross-correlation with the reference frame, to 1/16 px.

    Parameters
    ----------
    subset_px
        Side of the square target around each point, odd [px].
    roi_margin_px
        How far around its place in the reference frame the target is looked for [px]. The region of interest does
        not move, so errors do not add up.
    minimum_correlation
        Below this ZNCC a target is lost.
    reliable_correlation
        Below this ZNCC it is unreliable.
    threads
        Threads that share the targets; all processors by default.

    Raises
    ------
    SessionError
        A setting is out of its range.

    Notes
    -----
    The integer peak is found over the whole region of interest; around it, the correlation is evaluated on the grid
    of 1/16 px with the current frame interpolated by the same quintic spline as in `icgn`. Translation only.

    A translation cannot follow a false match the way an affine warp does, to a place where it fits even worse, so
    smooth textures correlate with unrelated ones; the limits are therefore higher than those of `icgn`.

    The stated covariance is that of the quantisation, (1/16)^2 / 12 along each axis, plus the noise term of `icgn`
    (`vfm_sdm.stages.tracking.icgn.IcgnTracker`). Rotation and deformation of the target are not in it, nor that noise
    draws the maximum of a correlation towards half pixels, where interpolation smooths it (with the square of the
    noise: below 0.01 px at 1 % on a good texture, some 0.05 px at 3 %).

    ``lost``: correlation too low, several places equally good, or the peak lies on the border of the region of
    interest; ``outside``: it lies on the border of the image.

    References
    ----------
    .. [1] Ji, X., Miao, Z., Kromanis, R. (2020). Vision-based measurements of deformations and cracks for RC
       structure tests. Engineering Structures 212, 110508.
    .. [2] Kromanis, R., Kripakaran, P. (2021). A multiple camera position approach for accurate displacement
       measurement using computer vision. Journal of Civil Structural Health Monitoring 11, 661-678.
    """

    name = "template"
    takes_later_points = True

    def __init__(
        self,
        *,
        subset_px: int = 41,
        roi_margin_px: int = 40,
        minimum_correlation: float = 0.7,
        reliable_correlation: float = 0.9,
        threads: int | None = None,
    ) -> None:
        check_subset_px(subset_px, "subset_px")
        check_counts(self.name, roi_margin_px=roi_margin_px, threads=threads)
        check_correlations(self.name, minimum_correlation, reliable_correlation)
        self.subset_px, self.roi_margin_px = subset_px, roi_margin_px
        self.minimum_correlation, self.reliable_correlation = minimum_correlation, reliable_correlation
        self.threads = threads or os.cpu_count() or 1

    def track(
        self,
        video: Video,
        points2d: FloatArray,
        *,
        names: Sequence[str],
        reference_frame: int = 0,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Tracks of named points, every frame compared with the reference frame.

        Parameters
        ----------
        video
            The view. Read once, in order; a reference frame other than the first is fetched in a pass of its own.
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
        xr.Dataset
            Tracks (see `vfm_sdm.core.datasets`) with one more variable, ``correlation`` (time, point): ZNCC [1].

        Raises
        ------
        DatasetError
            Points lie outside the image, names are not distinct, or there is no such reference frame.
        """
        targets = Targets(check_points(points2d, names, video), tuple(names))
        return track_whole(self, video, targets, reference_frame, progress)

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
            As there; targets are looked for around their places in the reference frame, wherever they were last.
        """
        standings = start or targets.homes
        located: list[list[_Located]] = [[] for _ in standings]
        with thread_pool(self.threads) as executor:

            def begin(luma: LumaArray) -> Callable[[LumaArray], None]:
                sets = [_TemplateSet(self, one.luma(luma), one.points, executor) for one in standings]

                def advance(luma: LumaArray) -> None:
                    for into, one in zip(located, sets, strict=True):
                        into.append(one.locate(luma))

                return advance

            time_s = follow_frames(video, reference, begin, progress)
        return join_points(
            [_as_record(of, len(one.rows), time_s) for of, one in zip(located, standings, strict=True)], standings
        )

    def on_one_thread(self) -> "TemplateTracker":
        """The same tracker for one of several processes that share the processors."""
        tracker = copy(self)
        tracker.threads = 1
        return tracker

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """Tracks of places; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        record, targets, info
            As there.
        """
        attrs = {
            "tracker": self.name,
            "source": info.source,
            "image_width": info.width,
            "image_height": info.height,
            "reference_frame": 0,
            "subset_px": self.subset_px,
            "resolution_px": 1 / DIVISIONS,
        }
        values = (record[name].values for name in ("position", "position_covariance", "status"))
        tracks = make_tracks(record["time"].values, targets.names, *values, attrs=attrs)
        if targets.named:
            tracks = tracks.assign(reference=record["reference"])
        return tracks.assign(correlation=(("time", "point"), record["correlation"].values, {"units": "1"}))


def _as_record(located: Sequence[_Located], points: int, time_s: FloatArray) -> xr.Dataset:
    """Places of so many targets in all frames as a record."""
    shape = (len(located), points)
    position, covariance, correlation, status = (
        np.array([one[part] for one in located]).reshape(*shape, *(2,) * more) for part, more in enumerate((1, 2, 0, 0))
    )
    variables = {
        "position": (("time", "point", "pixel"), position, {"units": "px"}),
        "position_covariance": (("time", "point", "pixel_a", "pixel_b"), covariance, {"units": "px2"}),
        "correlation": (("time", "point"), correlation, {"units": "1"}),
        "status": (("time", "point"), status.astype(np.int8)),
    }
    return xr.Dataset(variables, coords={"time": ("time", time_s, {"units": "s"})})


class _TemplateSet:
    """Targets of one reference frame, located in other frames."""

    def __init__(self, tracker: TemplateTracker, reference: LumaArray, points: FloatArray, executor: Executor) -> None:
        self._tracker, self._executor = tracker, executor
        self._bank = SubsetBank.prepare(reference, points, subset_px=tracker.subset_px)
        half = tracker.subset_px // 2
        self._rows = np.flatnonzero(self._bank.usable)
        self._cuts = {int(p): cut_subset(reference, self._bank.centers[p], half) for p in self._rows}

    def locate(self, luma: LumaArray) -> _Located:
        """Positions, covariances, correlations and status codes of the targets in a frame.

        Parameters
        ----------
        luma
            The frame, shape (H, W).

        Returns
        -------
        position, covariance, correlation, status
            Shapes (P, 2) [px], (P, 2, 2) [px2], (P,) [1] and (P,).
        """
        tracker, bank = self._tracker, self._bank

        def search(p: int) -> FloatArray:
            place, radius_px = bank.centers[p], tracker.roi_margin_px
            return correlation_peaks(self._cuts[p], luma, place, radius_px=radius_px, count=_PEAKS)

        found = list(self._executor.map(search, self._rows.tolist()))
        owners = np.repeat(self._rows, [len(c) for c in found])
        centers = np.concatenate([np.empty((0, 2)), *found])
        warps = np.concatenate([centers, np.tile([1.0, 0.0, 0.0, 1.0], (len(owners), 1))], axis=1)
        raw = bank.run_on_grid(luma, owners, warps, divisions=DIVISIONS, executor=self._executor)
        refined = bank.interpret(raw)

        count = len(bank)
        position, covariance = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        correlation = np.full(count, np.nan)
        status = np.where(bank.inside, Status.LOST, Status.OUTSIDE)
        for p in self._rows:
            mine = np.flatnonzero(owners == p)
            status[p] = self._judge(int(p), luma, centers[mine], raw.warps[mine, :2], raw.correlation[mine])
            if status[p] in (Status.OK, Status.UNRELIABLE):
                k = mine[raw.correlation[mine].argmax()]
                position[p], correlation[p] = refined.position[k], raw.correlation[k]
                covariance[p] = refined.covariance[k] + np.eye(2) / (12 * DIVISIONS**2)
        return position, covariance, correlation, status

    def _judge(self, p: int, luma: LumaArray, peaks: FloatArray, places: FloatArray, correlation: FloatArray) -> int:
        """Status of one target from the places that were tried."""
        tracker = self._tracker
        best = correlation.max(initial=-1.0)
        if not best >= tracker.minimum_correlation:
            return Status.LOST
        winner = int(correlation.argmax())
        half = tracker.subset_px // 2
        limit = np.array(luma.shape[::-1]) - 1 - half
        if (peaks[winner] <= half).any() or (peaks[winner] >= limit).any():
            return Status.OUTSIDE
        at_margin = np.abs(peaks[winner] - self._bank.centers[p]).max() >= tracker.roi_margin_px
        if at_margin or has_rival(correlation, places, winner):
            return Status.LOST
        return Status.OK if best >= tracker.reliable_correlation else Status.UNRELIABLE
