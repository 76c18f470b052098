"""All views on the clock of the reference view, by what the session states and by the motion that they see."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import ClockStatus, ClockUse
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.session import Session, View
from vfm_sdm.stages.synchronize.alignment import align_views
from vfm_sdm.stages.synchronize.dataset_lags import synchronize_views
from vfm_sdm.stages.synchronize.lag import Synchronization

__all__ = ["synchronize_tracks"]

_SEARCH_S = 3.0
"""Largest difference between the stated and the true offset of a view [s]."""
_OF_ONE_VIEW = ("half_difference", "half_covariance", "reference", "reference_covariance", "reference_frame", "grid")
"""What is left behind: halves of subsets, which are a third of long tracks and which nobody compares on a common clock;
reference frames, whose numbers are each view's own; and names of grids, which points have in every view alike."""


def synchronize_tracks(session: Session, tracks: Mapping[str, xr.Dataset], rig: Rig | None = None) -> xr.Dataset:
    """Tracks of all views on the reference view's clock, with the offset and rate of each view's own clock.

    The offset is estimated from the moving points where the session asks for it; where their motion does not determine
    it, the stated offset is used and the status says why.

    Parameters
    ----------
    session
        Views with their stated offsets, points, and ``method.synchronization``.
    tracks
        Tracks by view, each on its own clock.
    rig
        The cameras, where they are known: what moves across the epipolar lines is then compared.

    Returns
    -------
    aligned
        Tracks with a dim ``view``, and on it ``clock_offset`` [s] (the applied one: time between the first frames of
        the reference view and of this view), ``clock_offset_std`` [s] (NaN where neither motion nor session give the
        offset), ``clock_rate`` [1] and ``clock_status``; ``clock_use`` (view, point), a `ClockUse` for every point;
        and ``bits_per_pixel`` [1] of the view's recording, infinite
        where it is not compressed or not known. Where the session states when the reference view began, the attribute
        ``time_coverage_start`` says when time is zero.

    Raises
    ------
    DatasetError
        The recordings do not overlap.
    """
    stated = {view.name: session.begins_s(view) for view in session.view}
    tracks = {name: of_view.drop_vars(_OF_ONE_VIEW, errors="ignore") for name, of_view in tracks.items()}
    found: dict[str, Synchronization] = {}
    moving = [p.name for p in session.point if not p.static]
    if session.method.synchronization == "motion" and moving:
        for view in session.view:
            pair = {session.reference_view.name: tracks[session.reference_view.name], view.name: tracks[view.name]}
            one = synchronize_views(
                pair,
                start_offsets_s=stated,
                start_std_s=view.time_offset_std_s,
                points=moving,
                search_s=_SEARCH_S,
                rig=rig,
            )
            found[view.name] = one[view.name]
    known = {name: one for name, one in found.items() if one.ok}
    offsets = {name: known[name].offset_s if name in known else offset for name, offset in stated.items()}
    rates = {name: known[name].rate_ratio if name in known else 1.0 for name in stated}
    aligned = align_views(tracks, offsets, rates).assign_attrs(session.start_attrs)
    stds = [_offset_std(session, view, found.get(view.name)) for view in session.view]
    statuses = [found[v.name].status if v.name in found else ClockStatus.STATED for v in session.view]
    return aligned.assign(
        clock_offset=("view", list(offsets.values()), {"units": "s"}),
        clock_offset_std=("view", stds, {"units": "s"}),
        clock_rate=("view", list(rates.values()), {"units": "1"}),
        clock_status=("view", np.array([str(status) for status in statuses], dtype=object)),
        clock_use=(("view", "point"), _list_uses(aligned, found, moving)),
        bits_per_pixel=("view", [_bits_per_pixel(tracks[name]) for name in stated], {"units": "1"}),
    )


def _offset_std(session: Session, view: View, found: Synchronization | None) -> float:
    """Standard deviation of a view's offset [s]: of the motion's, else as stated; NaN where nobody knows the offset."""
    if found is not None and found.status == ClockStatus.OK:
        return found.lag_std_s
    if found is not None and session.stated_offset_s(view) is None:
        return float("nan")
    return view.time_offset_std_s or 0.0


def _list_uses(aligned: xr.Dataset, found: Mapping[str, Synchronization], moving: list[str]) -> np.ndarray:
    """What became of every point in every view, shape (V, P)."""
    rows = []
    for view in aligned["view"].values.tolist():
        uses = found[view].uses if view in found else ()
        by_name = dict(zip(moving, uses, strict=True)) if uses else {}
        rows.append([str(by_name.get(name, ClockUse.NOT_ASKED)) for name in aligned["point"].values.tolist()])
    return np.array(rows, dtype=object)


def _bits_per_pixel(tracks: xr.Dataset) -> float:
    """Size of a recording over its pixels [1]; infinite where it is not known."""
    found = float(tracks.attrs.get("recording", {}).get("bits_per_pixel", np.inf))
    return found if np.isfinite(found) else float("inf")
