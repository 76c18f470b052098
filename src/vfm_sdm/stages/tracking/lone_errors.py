"""Single samples that leave the path of their point for one frame: a rain streak, a glint, a damaged block."""

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray
from vfm_sdm.core.covariances import edges_across, measured_axes, raise_variance
from vfm_sdm.core.datasets import check_tracks, trusted_values

__all__ = ["find_lone_errors", "include_lone_errors"]

_WEIGHTS = (np.array([1.0, -6.0, 15.0]) / 20, np.array([-1.0, 4.0]) / 6)
"""Weights of the samples before a sample, and mirrored of those after it, that interpolate it: of fifth and of third
order. Motion at a tenth of the frame rate is off by 0.3 and 2.4 % of its amplitude."""
_REACH, _FAR_REACH = 3, 4
_CLEAR = 4.0
"""Standard deviations of its departures by which a sample leaves the path: noise does in 6 of 100,000 samples."""
_LEFT, _NOISE_LEFT = 0.1, 3.5
"""Share of a departure, and usual departures, that may be left in its neighbours once it is taken out. Noise alone
leaves more than the latter in one of six neighbours in 0.3 % of all cases; a kink or a ringing leaves a third."""
_ONE_SIDED = (np.array([1.0]), np.array([-1.0, 2.0]), np.array([1.0, -3.0, 3.0]), np.array([-1.0, 4.0, -6.0, 4.0]))
"""Weights of the samples before a sample that continue their path to it, by polynomials of rising order."""
_APART = 0.25
"""Share of a departure by which a sample must leave the paths of both sides, too: one at a kink lies on one of them."""
_TOGETHER = 2.5
"""Median of the other points' departures, each over its usual one, from which on something common happened."""
_FEWEST = 30
_UNEVEN = 0.25
"""Share of the interval between frames by which those about a sample may differ."""


def include_lone_errors(tracks: xr.Dataset) -> xr.Dataset:
    """Tracks whose covariances state how far single samples leave the paths of their points.

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px]. A covariance of zero (that of the reference frame) stays zero.

    Returns
    -------
    tracks
        The tracks with larger ``position_covariance`` [px2] of the samples that `find_lone_errors` finds: their
        variance is at least the square of their departure. Positions stay as they are.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> wave = 4 * np.sin(np.arange(90) / 5)
    >>> place = np.stack([wave, 0 * wave], axis=1)[:, None] + np.random.default_rng(0).normal(0, 0.02, (90, 1, 2))
    >>> place[40, 0, 0] += 0.5
    >>> covariance = np.tile(0.02**2 * np.eye(2), (90, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(90) / 30, ["mid"], place, covariance, np.zeros((90, 1)), attrs={})
    >>> stated = include_lone_errors(tracks)["position_covariance"].values[39:42, 0, 0, 0] ** 0.5
    >>> stated.round(1).tolist()
    [0.0, 0.5, 0.0]
    """
    check_tracks(tracks)
    axes = measured_axes(edges_across(tracks))
    turned = np.asarray((axes @ trusted_values(tracks, "position")[..., None])[..., 0])
    departure = find_lone_errors(turned, tracks["time"].values)
    if not np.isfinite(departure).any():
        return tracks
    larger = raise_variance(tracks["position_covariance"].values, axes, departure**2)
    return tracks.assign(position_covariance=tracks["position_covariance"].copy(data=larger))


def find_lone_errors(position: FloatArray, time_s: FloatArray) -> FloatArray:
    """How far single samples leave the paths of their points [px].

    Parameters
    ----------
    position
        Positions along two directions, shape (T, P, 2) [px]; NaN where unknown.
    time_s
        Time stamps, shape (T,) [s].

    Returns
    -------
    departure
        Shape (T, P, 2) [px]; NaN but where a sample leaves its path alone.

    Notes
    -----
    The departure of a sample is its difference from the polynomial through the three samples before and the three
    after it. It is a lone error when it is clear of its usual size, which motion too fast for the polynomial raises;
    when without it those of its neighbours are what they usually are, which they are not about a ringing; when it goes
    on with the path of neither side, as a sample at a kink does, where an impact sets in; and when the other points of
    the view do not leave their paths in the same frame, as they do with a camera that is hit. What a structure with
    mass does in one frame and undoes in the next, at one point alone, is no motion. It is stated, not replaced.
    """
    even, departure, alone = _find_even(time_s), np.full(position.shape, np.nan), np.zeros(position.shape, np.bool_)
    usual, found = np.full(position.shape[1:], np.inf), np.full(position.shape, np.nan)
    for point in range(position.shape[1]):  # one by one: of an hour, what all take at once is a tenth of all memory
        one = slice(point, point + 1)
        usual[one], departure[:, one] = _depart(position[:, one], even)
        alone[:, one] = _leaves_both_sides(position[:, one], departure[:, one])
    relative = np.abs(departure) / usual
    alone &= ~_find_common(relative)[..., None]
    for point, direction in np.argwhere(np.nanmax(np.nan_to_num(relative), axis=0, initial=0.0) > _CLEAR):
        size = _pursue(departure[:, point, direction], usual[point, direction])
        size[~alone[:, point, direction]] = np.nan
        found[:, point, direction] = size
    return found


