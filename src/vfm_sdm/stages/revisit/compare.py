"""Change of rest position of every point since an earlier visit, with its uncertainty."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.core.datasets import CAMERA_AXES, STRUCTURE_AXES, frames_of_points
from vfm_sdm.core.statuses import PointStatus, RevisitStatus
from vfm_sdm.geometry.rig_views import select_views
from vfm_sdm.inputs.session import picture_of
from vfm_sdm.stages.revisit.adjustment import Adjusted, Sightings, adjust_visits
from vfm_sdm.stages.revisit.places import find_again
from vfm_sdm.stages.revisit.result import Change, Revisit
from vfm_sdm.stages.revisit.visit import Visit, read_visit, rest_shifts

__all__ = ["compare_to_baseline", "compare_visits"]

_MM_PER_M = 1e3
_FEWEST_STATIC = 3
_NO_SPARE = "three static points: one that moved across their plane would not be seen, and turn the rest; name a fourth"
_LEAST_CHANCE = 1e-3
"""Probability of residuals below which they are no chance [1]."""
_SCALE_STD = 3.0
_BESIDE_STD_PX = 0.1
"""What registration between views leaves beside noise, the same at both visits: it hardly counts [px]."""
_UNKNOWN_PLACE_PX = 1.0
"""Standard deviation of a place that was registered where the texture does not tell its uncertainty [px]."""
_PLACE_STD_PX = 0.02
"""What registration of pictures that were taken months apart leaves beside noise [px]."""


def compare_to_baseline(later: Visit) -> Revisit | None:
    """Change since the visit that the session of a visit names; ``None`` where it names none.

    Parameters
    ----------
    later
        The visit.

    Raises
    ------
    SessionError
        The earlier visit is not whole, or its recordings are not where they were.
    """
    baseline = later.session.baseline_visit
    return None if baseline is None else compare_visits(read_visit(later.session.resolve(baseline)), later)


def compare_visits(earlier: Visit, later: Visit) -> Revisit:
    """Change of the rest position of every point that both visits name.

    Parameters
    ----------
    earlier, later
        The two visits. Views and points belong together by their names; static are the points that both call so.

    Notes
    -----
    Each place of the earlier visit is found again in the later picture of the same view (`find_again`), and both visits
    are adjusted together (`adjust_visits`). Where their scales, then free, differ by more than three standard
    deviations, or the residuals are larger than chance explains, there is no value: a wrong length, a wrong focal
    length or a static point that moved would look like a settlement.
    """
    names, static = _common_points(earlier, later)
    axes = CAMERA_AXES if earlier.cameras.frame is None else STRUCTURE_AXES
    found = Revisit(earlier.session.name, axes, (), ())
    rigs = [visit.cameras.rig for visit in (earlier, later)]
    views = [] if rigs[0] is None or rigs[1] is None else [v for v in rigs[0].names if v in rigs[1].names]
    if len(views) < 2 or not all(rig is not None and rig.metric for rig in rigs):
        return _nothing(found, names, static, RevisitStatus.NO_CAMERAS)
    seen, status = _see(earlier, later, views, names, static)
    usable = np.array([one is RevisitStatus.OK for one in status])
    found = replace(found, static=tuple(n for n, s, u in zip(names, static, usable, strict=True) if s and u))
    refused = {n: one for n, one in zip(names, status, strict=True) if one is not RevisitStatus.OK}
    if len(found.static) < _FEWEST_STATIC:
        return _nothing(found, names, static, RevisitStatus.FEW_STATIC, refused)
    seen = seen.chosen(usable)
    free = adjust_visits(seen, free_scale=True)
    found = replace(
        found,
        scale_ratio=float(np.exp(free.log_scale)),
        scale_ratio_std=float(np.exp(free.log_scale) * free.log_scale_std),
    )
    kept = [name for name, one in zip(names, usable, strict=True) if one]
    if free.chance < _LEAST_CHANCE:
        found = replace(found, notes=_suspects(seen, kept))
        return _nothing(found, names, static, RevisitStatus.STATIC_MOVED, refused)
    if abs(free.log_scale) > _SCALE_STD * free.log_scale_std:
        return _nothing(found, names, static, RevisitStatus.SCALES_DISAGREE, refused)
    adjusted = adjust_visits(seen)
    if not adjusted.converged:
        return _nothing(found, names, static, RevisitStatus.NOT_CONVERGED, refused)
    moving = [name for name, one in zip(kept, seen.static, strict=True) if not one]
    values, std = _along_axes(adjusted, earlier)
    known = {
        name: Change(name, RevisitStatus.OK, tuple(value.tolist()), tuple(own.tolist()))
        for name, value, own in zip(moving, values, std, strict=True)
    }
    changes = tuple(known.get(n) or Change(n, refused[n]) for n, s in zip(names, static, strict=True) if not s)
    return replace(found, changes=changes, notes=(_NO_SPARE,) if len(found.static) == _FEWEST_STATIC else ())


def _common_points(earlier: Visit, later: Visit) -> tuple[list[str], list[bool]]:
    """Names of the points of both visits, and which of them are static in both."""
    before = {point.name: point.static for point in earlier.session.point}
    common = [point for point in later.session.point if point.name in before]
    return [point.name for point in common], [point.static and before[point.name] for point in common]


def _see(
    earlier: Visit, later: Visit, views: Sequence[str], names: list[str], static: Sequence[bool]
) -> tuple[Sightings, list[RevisitStatus]]:
    """Where both visits see every point at rest, and which points cannot be compared."""
    count, visits = len(names), (earlier, later)
    pixels = np.full((2, len(views), count, 2), np.nan)
    covariance = np.tile(np.eye(2), (2, len(views), count, 1, 1))
    place_std = np.zeros((len(views), count, 2))
    alike = np.zeros(count, dtype=np.bool_)
    rigs = [select_views(rig, views) for visit in visits if (rig := visit.cameras.rig) is not None]
    for number, view in enumerate(views):
        places, named = (_places(visit, view, names) for visit in visits)
        found, own, status = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan), [""] * count
        for pictures, rows in _pictures(earlier, later, view, names):
            found[rows], own[rows], of_rows = find_again(
                pictures,
                (rigs[0].cameras[number], rigs[1].cameras[number]),
                places[rows],
                named[rows],
                subset_px=later.session.method.usual_subset_px,
            )
            for row, one in zip(rows.tolist(), of_rows, strict=True):
                status[row] = one
        alike |= np.array([one == PointStatus.AMBIGUOUS for one in status], dtype=np.bool_)
        shifts = [rest_shifts(visit, view, names) for visit in visits]
        here = np.stack([places + shifts[0][0], found + shifts[1][0]])
        # The earlier places are the points themselves; registration puts the later ones beside them.
        noise = np.stack([shifts[0][1], shifts[1][1] + own + _PLACE_STD_PX**2 * np.eye(2)])
        both = np.isfinite(here).all(axis=(0, 2)) & np.isfinite(noise).all(axis=(0, 2, 3))
        pixels[:, number, both], covariance[:, number, both] = here[:, both], noise[:, both]
        std = earlier.cameras.points["position_std"].sel(view=view, point=names).values
        place_std[number] = np.maximum(np.where(np.isnan(std), _UNKNOWN_PLACE_PX, std), _BESIDE_STD_PX)
    enough = np.isfinite(pixels).all(axis=(0, 3)).sum(axis=0) >= 2
    missing = [RevisitStatus.LOOK_ALIKE if one else RevisitStatus.NOT_FOUND for one in alike]
    reasons = [RevisitStatus.OK if one else other for one, other in zip(enough, missing, strict=True)]
    return Sightings((rigs[0], rigs[1]), pixels, covariance, place_std, np.array(static, dtype=np.bool_)), reasons


def _places(visit: Visit, view: str, names: list[str]) -> FloatArray:
    """Places of points in a view, shape (P, 2) [px]; NaN where there is none."""
    points = visit.cameras.points.sel(view=view, point=names)
    good = points["status"].values == PointStatus.OK
    return np.where(good[:, None], points["position"].transpose("point", "pixel").values, np.nan)


def _pictures(
    earlier: Visit, later: Visit, view: str, names: list[str]
) -> Iterator[tuple[tuple[LumaArray, LumaArray], IntArray]]:
    """Pictures of a view at both visits in which points were named, shape (H, W) each, and the rows of these points."""
    both = np.stack([frames_of_points(one.cameras.points.sel(view=view), names) for one in (earlier, later)], axis=1)
    for pair in np.unique(both, axis=0):
        before, after = (picture_of(one.frames, view, int(n)) for one, n in zip((earlier, later), pair, strict=True))
        yield (before, after), np.flatnonzero((both == pair).all(axis=1))


def _suspects(seen: Sightings, names: Sequence[str]) -> tuple[str, ...]:
    """Which static point, left out, lets the others agree; nothing where none does."""
    rows = np.flatnonzero(seen.static)
    if len(rows) <= _FEWEST_STATIC:
        return ("with a fourth static point the one that moved could be told",)
    chances = [adjust_visits(seen.chosen(np.arange(len(names)) != row), free_scale=True).chance for row in rows]
    best = int(np.argmax(chances))
    if chances[best] < _LEAST_CHANCE:
        return ("no single static point explains it",)
    return (f"without {names[rows[best]]!r} the others agree; check whether it stands still, or name it not static",)


def _along_axes(adjusted: Adjusted, earlier: Visit) -> tuple[FloatArray, FloatArray]:
    """Changes and their standard deviations along the earlier visit's axes, shape (M, 3) each [mm]."""
    frame = earlier.cameras.frame
    rotation = np.eye(3) if frame is None else frame.rotation
    change = adjusted.change @ rotation.T
    covariance = rotation @ adjusted.covariance @ rotation.T
    if frame is not None:
        # An error w of the axes turns a change d into d + w x d.
        turned = np.cross(np.eye(3)[None], change[:, None])
        covariance = covariance + np.einsum("pwa,wv,pvb->pab", turned, frame.covariance, turned)
    return _MM_PER_M * change, _MM_PER_M * np.sqrt(np.einsum("pii->pi", covariance))


def _nothing(
    found: Revisit,
    names: Sequence[str],
    static: Sequence[bool],
    status: RevisitStatus,
    refused: Mapping[str, RevisitStatus] | None = None,
) -> Revisit:
    """The result without values, for one reason for all points that have none of their own."""
    reasons = refused or {}
    changes = tuple(Change(n, reasons.get(n, status)) for n, s in zip(names, static, strict=True) if not s)
    return replace(found, changes=changes)
