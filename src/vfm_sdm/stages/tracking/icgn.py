"""Sub-pixel tracking by inverse-compositional Gauss-Newton registration of subsets to the reference frame."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.core.covariances import judged_std, measured_axes
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.threads import thread_pool
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.registration.subsets import RawRegistration, SubsetBank, SubsetDesign, check_subset_px
from vfm_sdm.stages.tracking.base import Targets, track_whole
from vfm_sdm.stages.tracking.follow import Follower, FollowSettings, FollowState
from vfm_sdm.stages.tracking.inputs import check_correlations, check_counts, check_points, follow_frames
from vfm_sdm.stages.tracking.looks import Look, take_look
from vfm_sdm.stages.tracking.references import References
from vfm_sdm.stages.tracking.split_subset import SplitSubsets, judge_halves
from vfm_sdm.stages.tracking.standings import Standing, join_points
from vfm_sdm.stages.tracking.subset_parts import SubsetParts, judge_parts

__all__ = ["IcgnTracker"]

_CHUNK = 256  # frames whose covariances are computed at one time
_COVERED = 3.0
"""Times its usual share of a subset's energy that is left unexplained when something else covers part of it: noise of
thousands of pixels varies by some percent, interpolation between pixels and at them by a factor of up to 2.5."""
_BESIDE = 2.0
_LEAST_COVERED = 0.02
"""Share of the energy below which what is left is no cover."""
_LIGHT_S = 30.0
"""Time over which light that renews references leaves more and more unexplained, and what passes is gone again [s]."""


class IcgnTracker:
    """Follows points by registering the subset around each to every frame (IC-GN, ZNSSD; by default an affine warp).

    Parameters
    ----------
    subset_px
        Side of the subset, odd [px].
    settings
        Limits that decide between following, searching and giving up.
    max_std_px
        Above this stated standard deviation, in its worst direction, a point is unreliable [px]; across its edge where
        it is designed as one.
    threads
        Threads that share the points; all processors by default.

    Attributes
    ----------
    expected
        Where another tracker saw the points, see `starting_from`.
    with_parts
        Whether parts of the subsets are followed beside them, see `of_whole_subsets`.

    Raises
    ------
    SessionError
        A setting is out of its range.

    Notes
    -----
    **Registration.** The current image is interpolated by a quintic B-spline, from coefficients of a small region
    around each subset only. Quintic, because the bias of a cubic spline at a quarter pixel is 0.003 px for textures
    with frequencies up to 0.3 cycles a pixel and 0.010 px up to 0.4; here it is 0.0003 and 0.002 px. The reference is
    sampled at its pixels: its gradients are those of the same spline, low-pass filtered near half the sampling
    frequency (`vfm_sdm.stages.registration.reference_subsets.SMOOTHING`), and the matrix M of the normal equations is
    computed once. Gain and bias drop out (ZNSSD). Sampling and sums are in single precision (bias below 1e-5 px), the
    rest in double.

    **Covariance.** With S the steepest-descent images, a step is M^-1 S e / g, with e the difference of two noises and
    g the gain. The residual sum of squares R of the n pixels estimates the noise of one frame,
    s2 = R / ((n - 8) (k + g2)): the interpolated frame shows only the share k of its noise in R (k is computed for the
    fraction of a pixel), but all of it at the low frequencies that S weighs, so that the covariance of a parameter is
    s2 (1 + g2) / g2 M^-1 S S' M^-T. Noise of the reference stands in M, too, and draws the gain towards zero; both
    shares are known from s2 and taken out, otherwise weak textures would look better than they are. The noise of the
    reference frame is common to all frames of a track: it is part of the covariance, but differences between frames
    do not contain it. In the reference frame itself the position is given and the covariance is zero.

    **Light.** Segments of long recordings have references of their own where light has changed, see
    `vfm_sdm.stages.tracking.references.References`; what is usual of a point is then that of the half minutes about a
    sample, where that is more.

    **Status.** ``lost``: neither following nor a search around the last good position ends in a minimum with at least
    ``minimum_correlation``; or the search finds several places that are equally good; or the gradients cannot be told
    from noise; or three times the point's usual share of the subset is left unexplained (two times beside such or lost
    frames), because something passes before a part of it. ``outside``: the subset left the image. ``unreliable``: see
    the parameters. A step of more than half
    the distance to a look-alike within the reference frame counts as ambiguous.

    References
    ----------
    .. [1] Pan, B., Li, K., Tong, W. (2013). Fast, robust and accurate digital image correlation calculation without
       redundant computations. Experimental Mechanics 53, 1277-1289.
    .. [2] Baker, S., Matthews, I. (2004). Lucas-Kanade 20 years on: a unifying framework. International Journal of
       Computer Vision 56, 221-255.
    """

    name = "icgn"
    in_one_piece = False
    at_once = True
    takes_later_points = True
    compares_designed_subsets = True

    def __init__(
        self,
        *,
        subset_px: int = 41,
        settings: FollowSettings | None = None,
        max_std_px: float = 0.1,
        threads: int | None = None,
    ) -> None:
        check_subset_px(subset_px, "subset_px")
        self.settings = settings or FollowSettings()
        check_counts(
            self.name,
            search_radius_px=self.settings.search_radius_px,
            max_iterations=self.settings.max_iterations,
            max_std_px=max_std_px,
            threads=threads,
        )
        check_correlations(self.name, self.settings.minimum_correlation, self.settings.reliable_correlation)
        self.subset_px = subset_px
        self.max_std_px = max_std_px
        self.threads = threads or os.cpu_count() or 1
        self.expected: FloatArray | None = None
        self.with_parts = True

    def starting_from(self, expected: FloatArray) -> "IcgnTracker":
        """The tracker with starts from another one that followed the same points through the same video.

        Parameters
        ----------
        expected
            Where that tracker saw the points, shape (T, P, 2) [px]: registrations start there, unless it is NaN.
        """
        tracker = copy(self)
        tracker.expected = expected
        return tracker

    def of_whole_subsets(self) -> "IcgnTracker":
        """The tracker whose tracks say nothing of parts of subsets, and are the same otherwise."""
        tracker = copy(self)
        tracker.with_parts = False
        return tracker

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
        """Tracks of named points, every frame registered to the reference frame.

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
        designs
            Size, warp and mask of each point's subset; ``None`` for a point that is not to be tracked. Without them,
            whole squares of ``subset_px`` with an affine warp.

        Returns
        -------
        xr.Dataset
            Tracks (see `vfm_sdm.core.datasets`) with ``correlation`` (time, point): ZNCC [1], and ``half_difference``
            (time, point, pixel): how far the right half of a subset moved beyond the left one [px], each tracked by
            itself, in every fourth frame, else NaN. With designs also ``half_covariance`` [px2] of
            that difference, ``subset_px``, ``warp``, ``shading``, ``edge_across`` and ``believed``, and ``part_noise``
            [px] and ``part_gain_std`` [1] (point, direction: u and v, or across an edge and along it), see
            `vfm_sdm.stages.tracking.subset_parts.SubsetParts`.

        Raises
        ------
        DatasetError
            Points lie outside the image, names are not distinct, there is not one design a point, or there is no such
            reference frame.
        """
        targets = Targets(check_points(points2d, names, video), tuple(names), designs)
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
        """Registrations of a segment; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        video, reference, targets, start, progress
            As there.
        """
        standings = start or targets.homes
        following: list[_Following] = []
        with thread_pool(self.threads) as executor:

            def begin(luma: LumaArray) -> Callable[[LumaArray], None]:
                following.extend(_Following(self, luma, targets, one, executor) for one in standings)
                return advance

            def advance(luma: LumaArray) -> None:
                for one in following:
                    one.advance(luma)

            time_s = follow_frames(video, reference, begin, progress)
            return join_points([one.record(time_s) for one in following], standings)

    def find_starts(
        self, looks: Sequence[Look], reference: LumaArray, targets: Targets
    ) -> Sequence[Sequence[Standing]]:
        """What the points are compared with, and where they are; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        looks, reference, targets
            As there.
        """
        with thread_pool(self.threads) as executor:
            found = [self._look_from(home, looks, reference, targets, executor) for home in targets.homes]
        return [[one for of_home in starts for one in of_home] for starts in zip(*found, strict=True)]

    def _look_from(
        self, home: Standing, looks: Sequence[Look], first: LumaArray, targets: Targets, executor: Executor
    ) -> list[list[Standing]]:
        """What the points of one frame are compared with at all looks: back from it, and forwards."""
        luma, own = home.luma(first), targets.of(home.rows, home.points)
        before = [look for look in looks if look.number <= home.number]
        found = [[replace(home, state=state)] for state in self._look_back(before, luma, own, executor)]
        references = References(self.prepare, self.settings, luma, own, executor, home)
        for look in looks[len(before) :]:
            found.append([replace(one, rows=home.rows[one.rows]) for one in references.look(look)])
        return found

    def _look_back(
        self, looks: Sequence[Look], luma: LumaArray, targets: Targets, executor: Executor
    ) -> list[FollowState | None]:
        """Where points are at looks before the frame in which they are named, of which the reference is not renewed."""
        if not looks:
            return []
        bank, radius_px = self.prepare(luma, targets, executor), self.settings.search_radius_px

        def make(state: FollowState | None, radius_px: int) -> Follower:
            settings = replace(self.settings, search_radius_px=radius_px)
            return Follower(bank, luma, settings, executor, state)

        states: list[FollowState | None] = []
        for look in reversed(looks):
            seen, later = look.luma(), states[-1] if states else None
            states.append(later if seen is None else take_look(look.backwards(), seen, later, make, radius_px))
        return states[::-1]

    def on_one_thread(self) -> "IcgnTracker":
        """The same tracker for one of several processes that share the processors."""
        tracker = copy(self)
        tracker.threads = 1
        return tracker

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """Tracks of registrations; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        record, targets, info
            As there.
        """
        names = ("position", "position_covariance", "correlation", "status")
        position, covariance, correlation, status = (record[name].values.copy() for name in names)
        # Reliability is judged here, where the covariances are known.
        found = (status == Status.OK) | (status == Status.UNRELIABLE)
        lost = np.asarray(found & ~np.isfinite(covariance).all(axis=(2, 3)))
        renewed = np.zeros(position.shape[1], np.bool_)
        if "reference" in record:  # not of live pictures, which have one
            renewed = np.any(record["reference"].values != targets.named_frames, axis=0)
        lost |= _find_covered(correlation, status, np.where(renewed[..., None], record["time"].values, np.nan))
        status[lost] = Status.LOST
        position[lost], covariance[lost], correlation[lost] = np.nan, np.nan, np.nan
        across = record["edge_across"].values
        doubtful = correlation < self.settings.reliable_correlation
        doubtful |= judged_std(covariance, across) > self.max_std_px
        status[doubtful & (status == Status.OK)] = Status.UNRELIABLE
        attrs = {
            "tracker": self.name,
            "source": info.source,
            "image_width": info.width,
            "image_height": info.height,
            "reference_frame": 0,
            "subset_px": self.subset_px,
        }
        tracks = make_tracks(record["time"].values, targets.names, position, covariance, status, attrs=attrs)
        tracks = tracks.assign(correlation=(("time", "point"), correlation, {"units": "1"}))
        if renewed.any() or targets.named:
            tracks = tracks.assign(reference=record["reference"])
        if "half_difference" not in record:
            return tracks
        if targets.designs is not None:
            described = _describe(targets.designs, record)
            halves = (("time", "point", "pixel_a", "pixel_b"), record["half_covariance"].values, {"units": "px2"})
            tracks = tracks.assign(described).assign(half_covariance=halves)
        return tracks.assign(half_difference=(("time", "point", "pixel"), judge_halves(record), {"units": "px"}))

    def prepare(self, reference: LumaArray, targets: Targets, executor: Executor) -> SubsetBank:
        """The targets' subsets in a reference frame.

        Parameters
        ----------
        reference
            The frame, shape (H, W).
        targets
            What is followed.
        executor
            Threads that share the work.
        """
        size, designs = self.subset_px, targets.designs
        return SubsetBank.prepare(reference, targets.points, subset_px=size, designs=designs, executor=executor)


def _find_covered(correlation: FloatArray, status: IntArray, time_s: FloatArray) -> BoolArray:
    """Samples (T, P) in which something covers a part of the subset, by what registration leaves unexplained.

    What is usual is that of all samples, but for points in light that changes: times (P, T) [s], else NaN.
    """
    left = np.where(status == Status.OK, 1 - correlation, np.nan)
    usual = np.full(left.shape, np.inf)
    for point, column in enumerate(left.T):
        known = np.isfinite(column)
        if known.any():
            usual[:, point] = np.median(column[known])
        if np.isfinite(time_s[point]).all() and known.any():
            usual[:, point] = np.maximum(usual[:, point], _usual_in_light(column, time_s[point]))
    left = np.nan_to_num(left)
    covered = left > np.maximum(_COVERED * usual, _LEAST_COVERED)
    # What comes before, or leaves, covers a little of the next frame as well.
    gone = covered | (status == Status.LOST)
    beside = np.zeros_like(gone)
    beside[1:], beside[:-1] = gone[:-1], beside[:-1] | gone[1:]
    return np.asarray(covered | (beside & (left > np.maximum(_BESIDE * usual, _LEAST_COVERED))))


def _usual_in_light(left: FloatArray, time_s: FloatArray) -> FloatArray:
    """What registration leaves in the middle of the samples about each, shape (T,) [1], of those known at times [s]."""
    known = np.flatnonzero(np.isfinite(left))
    stretches = np.split(known, np.flatnonzero(np.diff(time_s[known] // _LIGHT_S)) + 1)
    middle = [(np.median(time_s[some]), np.median(left[some])) for some in stretches]
    at, value = np.array(middle).T
    return np.asarray(np.interp(time_s, at, value))


class _Following:
    """Registrations of a standing's targets in the frames so far; covariances are computed many frames at a time."""

    def __init__(
        self,
        tracker: IcgnTracker,
        reference: LumaArray,
        targets: Targets,
        standing: Standing,
        executor: Executor,
    ) -> None:
        reference, self._before = standing.luma(reference), standing.before
        targets, self._rows = targets.of(standing.rows, standing.points), standing.rows
        self._advanced = 0
        self._bank = tracker.prepare(reference, targets, executor)
        self._follower = Follower(self._bank, reference, tracker.settings, executor, standing.state)
        self._beside: list[SplitSubsets | SubsetParts] = []
        if tracker.with_parts:
            self._beside.append(SplitSubsets(reference, self._bank, executor))
            if targets.designs is not None:
                self._beside.append(SubsetParts(reference, self._bank, executor, targets.segments))
        self._expected = iter(() if tracker.expected is None else tracker.expected)
        self._open: list[tuple[RawRegistration, IntArray]] = []
        self._closed: list[tuple[FloatArray, FloatArray, FloatArray, IntArray]] = []

    def advance(self, luma: LumaArray) -> None:
        """Takes the next frame.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        """
        if self._advanced == self._before:
            self._follower.return_home()
        self._advanced += 1
        expected = next(self._expected, None)
        found = self._follower.advance(luma, None if expected is None else expected[self._rows])
        self._open.append(found)
        if len(self._open) == _CHUNK:
            self._close()
        for one in self._beside:
            one.advance(luma, found[0])

    def record(self, time_s: FloatArray) -> xr.Dataset:
        """The record of all frames.

        Parameters
        ----------
        time_s
            When they were taken, shape (T,) [s].
        """
        if self._open or not self._closed:
            self._close()
        position, covariance, correlation, status = (np.concatenate(a) for a in zip(*self._closed, strict=True))
        variables: dict[str, Any] = {
            "position": (("time", "point", "pixel"), position, {"units": "px"}),
            "position_covariance": (("time", "point", "pixel_a", "pixel_b"), covariance, {"units": "px2"}),
            "correlation": (("time", "point"), correlation, {"units": "1"}),
            "status": (("time", "point"), status.astype(np.int8)),
            "edge_across": (("point", "pixel"), self._bank.edge_across, {"units": "1"}),
        }
        for one in self._beside:
            variables |= one.record()
        return xr.Dataset(variables, coords={"time": ("time", time_s, {"units": "s"})})

    def _close(self) -> None:
        frames, points = len(self._open), len(self._bank)
        if not frames:  # a segment of which nothing could be decoded
            empty = np.zeros((0, points))
            self._closed.append((np.zeros((0, points, 2)), np.zeros((0, points, 2, 2)), empty, empty.astype(np.int64)))
            return
        found = self._bank.interpret(RawRegistration.joined([raw for raw, _ in self._open]))
        position, correlation = found.position.reshape(frames, points, 2), found.correlation.reshape(frames, points)
        covariance = found.covariance.reshape(frames, points, 2, 2)
        self._closed.append((position, covariance, correlation, np.array([codes for _, codes in self._open])))
        self._open.clear()


def _describe(designs: Sequence[SubsetDesign | None], record: xr.Dataset) -> dict[str, Any]:
    """What the tracks say of the designs of P points, and of their parts."""
    across = record["edge_across"].values
    noise, gain_std = judge_parts(record, designs, measured_axes(across))
    believed = [0.0 if design is None else design.believed_px / design.subset_px**2 for design in designs]
    return {
        "subset_px": ("point", [0 if design is None else design.subset_px for design in designs], {"units": "px"}),
        "warp": ("point", np.array(["" if design is None else str(design.warp) for design in designs], dtype=object)),
        "shading": ("point", [0 if design is None else design.shading for design in designs]),
        "edge_across": (("point", "pixel"), across, {"units": "1"}),
        "believed": ("point", believed, {"units": "1"}),
        "part_noise": (("point", "direction"), noise, {"units": "px"}),
        "part_gain_std": (("point", "direction"), gain_std, {"units": "1"}),
    }