def _find_even(time_s: FloatArray) -> BoolArray:
    """Frames (T,) about which the others come at an even pace."""
    if len(time_s) < 2:
        return np.zeros(len(time_s), np.bool_)
    interval = np.diff(time_s)
    even = np.pad(np.abs(interval / np.median(interval) - 1) < _UNEVEN, _REACH, constant_values=True)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(even, 2 * _REACH).all(axis=1))[: len(time_s)]


def _depart(position: FloatArray, even: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Usual size (P, 2) and departures (T, P, 2) of positions [px]; usual ones are infinite where too few are known."""
    padded = np.pad(position, ((_REACH, _REACH), (0, 0), (0, 0)), constant_values=np.nan)
    usual, departure = np.full(position.shape[1:], np.inf), np.full(position.shape, np.nan)
    for order, weights in enumerate(_WEIGHTS):
        expected = np.zeros(position.shape)
        for back, weight in zip(range(len(weights), 0, -1), weights, strict=True):
            for shift in (-back, back):
                expected = expected + weight * padded[_REACH + shift : len(padded) - _REACH + shift]
        found = np.where(even[:, None, None], position - expected, np.nan)
        if order == 0:
            many = np.isfinite(found).sum(axis=0) >= _FEWEST
            middle = np.nanmedian(np.abs(np.where(many, found, 0.0)), axis=0)
            usual = np.where(many & (middle > 0), MAD_TO_STD * middle, np.inf)
        departure = np.where(np.isfinite(departure), departure, found)
    return usual, departure


def _leaves_both_sides(position: FloatArray, departure: FloatArray) -> BoolArray:
    """Whether samples leave the paths before and after them to the side of their departures, shape (T, P, 2)."""
    frames = len(position)
    padded = np.pad(position, ((_FAR_REACH, _FAR_REACH), (0, 0), (0, 0)), constant_values=np.nan)
    share, least = np.full((2, *position.shape), np.nan), np.full(position.shape[1:], np.inf)
    for weights in _ONE_SIDED:
        sides = np.full((2, *position.shape), np.nan)
        for side, step in enumerate((-1, 1)):
            terms = [
                weight * padded[_FAR_REACH + step * back : _FAR_REACH + step * back + frames]
                for back, weight in zip(range(len(weights), 0, -1), weights, strict=True)
            ]
            sides[side] = position - np.sum(terms, axis=0)
        known = np.isfinite(sides).any(axis=(0, 1))
        usual = np.nanmedian(np.abs(np.where(known, sides, np.inf)), axis=(0, 1))
        # The order that goes on best with this point's motion and noise.
        against = np.divide(sides, departure, out=np.zeros_like(sides), where=departure != 0)
        share, least = np.where(usual < least, against, share), np.minimum(usual, least)
    return np.asarray((share > _APART).all(axis=0))


def _find_common(relative: FloatArray) -> BoolArray:
    """Whether most of the other points leave their paths in a frame as well, shape (T, P)."""
    size = np.nan_to_num(relative).max(axis=2)
    points = size.shape[1]
    if points < 2:
        return np.zeros(size.shape, np.bool_)
    others = [np.median(np.delete(size, point, axis=1), axis=1) for point in range(points)]
    return np.stack(others, axis=1) > _TOGETHER


def _pursue(departure: FloatArray, usual: float) -> FloatArray:
    """Lone errors (T,) among departures (T,) of a usual size [px]: largest first, each taken out of those about it."""
    left, size = departure.copy(), np.full(len(departure), np.nan)
    side = _WEIGHTS[0]
    kernel = np.concatenate([side, [0.0], side[::-1]])
    tried = np.zeros(len(left), np.bool_)
    while True:
        open_ = np.where(tried, 0.0, np.abs(np.nan_to_num(left)))
        at = int(open_.argmax())
        if not open_[at] > _CLEAR * usual:
            return size
        tried[at] = True
        first, last = max(at - _REACH, 0), min(at + _REACH + 1, len(left))
        about = left[first:last] + left[at] * kernel[first - at + _REACH : last - at + _REACH]
        beside = np.delete(about, at - first)
        if np.nanmax(np.abs(beside), initial=0.0) <= _LEFT * abs(left[at]) + _NOISE_LEFT * usual:
            size[at] = abs(left[at])
            about[at - first] = 0.0
            left[first:last] = about
