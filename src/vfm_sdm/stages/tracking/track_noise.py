"""Noise that tracks show and their covariances leave out, above all the errors of video compression."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from scipy.ndimage import uniform_filter1d
from scipy.signal import firwin

from vfm_sdm.core.arrays import FloatArray, unbroken_runs
from vfm_sdm.core.covariances import edges_across, find_edges, measured_axes, raise_variance
from vfm_sdm.core.datasets import check_tracks, trusted_values

__all__ = ["include_static_noise", "include_track_noise"]

_TAPS = 41
_EDGE = 0.8
"""Lower edge of the band that is taken for noise, as a share of the Nyquist frequency."""
_KAISER = 9.0
"""Shape of the filter: motion of pixels at a few hertz must leave less than a thousandth of a pixel in the band."""
_WINDOW_S = 3.0
_FEWEST_STATIC = 2
_FEWEST_SAMPLES = 30
_TRUST = 1.5
"""Factor to which a stated standard deviation is taken to be right."""


def include_track_noise(tracks: xr.Dataset) -> xr.Dataset:
    """Tracks whose covariances are raised to the scatter that the positions show near the Nyquist frequency.

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px]. A covariance of zero (that of the reference frame) stays zero. Where
        parts of the subsets were compared (``part_noise`` [px]), covariances are raised to what these show, too.

    Returns
    -------
    tracks
        The tracks with larger ``position_covariance`` [px2] where the scatter is larger, and with ``scatter``, shape
        (T, P, 2) [px]: the standard deviation found, NaN where a run of frames is too short to tell.

    Notes
    -----
    A codec predicts each frame by moved blocks of earlier ones, to a quarter of a pixel, and drops small differences.
    All blocks of a surface get the same motion, so its error is common to a whole subset: nothing in the single frame
    shows it, and a covariance from its residuals is several times too small. In time it is nearly white, so it is seen
    where the structure does not move, in the highest fifth of the band: variance there over the filter's share of
    white noise, mean over 3 s.

    Of a point on an edge only the scatter across it counts.

    Errors that are slow, and not alike over a subset, show in its parts: shadows that creep over an edge, a surface
    beside the point (`vfm_sdm.stages.tracking.subset_parts`).

    Motion of the structure in that band (above 12 Hz at 30 frames a second) counts as noise, and errors that are
    stronger at low frequencies are understated. What the codec makes of every motion alike, a gain a little below 1, is
    not scatter and not in it.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> noise = np.random.default_rng(0).normal(0, 0.02, (600, 1, 2))
    >>> covariance = np.tile(0.005**2 * np.eye(2), (600, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(600) / 30, ["a"], noise, covariance, np.zeros((600, 1)), attrs={})
    >>> round(float(include_track_noise(tracks)["scatter"].mean()), 2)
    0.02
    """
    check_tracks(tracks)
    kernel = firwin(_TAPS, _EDGE, pass_zero=False, window=("kaiser", _KAISER))
    time_s, axes = tracks["time"].values, measured_axes(edges_across(tracks))
    position = _turn(axes, tracks["position"].values)
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0]) if len(time_s) > 1 else 1.0
    variance = np.full(position.shape, np.nan)
    for point in range(position.shape[1]):
        for run in unbroken_runs(np.asarray(np.isfinite(position[:, point]).all(axis=1))):
            variance[run, point] = _estimate_variance(position[run, point], kernel, max(1, round(_WINDOW_S * rate_hz)))
    noise = variance
    if "part_noise" in tracks:
        noise = np.fmax(variance, tracks["part_noise"].values ** 2)
    raised, back = tracks.copy(), axes.swapaxes(1, 2)
    larger = raise_variance(tracks["position_covariance"].values, axes, noise)
    raised["position_covariance"] = tracks["position_covariance"].copy(data=larger)
    scatter = np.sqrt(_turn(back**2, variance))
    return raised.assign(scatter=(("time", "point", "pixel"), scatter, {"units": "px"}))


def _turn(axes: FloatArray, values: FloatArray) -> FloatArray:
    """Vectors (T, P, 2) in other axes (P, 2, 2)."""
    return np.asarray((axes @ values[..., None])[..., 0])


def include_static_noise(tracks: Mapping[str, xr.Dataset], static: Sequence[str]) -> dict[str, xr.Dataset]:
    """Tracks whose covariances hold what points that do not move show beyond their own.

    Parameters
    ----------
    tracks
        Tracks by view, shape (T, P, 2) [px]. Covariances of zero stay zero.
    static
        Names of points that do not move; with fewer than two in a view, nothing is changed there.

    Returns
    -------
    tracks
        With larger ``position_covariance`` [px2] of all points in views whose air trembles.

    Notes
    -----
    Warm air bends the picture by parts of a pixel, slowly and nearly alike over a subset: neither the residuals of a
    frame nor the highest frequencies (`include_track_noise`) show it. What stands still does: the median of its
    variances in time beyond those stated, where it is more than the stated standard deviation is trusted to. It holds
    for the whole picture, because the air between is the same.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> haze = np.cumsum(np.random.default_rng(0).normal(0, 0.03, (300, 3, 2)), axis=0)
    >>> covariance = np.tile(0.01**2 * np.eye(2), (300, 3, 1, 1))
    >>> tracks = make_tracks(np.arange(300) / 30, ["a", "b", "mid"], haze, covariance, np.zeros((300, 3)), attrs={})
    >>> raised = include_static_noise({"left": tracks}, ["a", "b"])["left"]
    >>> bool((raised["position_covariance"].sel(point="mid", pixel_a="u", pixel_b="u") > 0.05**2).all())
    True
    """
    return {view: _include_static_noise(of_view, static) for view, of_view in tracks.items()}


def _include_static_noise(tracks: xr.Dataset, static: Sequence[str]) -> xr.Dataset:
    names = [str(name) for name in tracks["point"].values]
    position, covariance = trusted_values(tracks, "position"), tracks["position_covariance"].values
    edges, excess = find_edges(tracks), []
    for point in (names.index(name) for name in static if name in names):
        known = np.asarray(np.isfinite(position[:, point]).all(axis=1))
        # An edge says nothing along it.
        if known.sum() >= _FEWEST_SAMPLES and not edges[point]:
            stated = np.einsum("tii->ti", covariance[known, point]).mean(axis=0)
            found = position[known, point].var(axis=0)
            excess.append(np.where(found > _TRUST**2 * stated, found - stated, 0.0))
    if len(excess) < _FEWEST_STATIC:
        return tracks
    added = np.median(excess, axis=0)
    if not added.any():
        return tracks
    given = np.einsum("tpii->tp", covariance) == 0
    raised = np.where(given[..., None, None], covariance, covariance + np.diag(added))
    changed = tracks.copy()
    changed["position_covariance"] = tracks["position_covariance"].copy(data=raised)
    return changed


def _estimate_variance(values: FloatArray, kernel: FloatArray, window: int) -> FloatArray:
    """Variance of white noise, from its share in the kernel's band, shape (T, 2) [px2]; NaN for too short a run."""
    if len(values) < 2 * len(kernel):
        return np.full(values.shape, np.nan)
    high = np.stack([np.convolve(column, kernel, mode="valid") for column in (values - values.mean(axis=0)).T], axis=1)
    half = len(kernel) // 2
    power = np.pad(high**2, ((half, half), (0, 0)), mode="reflect")
    return np.asarray(uniform_filter1d(power, min(window, len(power)), axis=0, mode="nearest") / np.sum(kernel**2))
