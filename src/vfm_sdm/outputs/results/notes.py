"""What a reader of a summary must know beside the figures: recordings, clocks, refinement, and notes on each."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import ClockStatus, RecordingStatus, RefinementStatus
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS

__all__ = [
    "describe_camera_motion",
    "describe_clocks",
    "describe_recording",
    "describe_refinement",
    "displacement_notes",
    "recording_notes",
]

_CLEAN_BITS_PER_PIXEL = 1.0
"""Above this H.264 keeps the motion to better than 1 % (docs/decisions/008-compression.md)."""
_CARRIED = 3.0
"""A result is carried by the assumption when that adds so many times the random part to its uncertainty."""


def describe_recording(tracks: xr.Dataset) -> dict[str, Any]:
    """Size of the pictures and what the decoder said of a view's recording."""
    size = {"width": tracks.attrs.get("image_width"), "height": tracks.attrs.get("image_height")}
    return {**size, **tracks.attrs.get("recording", {})}


def recording_notes(tracks: Mapping[str, xr.Dataset]) -> list[str]:
    """What a user must know about the recordings: ended early, frames missing or repeated."""
    notes = []
    for view, of_view in tracks.items():
        record = describe_recording(of_view)
        if record.get("status", RecordingStatus.OK) != RecordingStatus.OK:
            notes.append(f"view {view!r}: {record['status']}: {record.get('message', '')}")
        if record.get("bits_per_pixel", np.nan) < _CLEAN_BITS_PER_PIXEL:
            notes.append(
                f"view {view!r}: compressed to {record['bits_per_pixel']:.2f} bits a pixel: motion comes out some 1 to "
                "2 % too small, which is stated but not corrected (docs/decisions/008-compression.md)"
            )
        for what in ("dropped", "duplicated"):
            if record.get(what, 0):
                notes.append(f"view {view!r}: {record[what]} {what} frames of {record['frames']}")
    return notes


def describe_clocks(displacement: xr.Dataset) -> dict[str, Any]:
    """What the motion tells of each further view's clock, by view; empty where it was not asked."""
    names = {"status": "clock_status", "offset_s": "clock_offset"}
    names |= {"offset_std_s": "clock_offset_std", "rate_ratio": "clock_rate"}
    found = _by_view(displacement, names)
    return {view: row for view, row in list(found.items())[1:] if row["status"] != ClockStatus.STATED}


def describe_camera_motion(displacement: xr.Dataset) -> dict[str, Any]:
    """What the static points show of each camera's motion, by view; empty where it was not looked for."""
    names = {"status": "camera_motion_status", "static_rms_before_px": "camera_motion_before"}
    return _by_view(displacement, names | {"static_rms_after_px": "camera_motion_after"})


def _by_view(displacement: xr.Dataset, names: Mapping[str, str]) -> dict[str, Any]:
    """Values of variables on ``view`` by view and by what the summary calls them; empty where there are none."""
    if any(variable not in displacement for variable in names.values()):
        return {}
    return {
        str(view): {name: displacement[variable].sel(view=view).item() for name, variable in names.items()}
        for view in displacement["view"].values
    }


def describe_refinement(displacement: xr.Dataset) -> dict[str, Any]:
    """What became of each point in the refinement, by point; empty without one."""
    if "prior_share" not in displacement:
        return {}
    rows = zip(
        displacement["point"].values,
        displacement["refinement_status"].values,
        displacement["refined_view"].values,
        displacement["prior_share"].values,
        strict=True,
    )
    return {
        str(point): {"status": status, "view": view or None, "prior_share": float(share)}
        for point, status, view, share in rows
    }


def displacement_notes(displacement: xr.Dataset | None) -> list[str]:
    """Views whose offset the motion did not tell, and points that were not refined."""
    if displacement is None:
        return []
    notes = [
        f"view {view!r}: not synchronised by its motion: {clock['status']}; its time_offset_s was taken (0 when not "
        'stated, and then all samples are marked unreliable); state it, or set method.synchronization = "none" for '
        "cameras that start together"
        for view, clock in describe_clocks(displacement).items()
        if clock["status"] != ClockStatus.OK
    ]
    notes += _assumption_notes(displacement)
    refined = describe_refinement(displacement)
    refused = {p: row["status"] for p, row in refined.items() if row["status"] != RefinementStatus.OK}
    return notes + [f"point {p!r}: not refined: {status}" for p, status in refused.items()]


def _assumption_notes(displacement: xr.Dataset) -> list[str]:
    """Refined points and axes whose uncertainty is mostly that of the assumption, not of the images."""
    if "prior_share" not in displacement or "uncertainty" not in displacement:
        return []
    squares = displacement["uncertainty"].values ** 2
    known = np.isfinite(squares)
    rms = np.sqrt(np.where(known, squares, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))
    random, assumption = (rms[list(COMPONENTS).index(name)] for name in ("random", "assumption"))
    names = [str(name) for name in displacement["point"].values]
    points = {
        str(axis): assumption[:, n] > _CARRIED * random[:, n] for n, axis in enumerate(displacement["axis"].values)
    }
    carried = [
        f"{axis} of {', '.join(repr(name) for name, mostly in zip(names, of_axis, strict=True) if mostly)}"
        for axis, of_axis in points.items()
        if of_axis.any()
    ]
    what = "the assumption that hardly anything moves along the suppressed axis says more than the images do about"
    return [f"refinement: {what} {'; '.join(carried)}"] if carried else []
