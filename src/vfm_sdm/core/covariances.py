"""Standard deviations that judge a point of a track from the covariance of its position."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["judged_std", "largest_std"]


def largest_std(covariance: FloatArray) -> FloatArray:
    """Standard deviation in the worst direction.

    Parameters
    ----------
    covariance
        Covariances, shape (..., 2, 2) [px2].

    Returns
    -------
    std
        Shape (...) [px].

    Examples
    --------
    >>> largest_std(np.diag([0.01, 0.04])).item()
    0.2
    """
    xx, yy, xy = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    return np.asarray(np.sqrt((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)))


def judged_std(covariance: FloatArray, across: FloatArray) -> FloatArray:
    """Standard deviation by which a point is judged: across an edge where it is one, else in the worst direction.

    Parameters
    ----------
    covariance
        Covariances of P points, shape (..., P, 2, 2) [px2].
    across
        Unit vectors across their edges, shape (P, 2) [1]; NaN for points that are none.

    Returns
    -------
    std
        Shape (..., P) [px].

    Examples
    --------
    >>> post = np.diag([0.01, 1e6])
    >>> judged_std(np.stack([post, post]), np.array([[1.0, 0.0], [np.nan, np.nan]])).tolist()
    [0.1, 1000.0]
    """
    edge = np.isfinite(across).all(axis=-1)
    if not edge.any():
        return largest_std(covariance)
    variance = np.einsum("pi,...pij,pj->...p", across, covariance, across)
    return np.where(edge, np.sqrt(np.maximum(variance, 0.0)), largest_std(covariance))
