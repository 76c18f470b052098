"""Best places of the cameras within an area: least uncertainty, with every point in view and the face not grazed."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import SessionError
from vfm_sdm.studies.planning.layout import Layout, try_lay_out
from vfm_sdm.studies.planning.plan import Area, Plan
from vfm_sdm.studies.planning.prediction import Prediction, predict

__all__ = ["Positions", "optimise_positions"]

_SHORT_S = 3.0
"""Length of the motion by which places are compared [s]."""
_GRAZING_DEG = 70.0
"""Largest angle between a line of sight and the normal of the face: beyond it, texture is seen a third as wide."""
_WIDEST_DEG = 60.0
"""Largest angle between two lines of sight to a point: beyond it, two pictures of a surface hardly match."""
_UNSEEN = 100.0
_SEED = 14


@dataclass(frozen=True, eq=False)
class Positions:
    """Best places that were found.

    Parameters
    ----------
    plan
        The plan with the cameras at these places.
    prediction
        Of that plan.
    left
        Relative uncertainty that it leaves, over that of the given places [1].
    tried
        Number of places that were predicted.
    """

    plan: Plan
    prediction: Prediction
    left: float
    tried: int


def optimise_positions(
    given: Prediction, area: Area, *, starts: int = 32, steps: int = 40, progress: Progress | None = None
) -> Positions:
    """Places of all cameras within an area that leave least uncertainty.

    Parameters
    ----------
    given
        Prediction of the plan as it is; heights, lenses and readings stay.
    area
        Where cameras may stand.
    starts
        Number of places all over the area, a power of two, of which those that see the points are predicted.
    steps
        Largest number of places that are tried from the best of them.
    progress
        Called with the number of places that were tried.

    Raises
    ------
    SessionError
        Nowhere in the area do all cameras see the points.

    Notes
    -----
    Places of a Sobol sequence over the area are predicted, and from the best of them the simplex of Nelder and Mead
    goes on. Cameras look at the middle of the points, or where the plan says. Allowed is what sees the points that were
    seen from the given places, no line of sight more than 70 degrees off the face's normal, and no two more than 60
    degrees apart.

    References
    ----------
    .. [1] Nelder, J. A., Mead, R. (1965). A simplex method for function minimization. Computer Journal 7(4), 308-313.
    """
    search = _Search(given, progress)
    cameras = len(given.laid.plan.camera)
    low, high = np.tile(np.array([area.perpendicular_m, area.longitudinal_m]), (cameras, 1)).T
    tried = low + qmc.Sobol(2 * cameras, seed=_SEED).random(starts) * (high - low)
    here = np.array([one.place[:2] for one in given.laid.plan.camera]).ravel()
    if ((here >= low) & (here <= high)).all():
        tried = np.concatenate([here[None], tried])
    costs = [search.cost(one) for one in tried]
    if min(costs) >= _UNSEEN:
        raise SessionError(
            f"area: expected places from which every camera sees the points, got none of {len(tried)} tried; "
            "enlarge it, or take shorter lenses"
        )
    found = minimize(
        search.cost,
        tried[int(np.argmin(costs))],
        method="Nelder-Mead",
        bounds=list(zip(low.tolist(), high.tolist(), strict=True)),
        options={"maxfev": steps, "xatol": 0.02, "fatol": 1e-3},
    )
    rounded = np.clip(np.round(found.x, 2), low, high)
    best = rounded if search.cost(rounded) <= min(costs) else tried[int(np.argmin(costs))]
    prediction = predict(search.place(best))
    return Positions(search.place(best), prediction, prediction.relative / given.relative, search.tried)


class _Search:
    """Costs of places, each by the prediction of a short recording."""

    def __init__(self, given: Prediction, progress: Progress | None) -> None:
        self._plan, self._progress = given.laid.plan, progress
        self._seen = given.laid.visible()
        self.tried = 0
        clock_std = np.nanmax(given.displacement["clock_offset_std"].values)
        plan = self._plan
        self._short = {
            "duration_s": min(plan.duration_s, plan.still_s + _SHORT_S),
            "synchronization": "none",
            "time_offset_std_s": max(float(clock_std), 1e-9),
        }

    def place(self, at: FloatArray) -> Plan:
        """The plan with its cameras at perpendicular and longitudinal places, shape (2 V,) [m]."""
        cameras = tuple(
            one.model_copy(update={"perpendicular_m": float(place[0]), "longitudinal_m": float(place[1])})
            for one, place in zip(self._plan.camera, at.reshape(-1, 2), strict=True)
        )
        return self._plan.model_copy(update={"camera": cameras})

    def cost(self, at: FloatArray) -> float:
        """Logarithm of the relative uncertainty; large where the points are not seen."""
        laid = try_lay_out(self.place(at).model_copy(update=self._short))
        if laid is None:
            return 2 * _UNSEEN
        if not _is_allowed(laid, self._seen):
            return _UNSEEN
        self.tried += 1
        if self._progress is not None:
            self._progress("places of the cameras", self.tried, None)
        return float(np.log(predict(laid).relative))


def _is_allowed(laid: Layout, seen: BoolArray) -> bool:
    """Whether what was seen is still seen, the face is not grazed, and pictures are alike enough to be matched."""
    if (seen & ~laid.visible()).any():
        return False
    moving = laid.points3d[~laid.static]
    rays = np.stack([moving - camera.center for camera in laid.cameras])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    if (rays[..., 0] < np.cos(np.radians(_GRAZING_DEG))).any():
        return False
    apart = np.einsum("vpi,wpi->vwp", rays, rays)
    return bool((apart >= np.cos(np.radians(_WIDEST_DEG))).all())
