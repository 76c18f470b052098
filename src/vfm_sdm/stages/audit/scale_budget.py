"""What the scale rests on: the share of every source in its uncertainty, and what to measure next."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, step_parameters, triangulation_jacobian
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.cameras.contributions import share_variance
from vfm_sdm.stages.cameras.site_values import POINTED_STD_PX
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

if TYPE_CHECKING:
    from vfm_sdm.stages.audit.model import AuditInputs

__all__ = ["Reading", "ScaleBudget", "list_slopes", "say_percent", "weigh_scale"]

_LENGTH_STD_M, _RANGE_STD_M = 0.005, 0.005
"""What a tape between two marks, and a laser from a tripod, are good for [m]."""
_LENS_STD = 0.003
"""Relative standard deviation of a focal length that was calibrated [1]."""
_MOST_MARKS = 12
"""Points between which lengths are thought of: of more, those that lie farthest apart."""


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


@dataclass(frozen=True)
class ScaleBudget:
    """How well the scale of the worst point and axis is known, by what, and what would tell it better.

    Parameters
    ----------
    point, axis
        Point and axis whose scale is known least.
    expanded
        Expanded relative uncertainty (k = 2) of its scale [1].
    shares
        Share of every source in the variance of the scale [1], the largest first; they add up to one. Empty where
        the cameras come from elsewhere.
    readings
        What could still be measured, the most helpful first; empty where the uncertainty of the cameras, or the point's
        place, is not known.
    """

    point: str
    axis: str
    expanded: float
    shares: dict[str, float]
    readings: tuple[Reading, ...]

    def as_table(self) -> dict[str, Any]:
        """For ``summary.json``."""
        return {
            "point": self.point,
            "axis": self.axis,
            "expanded_uncertainty": self.expanded,
            "shares": self.shares,
            "measure_next": [{"reading": one.sentence, "leaves": one.left} for one in self.readings],
        }


def weigh_scale(inputs: "AuditInputs") -> ScaleBudget | None:
    """The scale's uncertainty of the worst point and axis; ``None`` where nobody knows it.

    Parameters
    ----------
    inputs
        Session, cameras and displacement.

    Notes
    -----
    A reading h with standard deviation r turns the covariance C of the cameras into C - C h h' C / (h' C h + r^2), of
    which the scale's share is seen before anybody drives back. Readings are lengths between points, ranges from the
    first camera, the baseline and every lens.
    """
    worst = _find_worst(inputs)
    if worst is None:
        return None
    point, axis, expanded = worst
    cameras, scales = inputs.cameras, list_slopes(inputs, point)
    if cameras.rig is None or cameras.covariance is None or not scales:
        return ScaleBudget(point, axis, expanded, {}, ())
    covariance, size = cameras.covariance, len(cameras.covariance)
    names, pixels = _list_places(inputs, cameras.rig)
    marks = _choose_marks(pixels[0], names.index(point))
    left = []
    for words, slope, std in _propose(cameras.rig, [names[n] for n in marks], pixels[:, marks]):
        padded = np.pad(slope, (0, size - len(slope)))
        left.append(Reading(words, max(_leave(one, covariance, padded, std) for one in scales.values())))
    shares = share_variance(cameras.contributions, covariance, scales[axis])
    return ScaleBudget(point, axis, expanded, shares, tuple(sorted(left, key=lambda one: one.left)))


def list_slopes(inputs: "AuditInputs", point: str) -> dict[str, FloatArray]:
    """Change of a point's scale along every axis that is judged with parameters of cameras and axes, (10 V + 3,) each.

    Parameters
    ----------
    inputs
        Session, cameras and displacement.
    point
        Name of the point.

    Returns
    -------
    slopes
        By axis; empty where the uncertainty of the cameras, or the point's place, is not known.
    """
    cameras = inputs.cameras
    if cameras.rig is None or cameras.covariance is None:
        return {}
    names, pixels = _list_places(inputs, cameras.rig)
    if point not in names:
        return {}
    rotation = np.eye(3) if cameras.frame is None else cameras.frame.rotation
    axes = [str(a) for a in inputs.displacement["axis"].values]
    places = pixels[:, names.index(point)]
    return {axis: _differentiate_scale(cameras.rig, places, rotation[axes.index(axis)]) for axis in inputs.judged_axes}


def _find_worst(inputs: "AuditInputs") -> tuple[str, str, float] | None:
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


def _choose_marks(pixels: FloatArray, first: int) -> list[int]:
    """Indices of points far from each other, from pixels (P, 2) [px], beginning with one of them."""
    chosen = [first]
    away = np.linalg.norm(pixels - pixels[first], axis=1)
    while len(chosen) < min(_MOST_MARKS, len(pixels)):
        chosen.append(int(np.argmax(away)))
        away = np.fmin(away, np.linalg.norm(pixels - pixels[chosen[-1]], axis=1))
    return sorted(chosen)


def _list_places(inputs: "AuditInputs", rig: Rig) -> tuple[list[str], FloatArray]:
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
    ends = list(combinations(names, 2))
    tape_mm, laser_mm = 1e3 * _LENGTH_STD_M, 1e3 * _RANGE_STD_M
    words = [
        f"a length of {value:.1f} m between {a!r} and {b!r} known to {tape_mm:.0f} mm"
        for value, (a, b) in zip(here, ends, strict=False)
    ]
    words += [
        f"a range of {value:.1f} m from the camera of {rig.names[0]!r} to {name!r} known to {laser_mm:.0f} mm"
        for value, name in zip(here[len(ends) :], names, strict=False)
    ]
    words.append(f"a baseline of {here[-1]:.2f} m known to {tape_mm:.0f} mm")
    tools = [_LENGTH_STD_M] * len(ends) + [_RANGE_STD_M] * len(names) + [_LENGTH_STD_M]
    for text, value, slope, tool, mark in zip(words, here, slopes, tools, marks, strict=True):
        if np.isfinite(value) and np.isfinite(slope).all():
            yield text, slope, float(np.hypot(tool, mark))
    size = len(CAMERA_PARAMETERS)
    for number, name in enumerate(rig.names):
        one = np.zeros(size * len(rig))
        one[size * number] = 1.0
        yield f"a calibration of the lens of {name!r} to {say_percent(_LENS_STD)}", one, _LENS_STD


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


def say_percent(share: float) -> str:
    """A share in words.

    Parameters
    ----------
    share
        Share [1].

    Examples
    --------
    >>> say_percent(0.0123)
    '1.2 %'
    """
    return f"{100 * share:.2g} %"
