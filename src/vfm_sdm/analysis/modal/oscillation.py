"""Frequency and damping of one mode with intervals: what a stretch of a damped oscillation under noise can tell."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import ComplexArray, FloatArray

__all__ = ["Oscillation", "Spread", "compute_support", "estimate_oscillation"]

_MOST_DAMPING, _LEAST_DAMPING = 0.3, 1e-4
"""Damping ratios between which the true one is looked for [1]."""
_NOISE = (1e-3, 1e9)
"""Power of noise that is looked for, over that of the force at one sample [1]."""
_ROUNDS = ((25, 25, 16), (25, 25, 8), (49, 49, 8))
"""Frequencies, damping ratios and powers of noise of the grids, each of which lies where the one before had weight."""
_MOVES = 6
"""How often the first grid may follow the posterior beyond its ends."""
_WEIGHT = 1e-5
"""Posterior density, over the largest, below which a grid ends."""
_TAILS = (0.025, 0.5, 0.975)
"""Shares of the posterior below ends and middle of the stated intervals."""


@dataclass(frozen=True)
class Spread:
    """A quantity as its posterior has it.

    Parameters
    ----------
    value, low, high
        Median, and the ends between which it lies with 95 %.
    std
        Standard deviation.
    """

    value: float
    low: float
    high: float
    std: float


@dataclass(frozen=True)
class Oscillation:
    """What is known of a mode by its own series.

    Parameters
    ----------
    frequency_hz
        Natural frequency [Hz].
    damping_ratio
        Share of critical damping [1].
    support
        Logarithm of how much more probable the series is with the mode than as noise alone.
    inside
        Whether the most probable frequency lies inside the band that was looked at: else it is another one's flank.
    """

    frequency_hz: Spread
    damping_ratio: Spread
    support: float
    inside: bool


def estimate_oscillation(
    series: FloatArray, interval_s: float, frequency_hz: float, *, damping_ratio: float, band_hz: tuple[float, float]
) -> Oscillation:
    """Frequency and damping of the oscillation in a series near a frequency, as posterior median and 95 % interval.

    Parameters
    ----------
    series
        Modal coordinate, shape (T,), any unit, evenly sampled, without a trend.
    interval_s
        Time between samples [s].
    frequency_hz, damping_ratio
        About what they are [Hz], [1].
    band_hz
        Frequencies that are looked at [Hz]; there, noise must be as strong everywhere.

    Notes
    -----
    The displacement of a mode that a white force drives is ``z + conj(z)`` with ``z[t] = p z[t-1] + e[t]``, ``p =
    exp((-damping w + i w) dt)`` and white ``e``, of which real and imaginary part are no independent numbers, for the
    force changes the velocity alone. Near its frequency it is, beside white noise, at the lines ``w_j``

    ``h_j (E_j + D) + g_j conj(E_-j)``, ``h_j = 1 / (1 - p exp(-i w_j))``, ``g_j = 1 / (1 - conj(p) exp(-i w_j))``

    with the coefficients ``E_j`` of ``e``, and ``D = p (z[-1] - z[T-1])``, which all lines share: the record begins and
    ends in the midst of the oscillation. ``g`` is what makes the upper flank of a peak steeper than the lower one;
    without it the frequency comes out low, in long records by half a standard deviation. What ``g`` makes of ``D``
    is of second order and left out. The covariance of the coefficients is a diagonal and a matrix of rank two for any
    length, and so the likelihood is known; no line is blurred, no window taken. The scale is integrated out, the power
    of noise over that of the force is, too; flat priors of the frequency and of the logarithms of damping and noise.
    What is left is summed up on a grid.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> p = np.exp((-0.01 + 1j) * 2 * np.pi * 2.0 / 20)
    >>> z = np.zeros(2000, complex)
    >>> for i in range(1, 2000):
    ...     z[i] = p * z[i - 1] + rng.normal() + 1j * rng.normal()
    >>> found = estimate_oscillation(z.real, 0.05, 2.0, damping_ratio=0.01, band_hz=(1.5, 2.5))
    >>> found.frequency_hz.low < 2.0 < found.frequency_hz.high, 0.005 < found.damping_ratio.value < 0.02
    (True, True)
    """
    lines, coefficients = _coefficients(series, interval_s, band_hz)
    duration_s = interval_s * len(series)
    span = max(1.0 / duration_s, 6 * np.sqrt(max(damping_ratio, 1e-3) * frequency_hz / (2 * np.pi * duration_s)))
    bounds = [_clip(frequency_hz, span, band_hz), (_LEAST_DAMPING, _MOST_DAMPING), _NOISE]

    def look(sizes: tuple[int, int, int]) -> tuple[list[FloatArray], FloatArray, list[FloatArray]]:
        values = [np.linspace(*bounds[0], sizes[0])]
        values += [np.geomspace(*ends, size) for ends, size in zip(bounds[1:], sizes[1:], strict=True)]
        logs = _log_likelihood(lines, coefficients, interval_s, (values[0], values[1], values[2]), len(series))
        weight = np.exp(logs - logs.max())
        return values, logs, [weight.sum(axis=(1, 2)), weight.sum(axis=(0, 2)), weight.sum(axis=(0, 1))]

    for _ in range(_MOVES):
        values, logs, weights = look(_ROUNDS[0])
        most = float(values[0][weights[0].argmax()])
        inside = most not in bounds[0]
        if inside or most in band_hz:
            break
        # The peak lies beyond: poles of high orders begin beside it.
        bounds[0] = _clip(most, span, band_hz)
    for sizes in _ROUNDS[1:]:
        bounds = [_where(one, weight) for one, weight in zip(values, weights, strict=True)]
        values, logs, weights = look(sizes)
    alone = -len(lines) * np.log(np.sum(np.abs(coefficients) ** 2))
    return Oscillation(
        _spread(values[0], weights[0]),
        _spread(values[1], weights[1], geometric=True),
        float(logs.max() - alone),
        inside,
    )


def compute_support(
    series: FloatArray, interval_s: float, frequency_hz: float, *, damping_ratio: float, band_hz: tuple[float, float]
) -> float:
    """Logarithm of how much more probable a series is with a given oscillation than as noise alone.

    Parameters
    ----------
    series, interval_s, band_hz
        As of `estimate_oscillation`.
    frequency_hz, damping_ratio
        The oscillation [Hz], [1].
    """
    lines, coefficients = _coefficients(series, interval_s, band_hz)
    grid = (np.array([frequency_hz]), np.array([damping_ratio]), np.geomspace(*_NOISE, 25))
    logs = _log_likelihood(lines, coefficients, interval_s, grid, len(series))
    return float(logs.max() + len(lines) * np.log(np.sum(np.abs(coefficients) ** 2)))


def _coefficients(
    series: FloatArray, interval_s: float, band_hz: tuple[float, float]
) -> tuple[FloatArray, ComplexArray]:
    """Lines in a band [radians a sample], and the coefficients there, scaled to the variance of white noise."""
    frequency = np.fft.rfftfreq(len(series), interval_s)
    near = np.flatnonzero((frequency >= band_hz[0]) & (frequency <= band_hz[1]))
    values = np.fft.rfft(series)[near]
    scaled: ComplexArray = values / np.sqrt(np.mean(np.abs(values) ** 2))
    return np.asarray(2 * np.pi * frequency[near] * interval_s), scaled


def _log_likelihood(
    lines: FloatArray,
    coefficients: ComplexArray,
    interval_s: float,
    grid: tuple[FloatArray, FloatArray, FloatArray],
    count: int,
) -> FloatArray:
    """Logarithm of the likelihood but for a constant, its scale integrated out, shape (F, D, N) of the grid."""
    frequency, damping, noise = grid
    angle = 2 * np.pi * frequency[:, None] * interval_s
    step = np.exp(-1j * lines)
    logs = np.empty((len(frequency), len(damping), len(noise)))
    for block, pole in _blocks(np.exp(angle * (1j * np.sqrt(1 - damping**2) - damping)), len(lines) * len(noise)):
        transfer, mirrored = 1 / (1 - pole[:, None] * step), 1 / (1 - np.conj(pole)[:, None] * step)
        alike = _likeness(pole)[:, None]
        after = pole**count
        shared = 2 * np.abs(pole) ** 2 * (1 - after.real) / (1 - np.abs(pole) ** 2)
        # What the force gives at a line, over the variance of e; and its covariance with D.
        power = np.abs(transfer) ** 2 + np.abs(mirrored) ** 2 + 2 * (alike * transfer * np.conj(mirrored)).real
        mixed = -np.conj(pole)[:, None] * (1 - np.conj(after))[:, None] / (step - np.conj(pole)[:, None])
        mixed = (transfer + np.conj(alike) * mirrored) * mixed
        inverse = 1 / (power[:, None] + noise[:, None])  # (G, N, M)
        s11 = np.einsum("gnm,gm->gn", inverse, np.abs(transfer) ** 2)
        s12 = np.einsum("gnm,gm->gn", inverse, np.conj(transfer) * mixed)
        s22 = np.einsum("gnm,gm->gn", inverse, np.abs(mixed) ** 2)
        y1 = np.einsum("gnm,gm->gn", inverse, np.conj(transfer) * coefficients)
        y2 = np.einsum("gnm,gm->gn", inverse, np.conj(mixed) * coefficients)
        # Woodbury's identity, with the 2 x 2 matrix of the shared part inverted by hand.
        m22 = s22 - count * shared[:, None]
        determinant = s11 * m22 - np.abs(s12 + count) ** 2
        cross = np.conj(y1) * (s12 + count) * y2
        taken = m22 * np.abs(y1) ** 2 - 2 * cross.real + s11 * np.abs(y2) ** 2
        left = inverse @ (np.abs(coefficients) ** 2) - taken / determinant
        volume = np.log(-determinant / count**2) - np.log(inverse).sum(axis=2)
        logs.reshape(-1, len(noise))[block] = -volume - len(lines) * np.log(left)
    return logs


def _likeness(pole: ComplexArray) -> ComplexArray:
    """Mean square of e over its mean squared modulus, shape (G,): the force acts on the velocity alone."""
    return np.asarray((1 - pole**2) / np.log(pole) * np.log(np.abs(pole)) / (np.abs(pole) ** 2 - 1))


def _blocks(poles: ComplexArray, each: int) -> Iterator[tuple[slice, ComplexArray]]:
    """Poles in stretches whose arrays stay in the processor's cache."""
    flat = poles.ravel()
    size = max(1, 30_000 // each)
    return ((slice(first, first + size), flat[first : first + size]) for first in range(0, flat.size, size))


def _clip(middle: float, span: float, band: tuple[float, float]) -> tuple[float, float]:
    return max(middle - span, band[0]), min(middle + span, band[1])


def _where(values: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Ends between which the posterior has weight, one step further out."""
    inside = np.flatnonzero(weight > _WEIGHT * weight.max())
    return float(values[max(inside[0] - 1, 0)]), float(values[min(inside[-1] + 1, len(values) - 1)])


def _spread(values: FloatArray, weight: FloatArray, *, geometric: bool = False) -> Spread:
    """Median, interval and standard deviation; of geometric values, quantiles are read on their logarithms."""
    share = (np.cumsum(weight) - weight / 2) / weight.sum()
    ends = np.interp(_TAILS, share, np.log(values) if geometric else values)
    low, middle, high = np.exp(ends) if geometric else ends
    mean = np.average(values, weights=weight)
    return Spread(
        float(middle), float(low), float(high), float(np.sqrt(np.average((values - mean) ** 2, weights=weight)))
    )
