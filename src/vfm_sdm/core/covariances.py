"""What the covariance of a point's position says about the directions in which it is measured."""

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, time_blocks

__all__ = [
    "edges_across",
    "find_edges",
    "is_covariance",
    "judged_std",
    "largest_std",
    "measured_axes",
    "measured_variance",
    "raise_variance",
]


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


def measured_axes(across: FloatArray) -> FloatArray:
    """Directions in which points are judged one by one: u and v, or across an edge and along it.

    Parameters
    ----------
    across
        Unit vectors across edges, shape (..., 2) [1]; NaN for points that are none.

    Returns
    -------
    axes
        Unit vectors as rows, shape (..., 2, 2) [1].

    Examples
    --------
    >>> measured_axes(np.array([[0.6, 0.8], [np.nan, np.nan]])).tolist()
    [[[0.6, 0.8], [-0.8, 0.6]], [[1.0, 0.0], [0.0, 1.0]]]
    """
    turned = np.stack([across, np.stack([-across[..., 1], across[..., 0]], axis=-1)], axis=-2)
    return np.where(np.isfinite(turned), turned, np.eye(2))


def measured_variance(covariance: FloatArray, across: FloatArray) -> FloatArray:
    """Variance of all that is measured: across an edge where a point is one, else of u and v together.

    Parameters
    ----------
    covariance, across
        As in `judged_std`.

    Returns
    -------
    variance
        Shape (..., P) [px2].

    Examples
    --------
    >>> measured_variance(np.diag([0.01, 0.03])[None], np.full((1, 2), np.nan)).round(6).tolist()
    [0.04]
    """
    both = np.einsum("...pii->...p", covariance)
    edge = np.isfinite(across).all(axis=-1)
    return np.where(edge, judged_std(covariance, across) ** 2, both) if edge.any() else np.asarray(both)


def edges_across(tracks: xr.Dataset) -> FloatArray:
    """Unit vectors across the edges among the points of tracks [1]; NaN for points that are none.

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px], or with a dim ``view``, or of one point without a dim ``point``.

    Returns
    -------
    across
        Shape (P, 2), with a dim ``view`` (V, P, 2); without the P for tracks of one point.

    Examples
    --------
    >>> edges_across(xr.Dataset(coords={"point": ["mid"]})).tolist()
    [[nan, nan]]
    """
    lead = [dim for dim in ("view", "point") if dim in tracks.sizes]
    if "edge_across" in tracks:
        return np.asarray(tracks["edge_across"].transpose(*lead, "pixel").values, np.float64)
    return np.full((*(tracks.sizes[dim] for dim in lead), 2), np.nan)


def find_edges(tracks: xr.Dataset) -> BoolArray:
    """Which points of tracks are measured across an edge only, in at least one view.

    Parameters
    ----------
    tracks
        Tracks, shape (T, P, 2) [px], or with a dim ``view``.

    Returns
    -------
    edge
        Shape (P,).

    Examples
    --------
    >>> find_edges(xr.Dataset(coords={"point": ["mid"]})).tolist()
    [False]
    """
    edge = np.asarray(np.isfinite(edges_across(tracks)).all(axis=-1))
    return np.asarray(edge.any(axis=0) if "view" in tracks.sizes else edge)


def raise_variance(covariance: FloatArray, axes: FloatArray, variance: FloatArray) -> FloatArray:
    """Covariances that state at least these variances along two axes each; correlations stay.

    Parameters
    ----------
    covariance
        Covariances of P points, shape (T, P, 2, 2) [px2]. What is zero stays zero.
    axes
        Unit vectors as rows, shape (P, 2, 2) [1], see `measured_axes`.
    variance
        Least variances along them, shape (T, P, 2) or (P, 2) [px2]; NaN where nothing is known.

    Returns
    -------
    raised
        Shape (T, P, 2, 2) [px2].

    Examples
    --------
    >>> raise_variance(np.eye(2)[None, None], np.eye(2)[None], np.array([[4.0, 0.5]]))[0, 0].tolist()
    [[4.0, 0.0], [0.0, 1.0]]
    """
    variance = np.broadcast_to(variance, covariance.shape[:-1])
    raised = np.empty(covariance.shape)
    for block in time_blocks(len(covariance)):
        raised[block] = _raise(covariance[block], axes, variance[block])
    return raised


def _raise(covariance: FloatArray, axes: FloatArray, variance: FloatArray) -> FloatArray:
    """The same at some times."""
    back = axes.swapaxes(1, 2)
    turned = axes @ covariance @ back
    stated = np.einsum("tpii->tpi", turned)
    larger = np.isfinite(variance) & (variance > stated) & (stated > 0)
    factor = np.sqrt(np.divide(variance, stated, out=np.ones_like(stated), where=larger))
    raised = back @ (turned * factor[..., :, None] * factor[..., None, :]) @ axes
    return np.where(larger.any(axis=-1)[..., None, None], raised, covariance)


def is_covariance(matrix: FloatArray) -> bool:
    """Whether a matrix is symmetric and has no negative variances, but for rounding.

    Parameters
    ----------
    matrix
        Shape (N, N), of values in any units.

    Examples
    --------
    >>> is_covariance(np.diag([1.0, 1e-12])), is_covariance(np.array([[1.0, 2.0], [2.0, 1.0]]))
    (True, False)
    """
    std = np.sqrt(np.clip(np.diag(matrix), 0, None))
    scale = np.where(std > 0, std, 1.0)
    correlation = matrix / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, atol=1e-6):
        return False
    return bool(np.linalg.eigvalsh((correlation + correlation.T) / 2).min() > -1e-6)
