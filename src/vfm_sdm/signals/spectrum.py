"""Spectra of series: the strongest oscillation, where one stands clear of the noise."""

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft
from scipy.signal import detrend, welch

from vfm_sdm.core.arrays import FloatArray, IntArray, as_float_array
from vfm_sdm.errors import DatasetError

__all__ = ["amplitude_spectrum", "detection_limit", "dominant_frequency"]

_SHORTEST_S = 2.0
_FEWEST_CYCLES = 4.0
"""With fewer, the window blurs a line over all its neighbours and nothing is left to tell it from noise."""
_FEWEST_VALID = 0.8
"""Share of frames that must be there; over more gaps, interpolation would colour the spectrum."""
_FALSE_PEAK = 1e-5
"""Nominal probability that noise alone gives a peak; as the noise level is estimated from few lines, the true one is
below 1 in 300 for white noise and about 1 in 100 for a random walk (found by simulation)."""
_ZERO_PADDING = 4
_STRETCH = 8192
_CHANCE = 0.05
"""Probability with which noise alone shows a line above the limit of detection, as two standard deviations have it."""


def detection_limit(std: float, count: int) -> float:
    """Smallest amplitude of a sinusoid of unknown frequency that is told from white noise, in the unit of the noise.

    Parameters
    ----------
    std
        Standard deviation of the noise of one sample.
    count
        Number of samples.

    Returns
    -------
    amplitude
        NaN of fewer than two samples.

    Notes
    -----
    A sinusoid of amplitude A in n samples has the power ``n A^2 / 4`` in a periodogram whose noise has the mean
    ``std^2`` and an exponential distribution; the highest of ``M = n / 2`` lines of noise exceeds ``ln(M / p)`` times
    the mean with probability p [1]_. With ``p = 0.05`` (k = 2) the limit is ``A = 2 std sqrt(ln(n / (2 p)) / n)``. Of
    one frequency that is known beforehand it would be ``2 std sqrt(2 / n)``; noise that is not white has a higher limit
    where its spectrum is higher.

    References
    ----------
    .. [1] Scargle, J. D. (1982). Studies in astronomical time series analysis II. The Astrophysical Journal 263,
       835-853, section III.

    Examples
    --------
    >>> round(detection_limit(0.01, 480), 5)
    0.00266
    """
    if count < 2:
        return float("nan")
    return float(2 * std * np.sqrt(np.log(count / (2 * _CHANCE)) / count))


def dominant_frequency(time_s: npt.ArrayLike, values: npt.ArrayLike) -> float | None:
    """Frequency of the strongest oscillation of a series [Hz], or None where there is no clear one.

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s].
    values
        The series, any unit, shape (T,); NaN where there is no value.

    Returns
    -------
    frequency_hz
        None when the values span less than 2 s, fewer than 80 % of the frames have one, or no peak of at least four
        cycles in the record stands clear of the noise around it.

    Raises
    ------
    DatasetError
        The lengths differ or the time stamps do not increase.

    Notes
    -----
    Linear interpolation to evenly spaced times, linear trend removed, Hann window, periodogram padded four times, and
    a parabola through the logarithm of the highest peak and its neighbours. In noise of ``M`` lines the highest
    exceeds the mean by more than ``ln(M / p)`` with probability ``p``. The mean is taken around each line, over two
    octaves, so that slow drift hides no vibration and is not taken for one; and from the median, which an oscillation
    does not raise.

    References
    ----------
    .. [1] Harris, F. J. (1978). On the use of windows for harmonic analysis with the discrete Fourier transform.
       Proceedings of the IEEE 66(1), 51-83.

    Examples
    --------
    >>> time_s = np.arange(300) / 30
    >>> frequency_hz = dominant_frequency(time_s, 0.5 * np.sin(2 * np.pi * 3.2 * time_s))
    >>> round(frequency_hz, 2)
    3.2
    """
    found = _even_series(time_s, values)
    if found is None:
        return None
    even, interval = found
    count = even.size
    padded = next_fast_len(_ZERO_PADDING * count, real=True)
    power = np.abs(rfft(detrend(even) * np.hanning(count), padded)) ** 2
    lowest = int(np.ceil(_FEWEST_CYCLES * padded / count))
    lines = np.arange(lowest, power.size - 1)
    # Rounding errors are no noise: a constant series has no peak.
    rounding = (np.finfo(float).eps * np.abs(even).max() * count) ** 2
    clear = power[lines] > np.log(count / 2 / _FALSE_PEAK) * _background(power, lines) + rounding
    clear &= (power[lines] >= power[lines - 1]) & (power[lines] >= power[lines + 1])
    if not clear.any():
        return None
    highest = int(lines[clear][np.argmax(power[lines[clear]])])
    left, middle, right = np.log(np.maximum(power[highest - 1 : highest + 2], np.finfo(float).tiny))
    curvature = left - 2 * middle + right
    offset = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
    return float((highest + offset) / (padded * interval))


