"""One clock for all views: tracks of every view brought to the time stamps of the reference view."""

from collections.abc import Mapping

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline, interp1d

from vfm_sdm.arrays import FloatArray, IntArray
from vfm_sdm.datasets import Status, check_tracks
from vfm_sdm.errors import DatasetError

__all__ = ["align_views"]

_SAME_CLOCK = 1e-3
"""Share of a frame interval below which two clocks count as one."""


def align_views(tracks_by_view: Mapping[str, xr.Dataset], offsets_s: Mapping[str, float] | None = None) -> xr.Dataset:
    """Tracks of all views on the clock of the first, which is the reference.

    Parameters
    ----------
    tracks_by_view
        One tracks dataset a view, with the same points in the same order.
    offsets_s
        Seconds by which a view's first frame happens later than the reference view's first frame.

    Returns
    -------
    tracks
        With leading dim ``view``; only the time that all views share. Attribute ``resampled`` names the views whose
        positions were interpolated.

    Raises
    ------
    DatasetError
        Points differ, or the recordings do not overlap by at least two frames.

    Notes
    -----
    Views whose stamps agree to a thousandth of a frame interval are taken as they are. Otherwise positions are
    interpolated by a cubic spline over runs of valid samples, which keeps the amplitude of motion well below the
    Nyquist frequency; a sample next to a gap becomes NaN (lost) instead of being extrapolated.
    """
    names = list(tracks_by_view)
    reference = check_tracks(tracks_by_view[names[0]])
    points = list(reference["point"].values)
    clocks = {}
    for name, tracks in tracks_by_view.items():
        if list(check_tracks(tracks)["point"].values) != points:
            raise DatasetError(f"view {name!r}: expected points {points}, got {list(tracks['point'].values)}; retrack")
        clocks[name] = tracks["time"].values + (offsets_s or {}).get(name, 0.0)
    start = max(clock[0] for clock in clocks.values())
    stop = min(clock[-1] for clock in clocks.values())
    clock = clocks[names[0]]
    interval = float(np.median(np.diff(clock))) if clock.size > 1 else 1.0
    slack = _SAME_CLOCK * interval
    clock = clock[(clock >= start - slack) & (clock <= stop + slack)]
    if clock.size < 2:
        raise DatasetError(
            f"views {names}: expected recordings that overlap, got {clock.size} common frames; check time_offset_s"
        )
    aligned, resampled = [], []
    for name, tracks in tracks_by_view.items():
        part, changed = _on_clock(tracks, clocks[name], clock, slack)
        aligned.append(part)
        resampled += [name] if changed else []
    combined = xr.concat(aligned, dim="view", join="exact", combine_attrs="drop_conflicts")
    combined = combined.assign_coords(view=names).transpose("view", ...)
    combined.attrs["resampled"] = ", ".join(resampled)
    return check_tracks(combined, synchronized=True)


def _on_clock(tracks: xr.Dataset, have: FloatArray, want: FloatArray, slack: float) -> tuple[xr.Dataset, bool]:
    """The tracks at the wanted times, and whether that took interpolation."""
    nearest = np.clip(np.searchsorted(have, want - slack), 0, have.size - 1)
    if np.all(np.abs(have[nearest] - want) <= slack):
        return tracks.isel(time=nearest).assign_coords(time=("time", want, {"units": "s"})), False
    position = np.full((want.size, tracks.sizes["point"], 2), np.nan)
    for index in range(tracks.sizes["point"]):
        position[:, index] = _interpolate_runs(have, tracks["position"].values[:, index], want)
    before = np.clip(np.searchsorted(have, want, side="right") - 1, 0, have.size - 2)
    status = _worse(tracks["status"].values[before], tracks["status"].values[before + 1])
    status = np.where(np.isnan(position).any(axis=-1) & (status == Status.OK), Status.LOST, status)
    covariance = interp1d(have, tracks["position_covariance"].values, axis=0, bounds_error=False)(want)
    moved = tracks.isel(time=np.zeros(want.size, dtype=int)).assign_coords(time=("time", want, {"units": "s"}))
    moved = moved[["position", "position_covariance", "status"]]
    moved["position"] = moved["position"].copy(data=position)
    moved["position_covariance"] = moved["position_covariance"].copy(data=covariance)
    moved["status"] = moved["status"].copy(data=status.astype(np.int8))
    return moved, True


def _interpolate_runs(have: FloatArray, values: FloatArray, want: FloatArray) -> FloatArray:
    """Cubic interpolation of every unbroken run of valid samples, NaN between the runs; (T, 2) to (T', 2)."""
    result = np.full((want.size, 2), np.nan)
    valid = np.isfinite(values).all(axis=-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first < 2:
            continue
        inside = (want >= have[first]) & (want <= have[last - 1])
        result[inside] = CubicSpline(have[first:last], values[first:last])(want[inside])
    return result


def _worse(first: IntArray, second: IntArray) -> IntArray:
    """The status that says more against a sample: missing before unreliable before ok."""
    severity = np.array([0, 2, 3, 1])
    return np.where(severity[first] >= severity[second], first, second)
