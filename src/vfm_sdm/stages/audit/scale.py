"""Check of the scale: how well it is known, and which further reading on site would tell it best."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, step_parameters, triangulation_jacobian
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.audit.lenses import find_unseen_lens_error
from vfm_sdm.stages.audit.model import AuditCheck, AuditInputs
from vfm_sdm.stages.cameras.site_values import POINTED_STD_PX
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["Reading", "check_scale", "list_readings"]

_NAME = "scale"
_UNUSABLE = 0.5
"""Expanded relative uncertainty of the scale beyond which displacement is not even known by its size [1]."""
_LENGTH_STD_M, _RANGE_STD_M = 0.005, 0.005
"""What a tape between two marks, and a laser from a tripod, are good for [m]."""
_LENS_STD = 0.003
"""Relative standard deviation of a focal length that was calibrated [1]."""
_WORTH_SAYING = 0.8
"""Share of today's uncertainty that a reading must leave at most to be worth a visit [1]."""


@dataclass(frozen=True)
class Reading:
    """Something that could be measured on site.

    Parameters
    ----------
    sentence
        Words for it, with how well it has to be known.
    left
        Expanded relative uncertainty of the scale that it would leave [1].
    """

    sentence: str
    left: float


def check_scale(inputs: AuditInputs) -> AuditCheck:
    """Expanded relative uncertainty of the scale (k = 2), of the worst point and axis [1].

    Notes
    -----
    Above the session's limit a result is never fit to use. The reading that would help most is the one that leaves the
    least of that uncertainty: a reading h with standard deviation r turns the covariance C of the cameras into
    C - C h h' C / (h' C h + r^2), of which the scale's share is seen before anybody drives back.
    """
    limit = inputs.session.method.scale_limit
    worst = _find_worst(inputs)
    if worst is None:
        sentence = "nobody knows how well the scale is known: the cameras come without their uncertainty"
        return AuditCheck(_NAME, Outcome.NOT_POSSIBLE, float("nan"), limit, "1", sentence)
    point, axis, value = worst
    where = f"{axis} of {point}"
    unseen = _find_unseen(inputs, point)
    if value <= limit < unseen:
        remedy = _advise_check(inputs, point)
        sentence = (
            f"known to {_percent(value)} (k = 2) if the lenses are as stated; it rests on them, and nothing would "
            f"show a lens so wrong that the scale is off by {_percent(unseen)}. {remedy} checks them"
        )
        return AuditCheck(_NAME, Outcome.CAUTION, value, limit, "1", sentence, where)
    if value <= limit:
        return AuditCheck(_NAME, Outcome.PASS, value, limit, "1", f"known to {_percent(value)} (k = 2)", where)
    best = min(list_readings(inputs, point), key=lambda one: one.left, default=None)
    advice = "no single length, range or lens would tell it much better; measure several"
    if best is not None and best.left < _WORTH_SAYING * value:
        advice = f"{best.sentence} brings {_percent(value)} to {_percent(best.left)}"
    outcome = Outcome.FAIL if value > _UNUSABLE else Outcome.CAUTION
    sentence = f"known to {_percent(value)} only (k = 2), most of it common to all points and samples; {advice}"
    return AuditCheck(_NAME, outcome, value, limit, "1", sentence, where)


def list_readings(inputs: AuditInputs, point: str) -> list[Reading]:
    """What could still be measured on site, and what each reading would leave of the uncertainty of a point's scale.

    Parameters
    ----------
    inputs
        Session, cameras, tracks on one clock and displacement.
    point
        Point whose scale matters, of its worst axis.

    Returns
    -------
    readings
        Lengths between points, ranges from the first camera, the baseline and every lens; empty where the uncertainty
        of the cameras, or the point's place, is not known.
    """
    cameras = inputs.cameras
    if cameras.rig is None or cameras.covariance is None:
        return []
    names, pixels = _list_places(inputs, cameras.rig)
    if point not in names:
        return []
    covariance = cameras.covariance
    scales = _list_slopes(inputs, point)
    size = len(covariance)
    return [
        Reading(words, max(_leave(scale, covariance, np.pad(slope, (0, size - len(slope))), std) for scale in scales))
        for words, slope, std in _propose(cameras.rig, names, pixels)
    ]


def _find_unseen(inputs: AuditInputs, point: str) -> float:
    """Largest error of a point's scale that a wrong lens could cause unseen, of the axes that are judged [1]."""
    slopes = _list_slopes(inputs, point)
    return max((find_unseen_lens_error(inputs.cameras, one) for one in slopes), default=0.0)


def _list_slopes(inputs: AuditInputs, point: str) -> list[FloatArray]:
    """Change of a point's scale along every axis that is judged with parameters of cameras and axes, (10 V + 3,)."""
    cameras = inputs.cameras
    if cameras.rig is None or cameras.covariance is None:
        return []
    names, pixels = _list_places(inputs, cameras.rig)
    if point not in names:
        return []
    rotation = np.eye(3) if cameras.frame is None else cameras.frame.rotation
    axes = [str(a) for a in inputs.displacement["axis"].values]
    directions = rotation[[axes.index(axis) for axis in inputs.judged_axes]]
    return [_differentiate_scale(cameras.rig, pixels[:, names.index(point)], one) for one in directions]


