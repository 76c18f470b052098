"""What a tracker is, and how one is found by name; `vfm_sdm.core.parts` lists them."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.registry import find, make
from vfm_sdm.inputs.session import Method
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.registration.designs import SubsetDesign

__all__ = ["DesignedTracker", "Tracker", "find_tracker", "tracker_of"]


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
