"""Hybrid trackers: a network follows the points, and subset registration measures them to a fraction of a pixel."""

from collections.abc import Sequence
from copy import copy

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.session import Network
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.base import SegmentTracker, Targets, find_tracker, track_whole
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.inputs import check_counts, check_points
from vfm_sdm.stages.tracking.looks import Look
from vfm_sdm.stages.tracking.network import NetworkTracker
from vfm_sdm.stages.tracking.standings import Standing
from vfm_sdm.stages.tracking.undivided import InOnePiece

__all__ = ["HybridTracker"]


class HybridTracker:
    """Trackers ``vggt+icgn`` and ``tapir+icgn``.

    Parameters
    ----------
    follower
        Name of the tracker that follows the points first.
    subset_px
        Side of the registered subsets, odd [px].
    network
        Settings of the follower.
    agreement_px
        Distance of the two positions above which a sample is unreliable [px].

    Raises
    ------
    BackendUnavailableError
        The follower cannot run here.
    SessionError
        A setting is out of its range.

    Notes
    -----
    The registration of every frame starts where the network saw the point or, if the network saw nothing, where the
    point was last. Positions and covariances are those of the registration. Where both disagree, they are not averaged:
    ``disagreement``, shape (T, P) [px], is their distance; beyond ``agreement_px``, or where only the registration
    found the point, the status is ``unreliable``.
    """

    compares_designed_subsets = True

    def __init__(
        self, *, follower: str, subset_px: int = 41, network: Network | None = None, agreement_px: float = 1.0
    ) -> None:
        self.name = f"{follower}+icgn"
        check_counts(self.name, agreement_px=agreement_px)
        found = find_tracker(follower, network=network)
        self.follower = found if isinstance(found, SegmentTracker) else InOnePiece(found)
        self.in_one_piece = self.follower.in_one_piece
        self.registration_tracker = IcgnTracker(subset_px=subset_px)
        self.agreement_px = agreement_px

    @property
    def weights_id(self) -> str:
        """Identity of the follower's weights."""
        return str(getattr(self.follower, "weights_id", ""))

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
        """Tracks of named points.

        Parameters
        ----------
        video
            The view. It is read twice.
        points2d
            Positions in the reference frame, shape (P, 2) [px], full-image pixels.
        names
            Point names, length P.
        reference_frame
            Index of the frame in which ``points2d`` are given.
        progress
            Called with ``tracking``, the number of frames done so far and that of all.
        designs
            Size, warp and mask of each point's subset; ``None`` for a point that is not to be tracked.

        Returns
        -------
        tracks
            Tracks (see `vfm_sdm.core.datasets`), shape (T, P, 2) [px], with ``disagreement``, shape (T, P) [px].

        Raises
        ------
        DatasetError
            Points lie outside the image, names are not distinct, or there is no such reference frame.
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
        """Registrations of a segment, and where the network saw the points (``expected``, [px]).

        Parameters
        ----------
        video, reference, targets, start, progress
            As of `vfm_sdm.stages.tracking.base.SegmentTracker`.
        """
        followed = self.follower.follow(video, reference, targets, progress=_in_halves(progress, 0))
        expected = followed["position"].values
        registered = self.registration_tracker.starting_from(expected).follow(
            video, reference, targets, start=start, progress=_in_halves(progress, len(expected))
        )
        kept = {name: followed.attrs[name] for name in ("precision",) if name in followed.attrs}
        return registered.assign(expected=followed["position"]).assign_attrs(kept)

    def find_starts(
        self, looks: Sequence[Look], reference: LumaArray, targets: Targets
    ) -> Sequence[Sequence[Standing]]:
        """Where the registration begins; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        looks, reference, targets
            As there.
        """
        return self.registration_tracker.find_starts(looks, reference, targets)

    def on_one_thread(self) -> "HybridTracker":
        """The same tracker for one of several processes that share the processors."""
        tracker = copy(self)
        tracker.registration_tracker = self.registration_tracker.on_one_thread()
        return tracker

    def judge(self, record: xr.Dataset, targets: Targets, info: VideoInfo) -> xr.Dataset:
        """Tracks of registrations and network; see `vfm_sdm.stages.tracking.base.SegmentTracker`.

        Parameters
        ----------
        record, targets, info
            As there.
        """
        tracks = self.registration_tracker.judge(record, targets, info)
        apart = tracks["position"].values - record["expected"].values
        disagreement = np.linalg.norm(apart, axis=2)
        if "edge_across" in tracks:  # along an edge, the registration says nothing to disagree with
            across = tracks["edge_across"].values
            edge = np.isfinite(across).all(axis=1)
            disagreement[:, edge] = np.abs(np.einsum("tpi,pi->tp", apart[:, edge], across[edge]))
        status = tracks["status"]
        doubtful = (status.values == Status.OK) & ~(disagreement <= self.agreement_px)
        tracks["status"] = status.copy(data=np.where(doubtful, np.int8(Status.UNRELIABLE), status.values))
        attrs = (
            {"preset": self.follower.preset.name, "weights": self.weights_id}
            if isinstance(self.follower, NetworkTracker)
            else {}
        )
        return tracks.assign(disagreement=(("time", "point"), disagreement, {"units": "px"})).assign_attrs(
            tracker=self.name, **attrs, **record.attrs
        )


def _in_halves(progress: Progress | None, before: int) -> Progress | None:
    """Progress in which a frame counts half, after some were done in an earlier pass."""
    if progress is None:
        return None
    return lambda what, done, total: progress(what, (before + done + 1) // 2, total)
