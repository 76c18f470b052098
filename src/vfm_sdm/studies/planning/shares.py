"""Share of every source in the uncertainty of a planned measurement."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.propagation import compute_gain_covariance, compute_gain_sensitivity
from vfm_sdm.studies.planning.layout import Layout
from vfm_sdm.studies.planning.prediction import Prediction

__all__ = ["Share", "list_shares"]

_OF_BUDGET = {
    "random": "noise of the tracks",
    "synchronization": "timing of the cameras",
    "assumption": "assumption of the refinement",
    "compression": "compression",
    "subset": "surroundings of the points",
    "origin": "noise at rest",
}
_OF_ADJUSTMENT = {
    "focal ": "focal lengths",
    "principal point ": "centres and distortion of the lenses",
    "pitch reference": "level",
    "roll reference": "level",
}
"""Sources of the adjustment that a plan takes together, by what their names begin with."""
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
    What the cameras owe to every statement and observation is told by the adjustment itself
    (`vfm_sdm.stages.cameras.contributions`), what the tracks add by the budget of displacement.
    """
    laid, displacement = prediction.laid, prediction.displacement
    motions = _second_moments(prediction)
    relative, weights = _weigh(prediction), defaultdict[str, float](float)
    total = sum(weight * one.expanded_mm**2 / 4 for weight, one in zip(relative, prediction.axes, strict=True))
    points = [point.name for point in laid.plan.moving]
    axes = [str(axis) for axis in displacement["axis"].values]
    factors = np.zeros((len(points), len(axes)))
    for weight, one in zip(relative, prediction.axes, strict=True):
        factors[points.index(one.point), axes.index(one.axis)] = weight
    for part in prediction.adjusted.contributions:
        weights[_name(part.source)] += float(np.sum(factors * _gain_variances(laid, part.covariance, motions)))
    of_gain = sum(weights.values())
    cameras = sum(weight * one.budget_mm["cameras"] ** 2 for weight, one in zip(relative, prediction.axes, strict=True))
    weights[_PLACES] = cameras - of_gain
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


def _name(source: str) -> str:
    """What a plan calls a source of the adjustment."""
    return next((name for begin, name in _OF_ADJUSTMENT.items() if source.startswith(begin)), source)


def _gain_variances(laid: Layout, covariance: FloatArray, motions: FloatArray) -> FloatArray:
    """Variance by a covariance of the cameras, of moving points along each axis, mean over time, (P, 3) [mm2]."""
    pixels = laid.pixels[:, ~laid.static]
    visible = laid.visible()[:, ~laid.static]
    sensitivity = compute_gain_sensitivity(np.where(visible[..., None], pixels, np.nan), laid.rig)
    gains = compute_gain_covariance(sensitivity, laid.structure_from_cam1, covariance)
    return np.asarray(np.einsum("pabc,pbc->pa", gains, motions))
