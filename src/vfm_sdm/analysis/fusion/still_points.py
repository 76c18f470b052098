"""Errors of the video that last: how large and how long, as points that must not move show them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.optimize import minimize

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.signals.clocks import even_clock, interpolate
from vfm_sdm.signals.derivatives import curvature

__all__ = ["ASSUMED", "VideoErrors", "estimate_video_errors"]

_FEWEST = 100
_LEAST_SHARE = 0.8
_BETWEEN_POINTS = 0.25
"""Standard deviation of the logarithms from point to point: a point differs from others as these do from each other."""


@dataclass(frozen=True, eq=False)
class VideoErrors:
    """What is known of a video's errors beforehand.

    Parameters
    ----------
    centre, spread
        Means and standard deviations of logarithms, shape (3,) each: of what differs from frame to frame over the
        stated standard deviation, of the slow error over that, and of its correlation time in seconds.
    points
        Points from which it is known.
    """

    centre: tuple[float, float, float]
    spread: tuple[float, float, float]
    points: int = 0


ASSUMED = VideoErrors((0.0, float(np.log(0.3)), float(np.log(2.0))), (0.5, 0.5, 0.5))
"""Without a point that must not move: the slow error is three tenths of the scatter, within a factor of two."""


def estimate_video_errors(displacement: xr.Dataset, points: Sequence[str], axes: Sequence[str]) -> VideoErrors:
    """Scatter and slow error of the video over what it states, from points that must not move.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    points, axes
        Points that must not move, and axes that count.

    Notes
    -----
    Whittle's likelihood [1]_ of the series, each over its stated standard deviation, as white noise and a first-order
    autoregression, with wide priors.

    References
    ----------
    .. [1] Whittle, P. (1953). Estimation and information in stationary time series. Arkiv foer Matematik 2, 423-434.
    """
    spectra = [
        one for point in points for axis in axes if (one := _find_spectrum(displacement, point, axis)) is not None
    ]
    if not spectra:
        return ASSUMED
    centre, spread = np.array(ASSUMED.centre), np.array((1.0, 1.5, 1.5))

    def cost(z: FloatArray) -> float:
        white, slow, seconds = np.exp(centre + spread * z)
        total = 0.5 * float(z @ z)
        for power, rate_hz in spectra:
            phi = np.exp(-1 / (seconds * rate_hz))
            omega = 2 * np.pi * np.arange(1, len(power) + 1) / (2 * len(power) + 1)
            expected = white**2 * (1 + slow**2 * (1 - phi**2) / (1 + phi**2 - 2 * phi * np.cos(omega)))
            total += float(np.sum(np.log(expected) + power / expected))
        return total

    found = minimize(cost, np.zeros(3), method="L-BFGS-B", bounds=[(-4, 4)] * 3)
    covariance = np.linalg.inv(curvature(cost, found.x))
    stds = np.hypot(spread * np.sqrt(np.diag(covariance)), _BETWEEN_POINTS)
    return VideoErrors(tuple(centre + spread * found.x), tuple(stds), len(points))


def _find_spectrum(displacement: xr.Dataset, point: str, axis: str) -> tuple[FloatArray, float] | None:
    """Periodogram of a series over its stated standard deviation, without its mean, and its rate [Hz]."""
    one = displacement.sel(point=[point]).transpose("time", "point", "axis", ...)
    a = [str(name) for name in one["axis"].values].index(axis)
    values = trusted_values(one, "displacement")[:, 0, a] / one["displacement_std"].values[:, 0, a]
    known = np.isfinite(values)
    if known.sum() < max(_FEWEST, _LEAST_SHARE * len(values)) or not np.ptp(values[known]) > 0:
        return None
    time_s = one["time"].values
    grid, rate_hz = even_clock(time_s)
    filled = np.interp(time_s, time_s[known], values[known])
    series = filled if grid is time_s else interpolate(time_s, filled, grid)
    series = series[np.isfinite(series)]
    # An odd number, so that every line but that of the mean is one of two.
    series = series[: len(series) - 1 + len(series) % 2]
    power = np.abs(np.fft.rfft(series - series.mean())[1:]) ** 2 / len(series)
    return np.asarray(power), rate_hz
