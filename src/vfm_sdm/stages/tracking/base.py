"""What a tracker is, and how one is found by name."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.registry import Backend, find_backend
from vfm_sdm.inputs.session import Method
from vfm_sdm.inputs.video import Video

__all__ = ["TRACKERS", "Tracker", "find_tracker", "tracker_of"]


_HYBRID = ("vfm_sdm.stages.tracking.hybrid", "HybridTracker", ("subset_px", "network"))

TRACKERS = {
    "icgn": Backend("vfm_sdm.stages.tracking.icgn", "IcgnTracker", ("subset_px",)),
    "template": Backend("vfm_sdm.stages.tracking.template", "TemplateTracker", ("subset_px",)),
    "vggt": Backend("vfm_sdm.stages.tracking.vggt", "VggtTracker", ("network",)),
    "tapir": Backend("vfm_sdm.stages.tracking.tapir", "TapirTracker", ("network",)),
    "vggt+icgn": Backend(*_HYBRID, {"follower": "vggt"}),
    "tapir+icgn": Backend(*_HYBRID, {"follower": "tapir"}),
}
"""Every tracker by its name."""


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
        progress: Callable[[int], None] | None = None,
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
            Called with the number of frames done so far.
        """
        ...


def tracker_of(method: Method) -> Tracker:
    """The tracker that a session asks for, with the session's settings.

    Raises
    ------
    BackendUnavailableError
        No tracker has this name, or it cannot run here.
    """
    tracker: Tracker = find_backend(TRACKERS, "tracker", method.tracker).make_for(method)
    return tracker


def find_tracker(name: str, **options: Any) -> Tracker:
    """The tracker of this name, made with the given options.

    Raises
    ------
    BackendUnavailableError
        No tracker has this name, or it cannot run here.
    """
    tracker: Tracker = find_backend(TRACKERS, "tracker", name).make(**options)
    return tracker
