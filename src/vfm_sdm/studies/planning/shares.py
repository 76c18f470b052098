"""Share of every source in the uncertainty of a planned measurement, by the derivatives of its variance."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.propagation import compute_gain_covariance, compute_gain_sensitivity
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.priors import CameraPriors
from vfm_sdm.stages.cameras.site import SiteAdjustment
from vfm_sdm.studies.planning.layout import Layout
from vfm_sdm.studies.planning.prediction import Prediction
from vfm_sdm.studies.planning.simulation import adjust, list_matches

__all__ = ["Share", "list_shares"]

_STEP = 1.005
"""Factor of a standard deviation with which the derivative by its logarithm is found."""
_OF_BUDGET = {
    "random": "noise of the tracks",
    "synchronization": "timing of the cameras",
    "assumption": "assumption of the refinement",
    "compression": "compression",
    "subset": "surroundings of the points",
    "origin": "noise at rest",
}
_OF_SITE = {
    "baseline": "baseline",
    "perpendicular_distance": "perpendicular distance",
    "longitudinal_distance": "longitudinal distance",
    "reference_camera_level": "level",
}
_PLACES = "matched places of the points"


@dataclass(frozen=True)
class Share:
    """Share of a source in the variance of the points of the structure, along the axes that move.

    Parameters
    ----------
    source
        Its name.
    share
        Part of the variance [1]; the shares of all sources add up to one.
    """

    source: str
    share: float


def list_shares(prediction: Prediction) -> list[Share]:
    """Shares of all sources, the largest first.

    Parameters
    ----------
    prediction
        Of `vfm_sdm.studies.planning.prediction.predict`.

    Notes
    -----
    The adjustment weighs every observation by its variance ``s_i^2``, so that the variance V of any result is the least
    one: its change with a weight is zero, and its change with the variance of an observation is that observation's part
    alone. V doubles when all variances double; by Euler's theorem ``V = sum_i s_i^2 dV / ds_i^2``. The share of source
    i is therefore the derivative of ``log V`` by ``log s_i^2``, found by adjusting once more with a standard deviation
    that is half a percent larger: for any kind of observation, and through no formula of its own.
    """
    laid, displacement = prediction.laid, prediction.displacement
    motions = _second_moments(prediction)
    base = _gain_variances(laid, prediction.adjusted, motions)
    relative, weights = _weigh(prediction), {}
    total = sum(weight * one.expanded_mm**2 / 4 for weight, one in zip(relative, prediction.axes, strict=True))
    points = [point.name for point in laid.plan.moving]
    axes = [str(axis) for axis in displacement["axis"].values]
    factors = np.zeros((len(points), len(axes)))
    for weight, one in zip(relative, prediction.axes, strict=True):
        factors[points.index(one.point), axes.index(one.axis)] = weight
    for source, wider in _list_sources(laid):
        changed = _gain_variances(laid, wider, motions)
        weights[source] = float(np.sum(factors * (changed - base)) / (_STEP**2 - 1))
    cameras = sum(weight * one.budget_mm["cameras"] ** 2 for weight, one in zip(relative, prediction.axes, strict=True))
    weights[_PLACES] = cameras - float(np.sum(factors * base))
    for component, name in _OF_BUDGET.items():
        weights[name] = sum(
            weight * one.budget_mm[component] ** 2 for weight, one in zip(relative, prediction.axes, strict=True)
        )
    shares = [Share(name, max(value, 0.0) / total) for name, value in weights.items()]
    return sorted(shares, key=lambda one: -one.share)


def _weigh(prediction: Prediction) -> list[float]:
    """Weight of the variance of each point and axis: one over the squared amplitude; 0 along axes that do not move."""
    expected = prediction.laid.plan.motion.by_axis
    by_name = {str(axis): one.amplitude_mm for axis, one in expected.items()}
    return [by_name[one.axis] ** -2 if one.axis in by_name else 0.0 for one in prediction.axes]


def _second_moments(prediction: Prediction) -> FloatArray:
    """Mean of the products of the true motion along the axes, of every moving point, shape (P, 3, 3) [mm2]."""
    laid = prediction.laid
    time_s = prediction.displacement["time"].values
    moves = time_s >= laid.plan.still_s + laid.motion.onset_s
    motion = 1e3 * laid.motion.displacement(time_s[moves], laid.points3d[~laid.static])
    return np.asarray(np.einsum("tpa,tpb->pab", motion, motion) / len(motion))


def _gain_variances(laid: Layout, adjusted: SiteAdjustment, motions: FloatArray) -> FloatArray:
    """Variance from the cameras of moving points along each axis, mean over time, shape (P, 3) [mm2]."""
    pixels = laid.pixels[:, ~laid.static]
    visible = laid.visible()[:, ~laid.static]
    sensitivity = compute_gain_sensitivity(np.where(visible[..., None], pixels, np.nan), laid.rig)
    gains = compute_gain_covariance(sensitivity, laid.structure_from_cam1, adjusted.covariance)
    return np.asarray(np.einsum("pabc,pbc->pa", gains, motions))


def _list_sources(laid: Layout) -> Iterator[tuple[str, SiteAdjustment]]:
    """Everything that the adjustment knows with a standard deviation, and the adjustment where it is wider."""
    matches = list_matches(laid)
    for parameters, name in (((0,), "focal lengths"), ((1, 2, 3), "centres and distortion of the lenses")):
        yield name, adjust(laid, matches, priors=_loosen(laid.priors, parameters))
    yield "matches", adjust(laid, list_matches(laid, wider=_STEP))
    yield "pixels of the points", adjust(laid, matches, pointed=_STEP)
    for name, session in _list_wider(laid.session):
        yield name, adjust(replace(laid, session=session), matches)


def _loosen(priors: CameraPriors, parameters: Sequence[int]) -> CameraPriors:
    """Priors with larger standard deviations of some parameters of every lens."""
    scale = np.ones(4)
    scale[list(parameters)] = _STEP
    return replace(priors, intrinsics_covariance=priors.intrinsics_covariance * np.outer(scale, scale))


def _list_wider(session: Session) -> Iterator[tuple[str, Session]]:
    """Readings on site by name, with the session in which each has a larger standard deviation."""
    site = session.site
    for field, name in _OF_SITE.items():
        if (reading := getattr(site, field)) is not None:
            yield name, _with_site(session, {field: _wider(reading)})
    yield "points off the face", _with_site(session, {"face_offset_std": _STEP * site.face_offset_std})
    for number, ranged in enumerate(site.range):
        name = f"range {ranged.view or session.view[0].name} to {ranged.point}"
        yield name, _with_site(session, {"range": _wider_at(site.range, number)})
    for number, length in enumerate(site.length):
        yield f"length {' to '.join(length.points)}", _with_site(session, {"length": _wider_at(site.length, number)})
    for number, view in enumerate(session.view[1:], start=1):
        for key in ("level", "perpendicular_distance", "longitudinal_distance"):
            if (reading := getattr(view, key)) is not None:
                views = list(session.view)
                views[number] = view.model_copy(update={key: _wider(reading)})
                yield f"{key.replace('_', ' ')} {view.name}", session.model_copy(update={"view": tuple(views)})


def _wider(reading: Any) -> Any:
    """A reading with a larger standard deviation."""
    field = "std_deg" if hasattr(reading, "std_deg") else "std"
    return reading.model_copy(update={field: _STEP * getattr(reading, field)})


def _wider_at(readings: Sequence[Any], number: int) -> tuple[Any, ...]:
    return tuple(_wider(one) if index == number else one for index, one in enumerate(readings))


def _with_site(session: Session, update: dict[str, Any]) -> Session:
    return session.model_copy(update={"site": session.site.model_copy(update=update)})
