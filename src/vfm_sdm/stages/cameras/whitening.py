"""Whitened parameters and robust residuals of the site adjustment, and their derivatives."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import cholesky

from vfm_sdm.core.arrays import FloatArray

__all__ = ["OUTLIER", "ROBUST_STD", "bend", "differentiate", "differentiate_centrally", "factor_prior"]

ROBUST_STD = 3.0
"""Residual over its standard deviation from which the loss grows linearly [1]."""
OUTLIER = 1e3
"""Residual of what has no value [standard deviations]."""


def bend(scaled: FloatArray) -> FloatArray:
    """Residuals with the pseudo-Huber loss: quadratic near zero, linear beyond three standard deviations.

    A trial step may change the distortion so much that a pixel has no ray: it counts as a gross outlier.

    Parameters
    ----------
    scaled
        Residuals over their standard deviations, any shape [1].
    """
    known = np.where(np.isfinite(scaled), scaled, OUTLIER)
    reach = ROBUST_STD**2
    return np.asarray(np.sign(known) * np.sqrt(2 * reach * (np.sqrt(1 + known**2 / reach) - 1)))


def differentiate(function: Callable[[FloatArray], FloatArray], z: FloatArray, count: int) -> FloatArray:
    """Derivative with respect to the first ``count`` parameters by forward differences, shape (residuals, count).

    The step is small because priors of the pose are wide: with a step of a millionth of them the curvature of the
    residuals would end the iterations too early.

    Parameters
    ----------
    function
        From parameters (M,) to residuals (R,) [1].
    z
        Parameters, shape (M,) [1].
    count
        Number of parameters that move the residuals.
    """
    step = 1e-8
    base = function(z)
    columns = [np.empty((base.size, 0))]
    for index in range(count):
        shift = np.zeros_like(z)
        shift[index] = step
        columns.append((function(z + shift) - base)[:, None] / step)
    return np.concatenate(columns, axis=1)


def differentiate_centrally(function: Callable[[FloatArray], FloatArray], z: FloatArray, count: int) -> FloatArray:
    """Derivative of residuals that include a triangulation, whose rounding errors need a longer step.

    Central differences, shape (residuals, count).

    Parameters
    ----------
    function
        From parameters (M,) to residuals (R,) [1].
    z
        Parameters, shape (M,) [1].
    count
        Number of parameters that move the residuals.
    """
    step = 1e-6
    return np.stack(
        [(function(z + shift) - function(z - shift)) / (2 * step) for shift in step * np.eye(z.size)[:count]], axis=1
    )


def factor_prior(covariance: FloatArray) -> FloatArray:
    """Factor L with ``covariance = L L^T``, without the columns of parameters that are held fixed.

    Parameters
    ----------
    covariance
        Covariance of N parameters, shape (N, N), in their units.
    """
    free = np.flatnonzero(np.diag(covariance) > 0)
    factor = np.zeros((covariance.shape[0], free.size))
    if free.size:
        scale = np.sqrt(np.diag(covariance)[free])
        correlation = covariance[np.ix_(free, free)] / np.outer(scale, scale)
        # A prior that comes from an earlier adjustment may be singular to rounding.
        lower = cholesky(correlation + 1e-12 * np.eye(free.size), lower=True)
        factor[free] = scale[:, None] * lower
    return factor