def amplitude_spectrum(
    time_s: npt.ArrayLike, values: npt.ArrayLike, *, most_lines: int = 2000
) -> tuple[FloatArray, FloatArray]:
    """Amplitudes of the oscillations of a series by frequency, for drawing.

    Parameters
    ----------
    time_s
        Increasing time stamps, shape (T,) [s].
    values
        The series, any unit, shape (T,); NaN where there is no value.
    most_lines
        Lines that are returned at most, each the highest of its neighbours.

    Returns
    -------
    frequency_hz, amplitude
        Shapes (F,) [Hz] and (F,) in the unit of the series; empty where fewer than 80 % of the frames have a value, or
        the values span less than 2 s.

    Raises
    ------
    DatasetError
        The lengths differ or the time stamps do not increase.

    Notes
    -----
    Evenly spaced by linear interpolation, linear trend removed, Hann window; of long series the mean power over
    half-overlapping stretches of 8192 samples (Welch). A sinusoid between two lines shows up to 15 % too small.

    Examples
    --------
    >>> time_s = np.arange(300) / 30
    >>> frequency_hz, amplitude = amplitude_spectrum(time_s, 0.5 * np.sin(2 * np.pi * 3.0 * time_s))
    >>> round(float(frequency_hz[amplitude.argmax()]), 2), round(float(amplitude.max()), 2)
    (3.0, 0.5)
    """
    found = _even_series(time_s, values)
    if found is None:
        return np.zeros(0), np.zeros(0)
    even, interval = found
    frequency_hz, power = welch(
        even,
        fs=1 / interval,
        window="hann",
        nperseg=min(even.size, _STRETCH),
        detrend=detrend,
        scaling="spectrum",
    )
    amplitude = np.sqrt(2 * power[1:])
    share = -(-amplitude.size // most_lines)
    starts = np.arange(0, amplitude.size, share)
    return np.asarray(frequency_hz[1:][starts]), np.asarray(np.maximum.reduceat(amplitude, starts))


def _even_series(time_s: npt.ArrayLike, values: npt.ArrayLike) -> tuple[FloatArray, float] | None:
    """Values at even times, and the time between them [s]; ``None`` of too few.

    The mean interval, because containers round stamps: at 60 frames a second the median of rounded ones is 17 ms.
    """
    clock, series = as_float_array(time_s, "time_s", (None,)), as_float_array(values, "values", (None,))
    if clock.shape != series.shape or np.any(np.diff(clock) <= 0):
        raise DatasetError(
            f"spectrum: expected increasing time stamps, one a value, got {clock.size} stamps for "
            f"{series.size} values; sort or cut them"
        )
    found = np.flatnonzero(np.isfinite(series))
    if found.size < 2 or clock[found[-1]] - clock[found[0]] < _SHORTEST_S:
        return None
    count = int(found[-1] - found[0]) + 1
    if found.size < _FEWEST_VALID * count:
        return None
    grid: FloatArray = np.linspace(clock[found[0]], clock[found[-1]], count)
    return np.asarray(np.interp(grid, clock[found], series[found])), float(grid[1] - grid[0])


def _background(power: FloatArray, lines: IntArray) -> FloatArray:
    """Mean power of the noise around each line, from the median of the lines from half to twice its frequency."""
    if lines.size == 0:
        return np.zeros(0)
    octaves = np.log2(lines[-1] / lines[0])
    centres = lines[0] * 2 ** np.linspace(0, octaves, int(8 * octaves) + 2)
    medians = [np.median(power[int(centre / 2) : int(2 * centre) + 1]) for centre in centres]
    # The power of noise is exponentially distributed, with its median at ln 2 of the mean.
    return np.asarray(np.interp(lines, centres, np.array(medians)) / np.log(2))
