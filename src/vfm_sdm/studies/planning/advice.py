"""What would help a planned measurement most: every candidate is added to the plan, and the plan predicted anew."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import SessionError
from vfm_sdm.studies.planning.layout import Layout
from vfm_sdm.studies.planning.plan import Plan, PlannedCamera, PlannedLength, PlannedRange, ReadingsAt
from vfm_sdm.studies.planning.prediction import Prediction, predict

__all__ = ["Advice", "list_advice", "pan_clip_std", "view_angles"]

_LENGTH_STD_M, _RANGE_STD_M, _LEVEL_STD_DEG = 0.005, 0.005, 0.1
"""What a tape between two marks, a laser from a tripod and an electronic level are good for."""
_VIEW_DEG, _PAN_STD = np.array([14.0, 40.0, 65.0]), np.array([0.005, 0.001, 0.0005])
"""Relative standard deviation of a focal length from a pan clip of a distant scene, by the horizontal field of view."""
_MOST_LENGTHS = 6
_LONGER = 1.4
"""Factor of a longer lens: one stop of a zoom."""
_MOVES = (0.3, -0.25)
"""Shares of the baseline by which a camera is moved along the structure, and of its distance from it across."""
_WORTH_SAYING = 0.97


@dataclass(frozen=True)
class Advice:
    """Something that would help.

    Parameters
    ----------
    sentence
        What to do, with how well.
    left
        Relative uncertainty (`Prediction.relative`) that it leaves, over that of the plan [1].
    plan
        The plan with it.
    """

    sentence: str
    left: float
    plan: Plan


def list_advice(prediction: Prediction, *, progress: Progress | None = None) -> list[Advice]:
    """What would help, that which leaves least uncertainty first; only what is worth saying.

    Parameters
    ----------
    prediction
        Of the plan as it is.
    progress
        Called with the number of candidates that were tried.
    """
    candidates, found = list(_list_candidates(prediction.laid)), []
    for number, (sentence, changed) in enumerate(candidates, start=1):
        if progress is not None:
            progress("what would help", number, len(candidates))
        try:
            left = predict(changed).relative / prediction.relative
        except SessionError:
            continue  # a camera that does not see the points any more
        if left < _WORTH_SAYING:
            found.append(Advice(sentence, left, changed))
    return sorted(found, key=lambda one: one.left)


def pan_clip_std(view_deg: float) -> float:
    """Relative standard deviation of a focal length from a pan clip of a distant scene [1].

    Parameters
    ----------
    view_deg
        Horizontal field of view [deg].

    Examples
    --------
    >>> pan_clip_std(14.0), round(pan_clip_std(27.0), 4)
    (0.005, 0.0018)
    """
    slope = np.interp(np.log(view_deg), np.log(_VIEW_DEG), np.log(_PAN_STD))
    beyond = np.log(_VIEW_DEG[0] / view_deg) * np.log(_PAN_STD[0] / _PAN_STD[1]) / np.log(_VIEW_DEG[1] / _VIEW_DEG[0])
    return round(float(np.exp(slope + max(beyond, 0.0))), 6)


def view_angles(laid: Layout) -> list[float]:
    """Horizontal field of view of every camera [deg]."""
    return [float(np.degrees(2 * np.arctan(c.image_size[0] / 2 / c.K[0, 0]))) for c in laid.cameras]


def _list_candidates(laid: Layout) -> Iterator[tuple[str, Plan]]:
    yield from _list_readings(laid)
    yield from _list_cameras(laid)


def _list_readings(laid: Layout) -> Iterator[tuple[str, Plan]]:
    """Further readings on site, in words, with the plan that has them."""
    plan, measured = laid.plan, laid.plan.measured
    names = [point.name for point in plan.point]
    known = {frozenset(one.points) for one in measured.length}
    pairs = [
        (float(np.linalg.norm(laid.points3d[a] - laid.points3d[b])), names[a], names[b])
        for a, b in combinations(range(len(names)), 2)
        if frozenset((names[a], names[b])) not in known
    ]
    for length, a, b in sorted(pairs, reverse=True)[:_MOST_LENGTHS]:
        added = (*measured.length, PlannedLength(points=(a, b), std_m=_LENGTH_STD_M))
        yield f"a length of {length:.1f} m between {a!r} and {b!r} known to 5 mm", _measured(plan, length=added)
    for camera in plan.camera[:2]:
        ranged = {one.point for one in measured.range if (one.view or plan.camera[0].name) == camera.name}
        for point in plan.moving:
            if point.name not in ranged:
                one = PlannedRange(point=point.name, view=camera.name, std_m=_RANGE_STD_M)
                words = f"a range from {camera.name!r} to {point.name!r} known to 5 mm"
                yield words, _measured(plan, range=(*measured.range, one))
    clip = max(pan_clip_std(angle) for angle in view_angles(laid))
    if measured.pan_clip_std is None or measured.pan_clip_std > clip:
        yield f"a pan clip of each lens (focal length to {100 * clip:.2g} %)", _measured(plan, pan_clip_std=clip)
    tools = (("baseline_std_m", 0.003, "the baseline"), ("perpendicular_std_m", 0.005, "the perpendicular distance"))
    for key, std, words in tools:
        if getattr(measured, key) > std:
            yield f"{words} known to {1e3 * std:.0f} mm", _measured(plan, **{key: std})
    if measured.level_std_deg > _LEVEL_STD_DEG:
        yield f"the level of {plan.camera[0].name!r} read to 0.1 degrees", _measured(plan, level_std_deg=_LEVEL_STD_DEG)
    read = {one.view for one in measured.reading}
    for camera in plan.camera[1:]:
        if camera.name not in read:
            reading = ReadingsAt(
                view=camera.name, level_std_deg=_LEVEL_STD_DEG, perpendicular_std_m=0.01, longitudinal_std_m=0.02
            )
            words = f"level and distances of {camera.name!r}, too"
            yield words, _measured(plan, reading=(*measured.reading, reading))


def _list_cameras(laid: Layout) -> Iterator[tuple[str, Plan]]:
    """Other lenses and places of the cameras, in words, with the plan that has them."""
    plan = laid.plan
    lenses = [_lengthen(one) for one in plan.camera]
    if all(one is not None for one in lenses):
        longer = tuple(one for one in lenses if one is not None)
        yield f"lenses {_LONGER:g} times as long", plan.model_copy(update={"camera": longer})
    for number, one in enumerate(plan.camera[1:], start=1):
        apart = one.longitudinal_m - plan.camera[0].longitudinal_m
        for share in _MOVES:
            step = share * np.copysign(laid.rig.baseline(0, number), apart)
            moved = {"longitudinal_m": round(one.longitudinal_m + float(step), 2)}
            words = (
                f"{one.name!r} {abs(step):.1f} m {'farther from' if share > 0 else 'nearer to'} {plan.camera[0].name!r}"
            )
            yield f"{words} along the structure", _replaced(plan, number, moved)
    for number, one in enumerate(plan.camera):
        for share in _MOVES:
            moved = {"perpendicular_m": round(one.perpendicular_m * (1 + share), 2)}
            side = "away from" if share > 0 else "towards"
            step = abs(share) * one.perpendicular_m
            yield f"{one.name!r} {step:.1f} m {side} the structure", _replaced(plan, number, moved)


def _lengthen(camera: PlannedCamera) -> PlannedCamera | None:
    """The camera with a longer lens; ``None`` where nothing is stated of its length."""
    lens = camera.lens
    if lens is None or (lens.focal_px is None and lens.focal_mm is None):
        return None
    key = "focal_px" if lens.focal_px is not None else "focal_mm"
    longer = lens.model_copy(update={key: _LONGER * float(getattr(lens, key))})
    return camera.model_copy(update={"lens": longer})


def _measured(plan: Plan, **update: Any) -> Plan:
    return plan.model_copy(update={"measured": plan.measured.model_copy(update=update)})


def _replaced(plan: Plan, number: int, update: dict[str, Any]) -> Plan:
    cameras: Sequence[PlannedCamera] = plan.camera
    changed = tuple(one.model_copy(update=update) if n == number else one for n, one in enumerate(cameras))
    return plan.model_copy(update={"camera": changed})
