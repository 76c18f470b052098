"""Gain and noise of a series against the motion that it should show."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["Gain", "combine_gains", "compute_gain", "smooth_motion"]

_FEWEST = 20
_LAGS = 30
_LARGEST_STD = 0.1
"""Scatter of a gain above which it is not determined [1]."""
_CLEAR = 3.0
"""Times the noise's power above which a frequency counts as motion."""
_HIGH = 0.8
"""Share of the band above which there is only noise."""


@dataclass(frozen=True)
class Gain:
    """Slope of a series over the true one.

    Parameters
    ----------
    gain, std
        Slope and its standard deviation [1]; NaN where the motion is too small or too short.
    noise
        Standard deviation of what is left [px].
    """

    gain: float
    std: float
    noise: float


def compute_gain(found: FloatArray, true: FloatArray) -> Gain:
    """Gain of a series of positions.

    Parameters
    ----------
    found, true
        Positions along one direction, shape (T,) [px]; frames where a position is NaN are left out.

    Notes
    -----
    Errors are correlated in time; the standard deviation sums their products with the motion over lags of up to 30
    frames, with falling weights (Newey and West).

    References
    ----------
    .. [1] Newey, W. K., West, K. D. (1987). A simple, positive semi-definite, heteroskedasticity and autocorrelation
       consistent covariance matrix. Econometrica 55(3), 703-708.

    Examples
    --------
    >>> true = np.sin(np.arange(200) / 5)
    >>> round(compute_gain(0.9 * true, true).gain, 3)
    0.9
    """
    known = np.isfinite(found) & np.isfinite(true)
    if known.sum() < _FEWEST:
        return Gain(float("nan"), float("nan"), float("nan"))
    y, x = found[known] - found[known].mean(), true[known] - true[known].mean()
    energy = float(x @ x)
    if not energy > 0:
        return Gain(float("nan"), float("nan"), float(y.std()))
    slope = float(y @ x) / energy
    left = y - slope * x
    product = left * x
    lags = min(_LAGS, len(product) // 4)
    variance = float(product @ product)
    variance += 2 * sum((1 - lag / (lags + 1)) * float(product[lag:] @ product[:-lag]) for lag in range(1, lags + 1))
    # Never less than of errors that are independent in time.
    variance = max(variance, float(left @ left) / len(left) * energy)
    return Gain(slope, float(np.sqrt(variance)) / energy, float(left.std()))


def combine_gains(passes: Sequence[Gain], *, loss_share: float) -> Gain:
    """One gain of several passes.

    Parameters
    ----------
    passes
        Gains that were found, one after the other.
    loss_share
        Standard deviation of an injected loss over the loss.

    Notes
    -----
    NaN where the passes scatter by more than a tenth: the motion is too small for its noise. To the scatter within and
    between the passes comes a share of the loss itself, for what differs between the encoder
    and its imitation, and between the surface and its estimate.

    Examples
    --------
    >>> combined = combine_gains([Gain(0.96, 0.004, 0.02), Gain(0.94, 0.004, 0.02)], loss_share=0.3)
    >>> round(combined.gain, 3), 0.01 < combined.std < 0.03
    (0.95, True)
    """
    found = [one for one in passes if np.isfinite([one.gain, one.std]).all() and one.std > 0]
    if not found:
        return Gain(float("nan"), float("nan"), float("nan"))
    gains, stds = np.array([one.gain for one in found]), np.array([one.std for one in found])
    weights = stds**-2 / np.sum(stds**-2)
    gain = float(weights @ gains)
    between = float(weights @ (gains - gain) ** 2) / max(len(found) - 1, 1)
    scatter = float(np.sum(stds**-2)) ** -1 + between
    if scatter > _LARGEST_STD**2:
        return Gain(float("nan"), float("nan"), float("nan"))
    variance = scatter + (loss_share * (1 - gain)) ** 2
    return Gain(gain, float(np.sqrt(variance)), float(np.sqrt(weights @ np.array([one.noise for one in found]) ** 2)))


def smooth_motion(position: FloatArray) -> FloatArray:
    """Motion of a point without most of its noise, beginning with zero, shape (T, 2) [px].

    Parameters
    ----------
    position
        Positions, shape (T, 2) [px]; NaN where the point is lost.

    Notes
    -----
    Each frequency keeps the share that stands out of the noise, whose level is that of the highest fifth of the band
    (Wiener's filter).

    Examples
    --------
    >>> motion = smooth_motion(np.column_stack([np.sin(np.arange(100) / 4), np.zeros(100)]))
    >>> motion.shape, bool(abs(motion[:, 0] - np.sin(np.arange(100) / 4)).max() < 0.2)
    ((100, 2), True)
    """
    count = len(position)
    index = np.arange(count)
    smooth = np.zeros((count, 2))
    for axis in range(2):
        known = np.isfinite(position[:, axis])
        if known.sum() < _FEWEST:
            continue
        filled = np.interp(index, index[known], position[known, axis])
        # Mirrored in time and value about its ends, so that the series goes on smoothly.
        line = np.linspace(filled[0], filled[-1], count)
        odd = np.concatenate([filled - line, -(filled - line)[::-1]])
        spectrum = np.fft.rfft(odd)
        power = np.abs(spectrum) ** 2
        noise = np.median(power[round(_HIGH * len(power)) :]) / np.log(2)
        around = np.convolve(power, np.ones(5) / 5, mode="same")
        share = np.clip(1 - _CLEAR * noise / np.maximum(around, 1e-30), 0, 1)
        smooth[:, axis] = np.fft.irfft(spectrum * share, 2 * count)[:count] + line
    return np.asarray(smooth - smooth[0])
