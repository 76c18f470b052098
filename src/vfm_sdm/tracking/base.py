"""What a tracker is, and how one is found by name."""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Protocol

import xarray as xr

from vfm_sdm.arrays import FloatArray
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.video import Video

__all__ = ["TRACKERS", "Tracker", "find_tracker"]

TRACKERS = {
    "icgn": ("vfm_sdm.tracking.icgn", "IcgnTracker"),
    "template": ("vfm_sdm.tracking.template", "TemplateTracker"),
}
"""Module and class of each tracker; imported only when asked for."""


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
        """Tracks dataset of the view (see `vfm_sdm.datasets`), every frame registered to the reference frame.

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


def find_tracker(name: str, **options: Any) -> Tracker:
    """The tracker of this name.

    Raises
    ------
    BackendUnavailableError
        No tracker has this name.
    """
    if name not in TRACKERS:
        raise BackendUnavailableError(f"tracker: expected one of {sorted(TRACKERS)}, got {name!r}; choose one of these")
    module, attribute = TRACKERS[name]
    tracker: Tracker = getattr(import_module(module), attribute)(**options)
    return tracker
