"""Distortion of a lens with the five coefficients of Brown and Conrady, its derivative and its inverse."""

from functools import lru_cache

import numpy as np
from numba import njit

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.compiled import cached_by_code

__all__ = ["distort", "distort_derivative", "squared_fold_radius", "undistort"]

_UNDISTORT_ITERATIONS = 20
_UNDISTORTED, _CONVERGED = 1e-13, 1e-9
"""Step below which Newton's method ends, and error from which on it has not found the point [1]."""
_NO_DISTORTION = 1e-12
"""Coefficients below this move no pixel; their polynomial's roots would overflow."""


def distort(normalized: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Distorted normalised coordinates.

    Parameters
    ----------
    normalized
        Coordinates (x/z, y/z) in the camera's axes, shape (..., 2) [1].
    coefficients
        k1, k2, p1, p2, k3 in OpenCV's order, shape (5,) [1].

    Returns
    -------
    distorted
        Shape (..., 2) [1].

    Notes
    -----
    With ``r2 = x^2 + y^2`` and ``c = 1 + k1 r2 + k2 r2^2 + k3 r2^3``:
    ``x' = c x + 2 p1 x y + p2 (r2 + 2 x^2)`` and ``y' = c y + p1 (r2 + 2 y^2) + 2 p2 x y``.

    References
    ----------
    .. [1] Brown, D. C. (1971). Close-range camera calibration. Photogrammetric Engineering 37(8), 855-866.

    Examples
    --------
    >>> distort(np.array([0.5, 0.0]), np.array([-0.2, 0.0, 0.0, 0.0, 0.0])).round(6).tolist()
    [0.475, 0.0]
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = normalized[..., 0], normalized[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def distort_derivative(normalized: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Derivative of `distort` by the undistorted coordinates.

    Parameters
    ----------
    normalized
        Undistorted coordinates (x/z, y/z), shape (..., 2) [1].
    coefficients
        k1, k2, p1, p2, k3 in OpenCV's order, shape (5,) [1].

    Returns
    -------
    derivative
        Shape (..., 2, 2) [1]; it is symmetric.

    Examples
    --------
    >>> distort_derivative(np.array([0.5, 0.0]), np.array([-0.2, 0.0, 0.0, 0.0, 0.0])).round(6).tolist()
    [[0.85, 0.0], [0.0, 0.95]]
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = normalized[..., 0], normalized[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def undistort(distorted: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Inverse of `distort`, by Newton's method.

    Parameters
    ----------
    distorted
        Distorted coordinates (x/z, y/z), shape (..., 2) [1].
    coefficients
        k1, k2, p1, p2, k3 in OpenCV's order, shape (5,) [1].

    Returns
    -------
    normalized
        Shape (..., 2) [1]; NaN where no solution is found, outside the field that the coefficients describe.

    Examples
    --------
    >>> undistort(np.array([0.475, 0.0]), np.array([-0.2, 0.0, 0.0, 0.0, 0.0])).round(6).tolist()
    [0.5, 0.0]
    """
    if not np.any(coefficients):
        return distorted.copy()
    k1, k2, _, _, k3 = np.asarray(coefficients, np.float64).tolist()
    wanted = np.ascontiguousarray(distorted, dtype=np.float64)
    found = _invert(wanted.reshape(-1, 2), np.asarray(coefficients, np.float64), _known_fold_radius(k1, k2, k3))
    return np.asarray(found.reshape(wanted.shape))


@njit(nogil=True, cache=True, error_model="numpy")
@cached_by_code
def _invert(wanted: FloatArray, coefficients: FloatArray, fold: float) -> FloatArray:  # pragma: no cover - compiled
    """Newton's method for each point (N, 2), with `distort` and `distort_derivative`, which share their terms."""
    k1, k2, p1, p2, k3 = coefficients
    found = np.empty_like(wanted)
    for index in range(len(wanted)):
        wanted_x, wanted_y = wanted[index]
        x, y = wanted_x, wanted_y
        last = np.inf
        for iteration in range(_UNDISTORT_ITERATIONS + 1):
            xx, yy, xy = x * x, y * y, x * y
            r2 = xx + yy
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            error_x = x * radial + 2 * p1 * xy + p2 * (r2 + 2 * xx) - wanted_x
            error_y = y * radial + p1 * (r2 + 2 * yy) + 2 * p2 * xy - wanted_y
            if iteration == _UNDISTORT_ITERATIONS or last < _UNDISTORTED:
                break
            slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
            jxx = radial + slope * xx + 2 * p1 * y + 6 * p2 * x
            jxy = slope * xy + 2 * p1 * x + 2 * p2 * y
            jyy = radial + slope * yy + 6 * p1 * y + 2 * p2 * x
            determinant = jxx * jyy - jxy * jxy
            step_x = (jyy * error_x - jxy * error_y) / determinant
            step_y = (jxx * error_y - jxy * error_x) / determinant
            x, y = x - step_x, y - step_y
            last = max(abs(step_x), abs(step_y))
        # Beyond the fold the polynomial turns back, and Newton may land on a mirrored branch that fits equally well.
        sound = r2 < fold and max(abs(error_x), abs(error_y)) < _CONVERGED
        found[index, 0] = x if sound else np.nan
        found[index, 1] = y if sound else np.nan
    return found


@lru_cache(maxsize=256)
def _known_fold_radius(k1: float, k2: float, k3: float) -> float:
    return squared_fold_radius(np.array([k1, k2, 0.0, 0.0, k3]))


def squared_fold_radius(coefficients: FloatArray) -> float:
    """Squared normalised radius at which the radial polynomial stops growing; infinite where it never does.

    Parameters
    ----------
    coefficients
        k1, k2, p1, p2, k3 in OpenCV's order, shape (5,) [1].

    Notes
    -----
    The smallest positive root, in r^2, of ``1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6``.

    Examples
    --------
    >>> round(squared_fold_radius(np.array([-0.2, 0.0, 0.0, 0.0, 0.0])), 6)
    1.666667
    """
    k1, k2, _, _, k3 = coefficients
    slopes = np.array([7 * k3, 5 * k2, 3 * k1, 1.0])  # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6), in r^2
    slopes[np.abs(slopes) < _NO_DISTORTION] = 0.0
    if not slopes[:3].any():
        return np.inf
    roots = np.roots(slopes)
    folds = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return float(folds.min(initial=np.inf))
