"""A long recording in intervals, each of which is measured and judged by itself."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.inputs.session import Session
from vfm_sdm.signals.clocks import still_frames
from vfm_sdm.stages.intervals.carried import Carried

__all__ = ["Interval", "divide_tracks"]

_MARGIN_S = 5.0
"""Time of the other views beyond an interval, so that they cover it wherever their clocks are found to be [s]."""
_FEWEST = 2
"""Frames of every view that an interval needs."""


@dataclass(frozen=True)
class Interval:
    """Part of a recording behind tracking.

    Parameters
    ----------
    begin_s, end_s
        Time on the reference view's clock; the end belongs to the next interval [s].
    """

    begin_s: float
    end_s: float

    def holds(self, time_s: float) -> bool:
        """Whether a time [s] lies in this interval."""
        return self.begin_s <= time_s < self.end_s

    def session(self, session: Session, carried: Carried) -> Session:
        """The session of this interval alone, whose time begins with it.

        Parameters
        ----------
        session
            The session of the whole recording.
        carried
            What is known from other intervals: the clocks, and whether the origin of displacement.
        """
        views = []
        for view in session.view:
            offset_s, std_s = carried.clock(session, view, self.begin_s)
            changed = {"start": None, "time_offset_s": offset_s, "time_offset_std_s": std_s}
            views.append(view.model_copy(update=changed))
        still = session.method.still_interval_s
        # The mean of a still interval is the origin of all; what other intervals measure is relative to that.
        inside = still is not None and self.holds(still[0]) and not carried.origin
        moved = (still[0] - self.begin_s, still[1] - self.begin_s) if still is not None and inside else None
        method = session.method.model_copy(update={"still_interval_s": moved})
        return session.model_copy(update={"view": tuple(views), "method": method})

    def cut(self, tracks: Mapping[str, xr.Dataset], session: Session, carried: Carried) -> dict[str, xr.Dataset] | None:
        """Tracks of this interval, whose time begins with it; ``None`` where a view has next to no frames in it.

        Parameters
        ----------
        tracks
            Tracks by view, shape (T, P, 2) [px], each on its own clock, the reference view's first.
        session, carried
            As of `session`.
        """
        parts: dict[str, xr.Dataset] = {}
        for view in session.view:
            time_s = tracks[view.name]["time"].values
            first, last = self.begin_s, self.end_s
            if view.name != session.reference_view.name:
                offset_s, _ = carried.clock(session, view, self.begin_s)
                later = offset_s or 0.0
                first, last = first - later - _MARGIN_S, last - later + _MARGIN_S
            chosen = np.flatnonzero((time_s >= first) & (time_s < last))
            within = np.count_nonzero((time_s[chosen] >= first + _MARGIN_S) & (time_s[chosen] < last - _MARGIN_S))
            if len(chosen) < _FEWEST or (parts and within < _FEWEST):
                return None
            part = tracks[view.name].isel(time=slice(int(chosen[0]), int(chosen[-1]) + 1)).load()
            parts[view.name] = part.assign_coords(time=("time", part["time"].values - self.begin_s, part["time"].attrs))
        return parts


def divide_tracks(tracks: xr.Dataset, session: Session) -> list[Interval]:
    """Intervals of about ``method.interval_s``, one after the other.

    Parameters
    ----------
    tracks
        Tracks of the reference view, shape (T, P, 2) [px].
    session
        ``method.interval_s``, and ``method.still_interval_s``, which lies in a single interval.

    Raises
    ------
    DatasetError
        No frame lies in the still interval.

    Examples
    --------
    >>> from vfm_sdm.inputs.session import Method
    >>> session = Session.model_construct(method=Method(interval_s=600.0))
    >>> tracks = xr.Dataset(coords={"time": np.arange(0.0, 1810.0, 10.0)})
    >>> [(round(one.begin_s), round(one.end_s)) for one in divide_tracks(tracks, session)]
    [(0, 600), (600, 1200), (1200, 1800)]
    """
    time_s = tracks["time"].values
    still = session.method.still_interval_s
    if still is not None:
        still_frames(time_s, still)
    edges = _find_edges(time_s, session.method.interval_s, still)
    return [Interval(begin, end) for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)]


def _find_edges(time_s: FloatArray, length_s: float, still_s: tuple[float, float] | None) -> FloatArray:
    """Beginnings of the intervals and the end of the last [s]."""
    count = max(1, round((time_s[-1] - time_s[0]) / length_s))
    edges = time_s[0] + length_s * np.arange(1.0, count)
    if still_s is not None:
        # None begins in the still interval.
        edges = np.unique(np.where((edges > still_s[0]) & (edges <= still_s[1]), still_s[0], edges))
    end = np.nextafter(time_s[-1], np.inf)
    return np.concatenate([time_s[:1], edges[(edges > time_s[0]) & (edges < end)], [end]])
