"""Minima of the site adjustment: from one start, weighed as its relief shows, and the least of several starts."""

from collections.abc import Sequence
from itertools import takewhile

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import CameraError
from vfm_sdm.stages.cameras.site_problem import SiteProblem
from vfm_sdm.stages.cameras.whitening import OUTLIER

__all__ = ["minimize_from_starts", "minimize_residuals", "minimize_weighed"]

_WEAK_FOCAL_STD = 0.08
"""Relative standard deviation of a focal length from which its prior leaves room for several minima."""
_TRIAL_STEPS = 40
_FAR_COST = 25.0
"""Cost of matches, beyond twice the least, from which a start does not fit them."""
_SAME_MINIMUM = 1e-2
"""Largest distance of two solutions of one minimum [prior standard deviations]."""
_STARTS = (0.0, -1.0, 1.0, -2.0, 2.0)


def minimize_from_starts(problem: SiteProblem) -> OptimizeResult:
    """The least minimum from starts over the common focal length, where little is known of it.

    The problem is not convex, and a wrong focal length may be another minimum. Starts lie one and two standard
    deviations of the prior away.

    Parameters
    ----------
    problem
        The adjustment; its matches and relief are weighed as the solution shows.
    """
    common, std = problem.common_focal()
    offsets = _STARTS if std > _WEAK_FOCAL_STD else (0.0,)
    solved = [minimize_residuals(problem, offset * common, steps=_TRIAL_STEPS) for offset in offsets]
    # Without the face at first: points far from where they belong lead away from a start that does not fit the matches.
    limit = _FAR_COST + 2 * min(one.cost for one in solved)
    # Once only: loosened further and further, matches would agree with any reading.
    problem.weigh_matches(min(solved, key=lambda one: float(one.cost)).x)
    found = [minimize_weighed(problem, one.x) for one in solved if one.cost < limit and _is_new(one, solved)]
    solution, _ = min(found, key=lambda one: (not one[0].success, one[1]))
    return minimize_weighed(problem, solution.x)[0]


def _is_new(one: OptimizeResult, solved: Sequence[OptimizeResult]) -> bool:
    """Whether no earlier one is the same minimum."""
    return all(np.abs(one.x - other.x).max() > _SAME_MINIMUM for other in takewhile(lambda x: x is not one, solved))


def minimize_weighed(
    problem: SiteProblem,
    start: FloatArray,
    freed: FloatArray | None = None,
    *,
    steps: int = 100,
    tolerance: float = 1e-7,
) -> tuple[OptimizeResult, float]:
    """A minimum with relief weighed as it shows from its start, and its cost as it compares with others.

    Parameters
    ----------
    problem, start, freed, steps, tolerance
        As of `minimize_residuals`.
    """
    problem.weigh_relief(start)
    solution = minimize_residuals(problem, start, freed, steps=steps, tolerance=tolerance)
    return solution, 2 * float(solution.cost) + problem.log_spread()


def minimize_residuals(
    problem: SiteProblem,
    start: FloatArray,
    freed: FloatArray | None = None,
    *,
    steps: int = 100,
    tolerance: float = 1e-7,
) -> OptimizeResult:
    """Least-squares solution of the problem in whitened parameters.

    Parameters
    ----------
    problem
        The adjustment.
    start
        Whitened parameters, shape (M,) [1].
    freed
        Change of all R residuals with a claim that is not believed, shape (R, K) [1]; what lies along it costs nothing.
    steps
        Largest number of trial steps.
    tolerance
        Relative change of the cost, and of the parameters, at which it ends [1].
    """
    basis = np.empty((0, 0)) if freed is None else np.linalg.qr(freed)[0]
    outside = np.full(len(problem.residuals(start)), OUTLIER)

    def residuals(z: FloatArray) -> FloatArray:
        try:
            return _without(problem.residuals(z), basis)
        except CameraError:
            # A trial step may lead to where there is no camera, such as one of endless focal length: it is taken back.
            return outside

    def jacobian(z: FloatArray) -> FloatArray:
        return _without(problem.jacobian(z), basis)

    return least_squares(residuals, start, jac=jacobian, xtol=tolerance, ftol=tolerance, max_nfev=steps)


def _without(values: FloatArray, basis: FloatArray) -> FloatArray:
    """Residuals (R,) or their derivatives (R, M) without their part along a basis, shape (R, K); all without one."""
    return np.asarray(values - basis @ (basis.T @ values)) if basis.size else values
