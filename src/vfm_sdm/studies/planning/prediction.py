"""What a planned measurement will be worth: expanded uncertainty and detection limit of every point and axis."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.outputs.results import summarize_displacement
from vfm_sdm.stages.cameras.site import SiteAdjustment
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR
from vfm_sdm.studies.planning.layout import ONSET_S, Layout, check_seen, lay_out
from vfm_sdm.studies.planning.plan import Plan
from vfm_sdm.studies.planning.simulation import adjust, list_matches, measure_exactly, simulate_tracks

__all__ = ["AxisUncertainty", "Prediction", "predict", "state_axes"]


@dataclass(frozen=True)
class AxisUncertainty:
    """What a measurement says of one point along one axis.

    Parameters
    ----------
    point, axis
        Of which point, along which axis.
    amplitude_mm
        Root mean square of the motion times the square root of two [mm]: the amplitude of a sinusoid.
    expanded_mm
        Expanded uncertainty (k = 2) of a sample while the structure moves, root mean square over time [mm].
    detection_mm
        Smallest amplitude of a sinusoid that is told from the random part over the recording [mm].
    scale_std
        Relative standard deviation of the scale [1].
    budget_mm
        Root mean square over time of each component (k = 1) [mm].
    """

    point: str
    axis: str
    amplitude_mm: float
    expanded_mm: float
    detection_mm: float
    scale_std: float
    budget_mm: dict[str, float]


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a plan will be worth.

    Parameters
    ----------
    laid
        The plan's geometry.
    adjusted
        Cameras and axes as the site adjustment will know them.
    displacement
        Displacement with its budget, shape (T, P, 3) [mm].
    axes
        One for every point of the structure and axis.
    """

    laid: Layout
    adjusted: SiteAdjustment
    displacement: xr.Dataset
    axes: tuple[AxisUncertainty, ...]

    @property
    def relative(self) -> float:
        """Expanded uncertainty over the expected amplitude at the middle of the span, over points and moving axes [1].

        The root mean square; what positions and further readings are compared by.
        """
        expected = self.laid.plan.motion.by_axis
        shares = [
            one.expanded_mm / expected[axis].amplitude_mm for one in self.axes for axis in expected if axis == one.axis
        ]
        return float(np.sqrt(np.mean(np.square(shares))))


def predict(plan: Plan | Layout) -> Prediction:
    """Expanded uncertainty of a planned measurement, by the program's own adjustment, triangulation and budget.

    Parameters
    ----------
    plan
        The plan, or its geometry.

    Raises
    ------
    SessionError
        Two cameras do not see every point of the structure.

    Notes
    -----
    Matches and readings are exact, and have the standard deviations that they will have: the adjustment starts and ends
    at the truth, and its covariance is that of the real one (first order, GUM). Tracks are the expected motion with
    noise as predicted, so that synchronisation and the budget find what they will find.

    References
    ----------
    .. [1] JCGM 100:2008. Evaluation of measurement data: guide to the expression of uncertainty in measurement (GUM).
    """
    laid = lay_out(plan) if isinstance(plan, Plan) else plan
    check_seen(laid)
    adjusted = adjust(laid, list_matches(laid))
    displacement = measure_exactly(laid, adjusted, simulate_tracks(laid))
    moving = [point.name for point in laid.plan.moving]
    return Prediction(laid, adjusted, displacement, state_axes(displacement, moving, laid.plan.still_s))


def state_axes(displacement: xr.Dataset, points: list[str], still_s: float) -> tuple[AxisUncertainty, ...]:
    """What a measurement says of points, in the figures of a prediction.

    Parameters
    ----------
    displacement
        Dataset with its budget, shape (T, P, 3) [mm].
    points
        Names of points.
    still_s
        End of the interval at rest [s].
    """
    summary = summarize_displacement(displacement.sel(point=points))
    moves = displacement["time"].values >= still_s + ONSET_S
    found = []
    for point in points:
        for axis, figures in summary[point]["axes"].items():
            one = displacement.sel(point=point, axis=axis).isel(time=moves)
            ok = one["status"].values == Status.OK
            found.append(
                AxisUncertainty(
                    point,
                    axis,
                    float(np.sqrt(2)) * _rms(one["displacement"].values[ok]),
                    COVERAGE_FACTOR * _rms(one["combined_std"].values[ok]),
                    _known(figures["detection_limit_mm"]),
                    _known(figures["scale_std"]),
                    {
                        str(name): _rms(one["uncertainty"].sel(component=name).values[ok])
                        for name in one["component"].values
                    },
                )
            )
    return tuple(found)


def _known(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
