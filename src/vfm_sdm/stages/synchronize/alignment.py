"""One clock for all views: tracks of every view brought to the time stamps of the reference view."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status, check_tracks, worst_status
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.resampling import interpolate_runs

__all__ = ["align_views"]

_SAME_CLOCK = 1e-3
"""Share of a frame interval below which two clocks count as one."""
_LARGEST_RATE_ERROR = 0.01
"""Clocks are never this far apart; a wrong frame rate is."""


def align_views(
    tracks_by_view: Mapping[str, xr.Dataset],
    offsets_s: Mapping[str, float] | None = None,
    rate_ratios: Mapping[str, float] | None = None,
) -> xr.Dataset:
    """Tracks of all views on the clock of the first, which is the reference.

    Parameters
    ----------
    tracks_by_view
        One tracks dataset of every view, shape (T, P, 2) [px], with the same points in the same order.
    offsets_s
        Seconds by which a view's first frame happens later than the reference view's first frame; of an estimate:
        `Synchronization.offset_s`. This is the opposite sign of a lag: an event shows up earlier in a late recording.
    rate_ratios
        Seconds of the reference clock a second of a view's own clock (`Synchronization.rate_ratio`): an own stamp t
        is ``t * rate_ratio + offset`` on the reference clock. Above 1 the view's clock is slow.

    Returns
    -------
    tracks
        Tracks with the leading dim ``view``, shape (V, T', P, 2) [px]; only the time that all views share. Attribute
        ``resampled`` names the views whose positions were interpolated.

    Raises
    ------
    DatasetError
        Points differ, a ratio is not near 1, or the recordings do not overlap by at least two frames.

    Notes
    -----
    Views whose stamps agree to a thousandth of a frame interval are taken as they are. Otherwise positions are
    interpolated by splines over runs of valid samples, which keep amplitudes to 0.05 % up to 0.4 of the Nyquist
    frequency (`interpolate_runs`); a sample next to a gap becomes NaN (lost) instead of being extrapolated. The
    covariances are interpolated too, as if that averaged no noise: errors of compression are not white in time.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> def tracks(start_s):
    ...     time_s = start_s + np.arange(90) / 30
    ...     position = np.sin(2 * np.pi * time_s)[:, None, None] * np.ones(2)
    ...     covariance = np.tile(np.eye(2), (90, 1, 1, 1))
    ...     return make_tracks(time_s - start_s, ["a"], position, covariance, np.zeros((90, 1)), attrs={})
    >>> aligned = align_views({"left": tracks(0.0), "right": tracks(0.5)}, {"right": 0.5})
    >>> apart = aligned["position"].sel(view="right") - aligned["position"].sel(view="left")
    >>> aligned.sizes["time"], bool(abs(apart).max() < 1e-3)
    (75, True)
    """
    names = list(tracks_by_view)
    reference = check_tracks(tracks_by_view[names[0]])
    points = list(reference["point"].values)
    clocks = {}
    for name, tracks in tracks_by_view.items():
        if list(check_tracks(tracks)["point"].values) != points:
            raise DatasetError(f"view {name!r}: expected points {points}, got {list(tracks['point'].values)}; retrack")
        ratio = (rate_ratios or {}).get(name, 1.0)
        if not abs(ratio - 1) < _LARGEST_RATE_ERROR:
            raise DatasetError(
                f"view {name!r}: expected a rate ratio near 1, got {ratio}; correct the frame rate instead"
            )
        clocks[name] = tracks["time"].values * ratio + (offsets_s or {}).get(name, 0.0)
    start = max(clock[0] for clock in clocks.values())
    stop = min(clock[-1] for clock in clocks.values())
    clock = clocks[names[0]]
    interval = float(np.median(np.diff(clock))) if clock.size > 1 else 1.0
    slack = _SAME_CLOCK * interval
    clock = clock[(clock >= start - slack) & (clock <= stop + slack)]
    if clock.size < 2:
        advice = _advise(tracks_by_view)
        raise DatasetError(f"views {names}: expected recordings that overlap, got {clock.size} common frames; {advice}")
    aligned, resampled = [], []
    for name, tracks in tracks_by_view.items():
        part, changed = _move_to_clock(tracks, clocks[name], clock, slack)
        aligned.append(part)
        resampled += [name] if changed else []
    combined = xr.concat(aligned, dim="view", join="exact", combine_attrs="drop_conflicts")
    combined = combined.assign_coords(view=names).transpose("view", ...)
    combined.attrs["resampled"] = ", ".join(resampled)
    return check_tracks(combined, synchronized=True)


def _advise(tracks_by_view: Mapping[str, xr.Dataset]) -> str:
    """What to do where recordings have no time in common."""
    for name, tracks in tracks_by_view.items():
        status = tracks.attrs.get("recording", {}).get("status", RecordingStatus.OK)
        if status != RecordingStatus.OK:
            found = f"the recording of {name!r} is damaged ({status}), {tracks.sizes['time']} of its frames were read"
            return f"{found}: copy it from the camera again"
    return "check time_offset_s"


def _move_to_clock(tracks: xr.Dataset, have: FloatArray, want: FloatArray, slack: float) -> tuple[xr.Dataset, bool]:
    """The tracks at the wanted times, and whether that took interpolation."""
    nearest = np.clip(np.searchsorted(have, want - slack), 0, have.size - 1)
    if np.all(np.abs(have[nearest] - want) <= slack):
        return tracks.isel(time=nearest).assign_coords(time=("time", want, {"units": "s"})), False
    position = np.full((want.size, tracks.sizes["point"], 2), np.nan)
    covariance = np.full((want.size, tracks.sizes["point"], 2, 2), np.nan)
    for index in range(tracks.sizes["point"]):
        position[:, index] = interpolate_runs(have, tracks["position"].values[:, index], want)
        flat = tracks["position_covariance"].values[:, index].reshape(-1, 4)
        covariance[:, index] = interpolate_runs(have, flat, want, degree=1).reshape(-1, 2, 2)
    before = np.clip(np.searchsorted(have, want, side="right") - 1, 0, have.size - 2)
    status = worst_status([tracks["status"].values[before], tracks["status"].values[before + 1]])
    status = np.where(np.isnan(position).any(axis=-1) & (status == Status.OK), Status.LOST, status)
    # What else is known of each sample is that of the nearest one.
    closest = np.where(want - have[before] <= have[before + 1] - want, before, before + 1)
    moved = tracks.isel(time=closest).assign_coords(time=("time", want, {"units": "s"}))
    moved["position"] = moved["position"].copy(data=position)
    moved["position_covariance"] = moved["position_covariance"].copy(data=covariance)
    moved["status"] = moved["status"].copy(data=status.astype(np.int8))
    return moved, True