def _advise_check(inputs: AuditInputs, point: str) -> str:
    """The reading that would tell most of what the lenses tell now."""
    of_sites = [one for one in list_readings(inputs, point) if "lens" not in one.sentence]
    best = min(of_sites, key=lambda one: one.left, default=None)
    return "A calibration of the lenses" if best is None else best.sentence[:1].upper() + best.sentence[1:]


def _find_worst(inputs: AuditInputs) -> tuple[str, str, float] | None:
    """Point, axis and expanded relative uncertainty of its scale; ``None`` where none is known."""
    data = inputs.displacement.sel(point=inputs.moving)
    axes = inputs.judged_axes
    chosen = data.sel(axis=axes)
    measured = ((chosen["status"] == Status.OK) & np.isfinite(chosen["displacement"])).any("time")
    stds = chosen["scale_std"].where(measured).values
    if not np.isfinite(stds).any():
        return None
    row, column = np.unravel_index(int(np.nanargmax(stds)), stds.shape)
    return inputs.moving[row], axes[column], COVERAGE_FACTOR * float(stds[row, column])


def _list_places(inputs: AuditInputs, rig: Rig) -> tuple[list[str], FloatArray]:
    """Points that all views found, and their pixels, shape (V, P, 2) [px]."""
    position = inputs.cameras.points["position"].sel(view=list(rig.names)).transpose("view", "point", "pixel")
    known = np.isfinite(position.values).all(axis=(0, 2))
    return [str(name) for name in position["point"].values[known]], position.values[:, known]


def _differentiate_scale(rig: Rig, pixels: FloatArray, direction: FloatArray) -> FloatArray:
    """Change of the gain along a direction (3,) with camera parameters and the axes' rotation, shape (10 V + 3,)."""
    slopes = compute_gain_sensitivity(pixels[:, None], rig)[0]
    # A small turn of the axes does not stretch them.
    return np.pad(np.einsum("i,nij,j->n", direction, slopes, direction), (0, 3))


def _propose(rig: Rig, names: list[str], pixels: FloatArray) -> Iterator[tuple[str, FloatArray, float]]:
    """What could be measured: in words, its change with the cameras' parameters, and its standard deviation."""

    def lengths(changed: Rig) -> FloatArray:
        places = triangulate(pixels, changed)
        between = [np.linalg.norm(places[a] - places[b]) for a, b in combinations(range(len(names)), 2)]
        first = np.linalg.norm(places, axis=-1)
        return np.concatenate([between, first, [changed.baseline()]])

    here = lengths(rig)
    marks = [*_spread_marks(rig, pixels), *[0.0] * (len(names) + 1)]
    slopes = _differentiate(lengths, rig)
    words = [f"a length of {{:.1f}} m between {a!r} and {b!r} known to" for a, b in combinations(names, 2)]
    words += [f"a range of {{:.1f}} m from the camera of {rig.names[0]!r} to {name!r} known to" for name in names]
    tools = [_LENGTH_STD_M] * (len(words) - len(names)) + [_RANGE_STD_M] * len(names)
    words.append("a baseline of {:.2f} m known to")
    tools.append(_LENGTH_STD_M)
    for text, value, slope, tool, mark in zip(words, here, slopes, tools, marks, strict=True):
        if np.isfinite(value) and np.isfinite(slope).all():
            yield f"{text.format(value)} {1e3 * tool:.0f} mm", slope, float(np.hypot(tool, mark))
    size = len(CAMERA_PARAMETERS)
    for number, name in enumerate(rig.names):
        one = np.zeros(size * len(rig))
        one[size * number] = 1.0
        yield f"a calibration of the lens of {name!r} to {_percent(_LENS_STD)}", one, _LENS_STD


def _differentiate(lengths: Callable[[Rig], FloatArray], rig: Rig) -> FloatArray:
    """Change of lengths with every parameter of the cameras, shape (L, 10 V)."""
    changes = [(lengths(ahead) - lengths(back)) / (2 * step) for step, ahead, back in step_parameters(rig)]
    return np.stack(changes, axis=1)


def _spread_marks(rig: Rig, pixels: FloatArray) -> Iterator[float]:
    """Standard deviation [m] of the length between each two points from where the pictures show its ends."""
    places, jacobian = triangulate(pixels, rig), triangulation_jacobian(pixels, rig)
    for a, b in combinations(range(pixels.shape[1]), 2):
        along = places[a] - places[b]
        direction = along / max(float(np.linalg.norm(along)), 1e-12)
        ends = np.stack([np.tensordot(direction, jacobian[end], axes=1) for end in (a, b)])
        yield POINTED_STD_PX * float(np.linalg.norm(ends))


def _leave(scale: FloatArray, covariance: FloatArray, slope: FloatArray, std: float) -> float:
    """Expanded relative uncertainty of a scale after a reading of which the change with the parameters is known [1]."""
    shared = float(scale @ covariance @ slope)
    variance = float(scale @ covariance @ scale) - shared**2 / (float(slope @ covariance @ slope) + std**2)
    return COVERAGE_FACTOR * float(np.sqrt(max(variance, 0.0)))


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
