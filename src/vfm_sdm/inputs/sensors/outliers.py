"""Outliers of acceleration: lone wrong samples, which a Hampel filter repairs, and impacts, which it would cut off."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray
from vfm_sdm.signals.filters import band_pass, hampel

__all__ = ["HampelUse", "OutlierRules", "Outliers", "find_lone", "find_worth", "treat_outliers"]

HampelUse = Literal["auto", "on", "off"]

_LEAST_WORTH, _MOST_WORTH = 1e-3, 2e-2
"""Shares of the energy in the band from which on it matters. The root of the first, 3 % of the signal's root mean
square, is an error that counts. Of white noise the filter takes away 2 (3.5 phi(3.5) + Q(3.5)) = 0.7 %, whatever it
is: an axis that holds little else is not worth a word below three times that."""
_ALONE = 0.3
"""How far the neighbours of a lone wrong sample may be off, as a share of it. What a sensor with a filter against
aliasing felt is spread over several samples: a Ricker pulse of a tenth of the sampling rate has 0.7 beside its peak."""

_LONE, _BLOCK = 12.0, 64
"""Scaled median absolute deviations beyond which a lone sample is surely wrong, and samples of which these are."""


@dataclass(frozen=True)
class OutlierRules:
    """How outliers are found and what is done about them.

    Parameters
    ----------
    width, threshold
        Window [samples] and threshold [1] of `vfm_sdm.signals.filters.hampel`.
    rate_hz, band_hz
        Sampling rate and the band that counts [Hz].
    use
        ``on``: every outlier is replaced. ``off``: none is. ``auto``: every one, unless those that are not alone hold
        more than ``worth`` of the energy in the band; then only lone ones.
    worth
        Share of the energy in the band that matters (`find_worth`) [1].
    """

    width: int
    threshold: float
    rate_hz: float
    band_hz: tuple[float, float]
    use: HampelUse = "auto"
    worth: float = _LEAST_WORTH


@dataclass(frozen=True, eq=False)
class Outliers:
    """What the Hampel filter found in a series, and what became of it.

    Parameters
    ----------
    treated
        The series to go on with, shape (T,).
    replaced
        Which of its samples are medians instead of readings, shape (T,).
    found
        Share of samples that the filter would replace [1].
    energy, energy_spread
        Share of the energy in the band in what it would take away, of all, and of those that are not alone [1].
    energy_taken
        Share of the energy in the band that was taken away [1].
    """

    treated: FloatArray
    replaced: BoolArray
    found: float
    energy: float
    energy_spread: float
    energy_taken: float


def find_worth(values: FloatArray, rate_hz: float, band_hz: tuple[float, float]) -> FloatArray:
    """Share of each axis' energy in the band that matters, by what the axis holds of the sensor's [1].

    Parameters
    ----------
    values
        Acceleration of one sensor, any unit, shape (T, A), without gaps.
    rate_hz, band_hz
        Sampling rate and the band that counts [Hz].

    Returns
    -------
    worth
        Shape (A,).
    """
    energy = np.sum(band_pass(values - values.mean(axis=0), rate_hz, band_hz) ** 2, axis=0)
    share = energy / max(float(energy.max()), np.finfo(float).tiny)
    return np.asarray(np.clip(_LEAST_WORTH / np.maximum(share, _LEAST_WORTH), _LEAST_WORTH, _MOST_WORTH))


def treat_outliers(values: FloatArray, rules: OutlierRules) -> Outliers:
    """A series without its outliers, and what they were.

    Parameters
    ----------
    values
        Acceleration, any unit, shape (T,), evenly sampled, without gaps.
    rules
        How they are found and what is done about them.

    Notes
    -----
    A filter of medians cannot tell an impact on a quiet structure from a fault of the sensor. A lone sample, whose
    neighbours know nothing of it, is such a fault: the sensor's own filter would have spread an event over several.

    Examples
    --------
    >>> time_s = np.arange(2000) / 200
    >>> quiet = 0.01 * np.sin(2 * np.pi * 3 * time_s)
    >>> far = (np.pi * 20 * (time_s - 5)) ** 2
    >>> struck = quiet + (1 - 2 * far) * np.exp(-far)
    >>> spiky = quiet + (np.arange(2000) == 900)
    >>> rules = OutlierRules(151, 3.5, 200.0, (1.0, 10.0))
    >>> [int(treat_outliers(series, rules).replaced.sum()) for series in (struck, spiky)]
    [0, 1]
    """
    filtered, found = hampel(values, rules.width, threshold=rules.threshold)
    cut = values - filtered
    total = float(np.sum(band_pass(values - values.mean(), rules.rate_hz, rules.band_hz) ** 2))

    def energy(taken: BoolArray) -> float:
        if not taken.any() or not total > 0:
            return 0.0
        return float(np.sum(band_pass(np.where(taken, cut, 0.0), rules.rate_hz, rules.band_hz) ** 2) / total)

    alone = _find_alone(values, cut, found)
    spread = energy(found & ~alone)
    replaced = found
    if rules.use == "off":
        replaced = np.zeros_like(found)
    elif rules.use == "auto" and spread > rules.worth:
        replaced = alone
    return Outliers(
        np.where(replaced, filtered, values),
        replaced,
        float(found.mean()),
        energy(found),
        spread,
        energy(replaced),
    )


def _find_alone(values: FloatArray, cut: FloatArray, found: BoolArray) -> BoolArray:
    """Outliers whose neighbours lie near the median from which they themselves are far."""
    alone = np.zeros_like(found)
    for at in np.flatnonzero(found):
        beside = values[[n for n in (at - 1, at + 1) if 0 <= n < len(values)]] - (values[at] - cut[at])
        alone[at] = bool(np.all(np.abs(beside) < _ALONE * abs(cut[at])))
    return alone


def find_lone(values: FloatArray) -> BoolArray:
    """Samples that are surely faults: far from all beside them, which know nothing of them.

    Parameters
    ----------
    values
        Any unit, shape (T,), evenly sampled; NaN where there is no value.

    Examples
    --------
    >>> series = np.sin(np.arange(1000) / 5)
    >>> series[300] += 20
    >>> np.flatnonzero(find_lone(series)).tolist()
    [300]
    """
    count = len(values)
    lone = np.zeros(count, dtype=bool)
    if count < 2 * _BLOCK:
        return lone
    beside = np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]])
    middle = np.median(beside, axis=0)
    off = np.abs(values[2:-2] - middle)
    known = np.where(np.isfinite(off), off, 0.0)
    blocks = len(known) // _BLOCK
    spread = np.median(known[: blocks * _BLOCK].reshape(blocks, _BLOCK), axis=1)
    # Where motion begins in the midst of a block, the next one knows its size.
    wide = np.maximum(spread, np.maximum(np.append(spread[1:], 0.0), np.append(0.0, spread[:-1])))
    around = np.maximum(wide[np.minimum(np.arange(len(known)) // _BLOCK, blocks - 1)], np.median(known))
    near = np.abs(beside[1:3] - middle).max(axis=0)
    lone[2:-2] = (off > _LONE * MAD_TO_STD * around) & (near < _ALONE * off)
    return lone
