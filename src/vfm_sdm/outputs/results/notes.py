"""Descriptions of recordings, clocks and refinement for the reader of a summary, and notes on each."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import ClockStatus, PointStatus, RecordingStatus, RefinementStatus
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS
from vfm_sdm.stages.registration.designs import Warp

__all__ = [
    "describe_camera_motion",
    "describe_clocks",
    "describe_recording",
    "describe_refinement",
    "describe_subsets",
    "displacement_notes",
    "recording_notes",
    "subset_notes",
]

_CLEAN_BITS_PER_PIXEL = 1.0
"""Bits a pixel above which H.264 keeps the motion to better than 1 % (docs/decisions/008-compression.md)."""
_MOSTLY_ASSUMED = 3.0
"""Ratio of the assumption's part of the uncertainty to the random part above which a note says so."""


def describe_recording(tracks: xr.Dataset) -> dict[str, Any]:
    """Size of a view's pictures [px] and the decoder's report on its recording.

    Parameters
    ----------
    tracks
        Tracks of the view, shape (T, P, 2) [px], with their attributes.
    """
    size = {"width": tracks.attrs.get("image_width"), "height": tracks.attrs.get("image_height")}
    return {**size, **tracks.attrs.get("recording", {})}


def recording_notes(tracks: Mapping[str, xr.Dataset]) -> list[str]:
    """Sentences on recordings that ended early, lack or repeat frames, or are compressed strongly.

    Parameters
    ----------
    tracks
        Tracks by view, shape (T, P, 2) [px], with their attributes.
    """
    notes = []
    for view, found in tracks.items():
        record = describe_recording(found)
        if record.get("status", RecordingStatus.OK) != RecordingStatus.OK:
            notes.append(f"view {view!r}: {record['status']}: {record.get('message', '')}")
        if record.get("bits_per_pixel", np.nan) < _CLEAN_BITS_PER_PIXEL:
            notes.append(
                f"view {view!r}: compressed to {record['bits_per_pixel']:.2f} bits a pixel: motion comes out some 1 to "
                "2 % too small; it is corrected where injected motion shows by how much, else stated "
                "(docs/decisions/008-compression.md)"
            )
        notes += [f"view {view!r}: {said}" for said in (*record.get("remarks", ()), *record.get("doubts", ()))]
        for what in ("dropped", "duplicated"):
            if record.get(what, 0):
                notes.append(f"view {view!r}: {record[what]} {what} frames of {record['frames']}")
    return notes


def describe_subsets(tracks: xr.Dataset) -> dict[str, Any]:
    """Status, warp, side [px] and believed share [1] of the subsets of a view, by point; empty where none was chosen.

    Parameters
    ----------
    tracks
        Tracks of the view, shape (T, P, 2) [px].
    """
    names = {"status": "subset_status", "warp": "warp", "subset_px": "subset_px", "believed": "believed"}
    if any(variable not in tracks for variable in names.values()):
        return {}
    return {
        str(point): {name: tracks[variable].sel(point=point).item() for name, variable in names.items()}
        for point in tracks["point"].values
    }


def subset_notes(tracks: Mapping[str, xr.Dataset]) -> list[str]:
    """Sentences on points that were refused before tracking, and on those that are measured across an edge only.

    Parameters
    ----------
    tracks
        Tracks by view, shape (T, P, 2) [px].
    """
    notes = []
    for view, found in tracks.items():
        for point, row in describe_subsets(found).items():
            if row["status"] == PointStatus.NO_TEXTURE:
                place = found["nearest_texture"].sel(point=point).values
                u, v = place
                would_do = f"({u:.0f}, {v:.0f}) would do" if np.isfinite(place).all() else "none near would do"
                notes.append(
                    f"point {point!r} in view {view!r}: not tracked: {row['status']}; name another: {would_do}"
                )
        edges = [point for point, row in describe_subsets(found).items() if row["warp"] == Warp.EDGE]
        if edges:
            listed = ", ".join(repr(point) for point in edges)
            notes.append(f"view {view!r}: measured across an edge only, nothing along it: {listed}")
    return notes


def describe_clocks(displacement: xr.Dataset) -> dict[str, Any]:
    """Offset [s] and rate [1] of each further view's clock from its motion, by view; empty where it was not used.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm], with its variables on ``view``.
    """
    names = {"status": "clock_status", "offset_s": "clock_offset"}
    names |= {"offset_std_s": "clock_offset_std", "rate_ratio": "clock_rate"}
    found = _read_by_view(displacement, names)
    return {view: row for view, row in list(found.items())[1:] if row["status"] != ClockStatus.STATED}


def describe_camera_motion(displacement: xr.Dataset) -> dict[str, Any]:
    """Motion of each camera from the static points [px], by view; empty where it was not looked for.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm], with its variables on ``view``.
    """
    names = {"status": "camera_motion_status", "static_rms_before_px": "camera_motion_before"}
    return _read_by_view(displacement, names | {"static_rms_after_px": "camera_motion_after"})


def _read_by_view(displacement: xr.Dataset, names: Mapping[str, str]) -> dict[str, Any]:
    """Values of variables on ``view`` by view and by their names in the summary; empty where there are none."""
    if any(variable not in displacement for variable in names.values()):
        return {}
    return {
        str(view): {name: displacement[variable].sel(view=view).item() for name, variable in names.items()}
        for view in displacement["view"].values
    }


def describe_refinement(displacement: xr.Dataset) -> dict[str, Any]:
    """Status, view and share of the assumption [1] of each refined point, by point; empty without refinement.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    """
    if "prior_share" not in displacement:
        return {}
    rows = zip(
        displacement["point"].values,
        displacement["refinement_status"].values,
        displacement["refined_view"].values,
        displacement["prior_share"].values,
        strict=True,
    )
    described = {
        str(point): {"status": status, "view": view or None, "prior_share": float(share)}
        for point, status, view, share in rows
    }
    if "reference_views" in displacement:  # of two views that is the other one
        for row, views in zip(described.values(), displacement["reference_views"].values, strict=True):
            row["reference_views"] = str(views)
    return described


def displacement_notes(displacement: xr.Dataset | None) -> list[str]:
    """Sentences on views whose offset the motion did not tell, and on points that were not refined.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm]; without one there are no notes.
    """
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
    """Sentence on points and axes whose uncertainty comes mostly from the assumption, not from the images."""
    if "prior_share" not in displacement or "uncertainty" not in displacement:
        return []
    squares = displacement["uncertainty"].values ** 2
    known = np.isfinite(squares)
    rms = np.sqrt(np.where(known, squares, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))
    random, assumption = (rms[list(COMPONENTS).index(name)] for name in ("random", "assumption"))
    names = [str(name) for name in displacement["point"].values]
    points = {
        str(axis): assumption[:, n] > _MOSTLY_ASSUMED * random[:, n]
        for n, axis in enumerate(displacement["axis"].values)
    }
    carried = [
        f"{axis} of {', '.join(repr(name) for name, mostly in zip(names, above, strict=True) if mostly)}"
        for axis, above in points.items()
        if above.any()
    ]
    what = "the assumption that hardly anything moves along the suppressed axis says more than the images do about"
    return [f"refinement: {what} {'; '.join(carried)}"] if carried else []
