"""What an accelerometer's record does to displacement between any two times, exactly for what its band holds."""

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.ndimage import uniform_filter1d
from scipy.signal import resample

from vfm_sdm.analysis.fusion.kernels import FIRST
from vfm_sdm.core.arrays import FloatArray

__all__ = ["Drive", "keep_motion"]

_FINER = 4
"""Samples of the splines a sample of the sensor: band-limited interpolation up to there, splines from there on."""
_PAD_S = 2.0
_SHARES = np.linspace(0.0, 1.0, 9)
"""Exposures at which its effect is computed, as shares of the longest one."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_SMOOTHED_LINES = 9
_CLEAR = 5.0
"""Power over that of noise from which on the mean of so many lines is motion: noise alone gets there once in 1e10."""
_SLOWEST_HZ = 0.1
"""Frequency below which power is the drift of a sensor."""


def keep_motion(acceleration: FloatArray, noise_std: FloatArray, interval_s: float) -> FloatArray:
    """The acceleration at frequencies at which it stands clear of the sensor's noise, shape (T, A), in its unit.

    Parameters
    ----------
    acceleration
        Acceleration less its mean, shape (T, A).
    noise_std
        Standard deviation of white noise by axis, shape (A,), in the same unit.
    interval_s
        Time from sample to sample [s].

    Notes
    -----
    A gain that is told by the whole record comes out too small: where nothing moves, the record is noise, and
    displacement knows nothing of it.
    """
    count = len(acceleration)
    spectrum = np.fft.rfft(acceleration, axis=0)
    power = uniform_filter1d(np.abs(spectrum) ** 2 / count, _SMOOTHED_LINES, axis=0)
    noise = np.square(noise_std)
    share = np.where(power > _CLEAR * noise, 1 - noise / np.maximum(power, np.finfo(float).tiny), 0.0)
    share[np.fft.rfftfreq(count, interval_s) < _SLOWEST_HZ] = 0.0
    return np.asarray(np.fft.irfft(spectrum * share, count, axis=0))


class Drive:
    """Acceleration as splines, whose integrals are exact.

    Parameters
    ----------
    time_s
        Even times of the samples, shape (T,) [s].
    acceleration
        What drives: with the gains in use, then the motion that each of A axes shows, shape (T, 1 + A) [mm/s2].

    Notes
    -----
    Near half its sampling rate a signal is not what straight lines or splines between its samples say: at five samples
    a period, trapezoids integrate twice to three quarters of the amplitude. So the record is resampled by Fourier
    transforms first, with its ends continued by their mirror image through the last sample, which keeps slope.
    """

    def __init__(self, time_s: FloatArray, acceleration: FloatArray) -> None:
        interval = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
        pad = min(round(_PAD_S / interval), len(time_s) - 1)
        head = 2 * acceleration[0] - acceleration[pad:0:-1]
        tail = 2 * acceleration[-1] - acceleration[-2 : -pad - 2 : -1]
        padded = np.concatenate([head, acceleration, tail])
        # The transform takes the record as periodic; a straight line is taken off, so that its ends meet.
        line = np.linspace(0.0, 1.0, len(padded) + 1)[:-1, None]
        jump = padded[-1] - padded[0]
        fine = resample(padded - line * jump, _FINER * len(padded), axis=0)
        fine += np.linspace(0.0, 1.0, len(fine) + 1)[:-1, None] * jump
        inside = slice(_FINER * pad, _FINER * (pad + len(time_s) - 1) + 1)
        clock = time_s[0] + np.arange(_FINER * (len(time_s) - 1) + 1) * (interval / _FINER)
        self._acceleration: PPoly = CubicSpline(clock, fine[inside])
        self._velocity = self._acceleration.antiderivative(1)
        self._displacement = self._velocity.antiderivative(1)
        self._columns = acceleration.shape[1]

    def steps(self, times_s: FloatArray) -> FloatArray:
        """Steps from node to node, shape (N, 6 + 2 A); the first is none.

        Parameters
        ----------
        times_s
            Increasing times of the nodes, shape (N,) [s].

        Returns
        -------
        steps
            Duration [s]; density of noise beside that of the sensor, zero here [mm2/s3]; change of displacement and
            velocity with the lag [mm/s, mm/s2]; their change with the gains in use [mm, mm/s]; and for every axis of
            the sensor the change of displacement [mm], then of velocity [mm/s], with its gain.
        """
        a, v, s = (one(times_s) for one in (self._acceleration, self._velocity, self._displacement))
        steps = np.zeros((len(times_s), FIRST + 2 * (self._columns - 1)))
        dt = np.diff(times_s)
        steps[1:, 0] = dt
        steps[1:, 2] = v[1:, 0] - v[:-1, 0] - dt * a[:-1, 0]
        steps[1:, 3] = a[1:, 0] - a[:-1, 0]
        moved, faster = s[1:] - s[:-1] - dt[:, None] * v[:-1], v[1:] - v[:-1]
        steps[1:, 4], steps[1:, 5] = moved[:, 0], faster[:, 0]
        steps[1:, FIRST:] = np.concatenate([moved[:, 1:], faster[:, 1:]], axis=1)
        return steps

    def exposed(self, times_s: FloatArray, longest_s: float) -> FloatArray:
        """Mean displacement over exposures less that in their middle, shape (9, N, 1 + A) [mm].

        Parameters
        ----------
        times_s
            Middles of the exposures, shape (N,) [s].
        longest_s
            Longest exposure [s]; others are `share_exposed` of it.

        Notes
        -----
        The state's velocity and bias do not enter, for a mean over times that lie evenly about the middle takes out
        what is straight, and what a bias bends within an exposure is less than a thousandth of a micrometre.
        """
        found = np.zeros((len(_SHARES), len(times_s), self._columns))
        here = self._displacement(times_s)
        for number, share in enumerate(_SHARES[1:], start=1):
            half = share * longest_s / 2
            found[number] = sum(
                weight / 2 * (self._displacement(times_s + half * node) - here)
                for node, weight in zip(_NODES, _WEIGHTS, strict=True)
            )
        return found

    @staticmethod
    def share_exposed(exposed: FloatArray, share: float) -> FloatArray:
        """Effect of an exposure of a share of the longest one, from `exposed`, shape (N, 1 + A) [mm].

        Parameters
        ----------
        exposed
            Effects of nine exposures, shape (9, N, 1 + A) [mm].
        share
            Share of the longest exposure, from 0 to 1.
        """
        place = min(max(share, 0.0), 1.0) * (len(exposed) - 1)
        lower = min(int(place), len(exposed) - 2)
        # It grows with the square of the exposure.
        of = (place**2 - lower**2) / ((lower + 1) ** 2 - lower**2)
        return np.asarray(exposed[lower] + of * (exposed[lower + 1] - exposed[lower]))
