"""Error of the origin of displacement: all samples of a series share it."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.core.covariances import edges_across, measured_axes
from vfm_sdm.core.datasets import Status
from vfm_sdm.signals.clocks import still_frames

__all__ = ["include_origin"]

_FEWEST_STATIC = 2
_FEWEST_SAMPLES = 30
_FEWEST_WINDOWS = 3
"""Still intervals that must fit into a recording for their means to scatter."""


def include_origin(
    tracks: xr.Dataset, static: Sequence[str], still_interval_s: tuple[float, float] | None = None
) -> xr.Dataset:
    """Tracks with the covariance of the position that displacement is relative to.

    Parameters
    ----------
    tracks
        Synchronised tracks, shape (V, T, P, 2) [px].
    static
        Names of points that do not move.
    still_interval_s
        Beginning and end [s] of the interval whose mean is the origin; without it, the origin is one sample.

    Returns
    -------
    tracks
        The tracks with ``origin_covariance`` (view, point, pixel_a, pixel_b) [px2].

    Notes
    -----
    Of white noise the mean of n frames keeps 1/n of the variance. Trembling air, and what a codec carries along from
    frame to frame, is slower: of air that is correlated over 0.2 s the mean over 0.6 s keeps half. Points that do not
    move show it, whatever its spectrum: the variance of the means over all intervals of that length, about their mean
    over the recording. A static point has what it shows itself; every other point its own white noise over n, and the
    middle of what the static points of the view, two or more, show beyond theirs. Of a single sample only the latter
    counts, because its own noise is that of the reference frame, which the residuals of all frames hold.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> air = np.repeat(np.random.default_rng(0).normal(0, 0.3, (100, 3, 2)), 6, axis=0)
    >>> covariance = np.tile(0.01**2 * np.eye(2), (600, 3, 1, 1))
    >>> one = make_tracks(np.arange(600) / 30, ["a", "b", "mid"], air, covariance, np.zeros((600, 3)), attrs={})
    >>> tracks = xr.concat([one, one], "view").assign_coords(view=["left", "right"])
    >>> with_origin = include_origin(tracks, ["a", "b"], (0.0, 0.6))
    >>> origin = with_origin["origin_covariance"].sel(view="left", point="mid", pixel_a="u", pixel_b="u")
    >>> bool(0.13 < float(origin) ** 0.5 < 0.23)
    True
    """
    frames = 1 if still_interval_s is None else int(still_frames(tracks["time"].values, still_interval_s).sum())
    axes = measured_axes(edges_across(tracks))
    covariance = np.empty((*axes.shape[:2], 2, 2))
    for view in range(tracks.sizes["view"]):
        variance = _compute_variances(tracks.isel(view=view), axes[view], static, max(frames, 1))
        covariance[view] = np.einsum("pki,pk,pkj->pij", axes[view], variance, axes[view])
    dims = ("view", "point", "pixel_a", "pixel_b")
    return tracks.assign(origin_covariance=(dims, covariance, {"units": "px2"}))


def _compute_variances(tracks: xr.Dataset, axes: FloatArray, static: Sequence[str], frames: int) -> FloatArray:
    """Variance of the origin of one view's points along their measured axes, shape (P, 2) [px2]."""
    names = [str(name) for name in tracks["point"].values]
    edge: BoolArray = np.asarray(np.isfinite(edges_across(tracks)).all(axis=-1))
    ok: BoolArray = np.asarray(tracks["status"].values == Status.OK)
    variance = np.zeros((len(names), 2))
    slow: list[FloatArray] = []
    shown: dict[int, FloatArray] = {}
    for point in range(len(names)):
        rows = np.flatnonzero(ok[:, point])
        stated = _compute_stated(tracks["position_covariance"].values[rows, point], axes[point])
        variance[point] = stated / frames if frames > 1 else 0.0
        if names[point] not in static:
            continue
        scatter = _compute_scatter(tracks, point, rows, axes[point], frames)
        if scatter is not None:
            shown[point] = scatter
            if not edge[point]:
                slow.append(np.maximum(scatter - stated / frames, 0.0))
    if len(slow) >= _FEWEST_STATIC:
        added = np.median(slow, axis=0)
        # Of points on edges, whose axes are their own, by the mean of u and v.
        variance += np.where(edge[:, None], added.mean(), added)
    for point, scatter in shown.items():
        variance[point] = scatter
    variance[edge, 1] = 0.0  # nothing is measured along an edge
    return variance


def _compute_stated(covariance: FloatArray, axes: FloatArray) -> FloatArray:
    """Mean variance that frames state along axes, shape (2,) [px2]; 0 where none states any."""
    stated = np.einsum("ki,tij,kj->tk", axes, covariance, axes)
    known = np.isfinite(stated).all(axis=1)
    return np.asarray(stated[known].mean(axis=0)) if known.any() else np.zeros(2)


def _compute_scatter(
    tracks: xr.Dataset, point: int, rows: IntArray, axes: FloatArray, frames: int
) -> FloatArray | None:
    """Variance of the means over so many frames of a point's positions along axes, shape (2,) [px2].

    ``None`` where the recording is too short to tell.
    """
    if len(rows) < _FEWEST_WINDOWS * frames or len(rows) < _FEWEST_SAMPLES:
        return None
    along = tracks["position"].values[rows, point] @ axes.T
    total = np.vstack([np.zeros(2), np.cumsum(along - along.mean(axis=0), axis=0)])
    means = (total[frames:] - total[:-frames]) / frames
    # The mean over the recording follows the means of its parts.
    return np.asarray(np.mean(means**2, axis=0) * len(rows) / (len(rows) - frames))
