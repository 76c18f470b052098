"""The lag between two signals to a fraction of a sample, with its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline, make_interp_spline

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.stages.synchronize.search import Group, group_samples, log_explained
from vfm_sdm.stages.synchronize.signals import Signal

__all__ = ["SubsampleEstimator", "SubsampleLag"]

_STEPS = 20
_SMALLEST_STEP_S = 1e-7
_LEAST_NOISE = 1e-9
"""Least variance of a residual over that of its signal [1]."""
_AT_ENDS = 1e-3
"""The same for lags that are compared: near ends and gaps a band-pass errs by a few percent of the motion, because it
averages over fewer samples."""
_DEGREE = 5
_SMOOTHING_HZ = 1.0
"""Half width of the triangle over which the residual's spectrum is averaged."""


@dataclass(frozen=True)
class SubsampleLag:
    """A stationary point of the fit near a start value."""

    lag_s: float
    """Seconds by which the second signal happens later."""
    lag_std_s: float
    """Standard deviation of the lag [s]."""
    at_s: float
    """Time on the first clock that the lag belongs to [s]: centre of the information in it."""
    dependence: float
    """Dependence of the signals at this lag, as of `vfm_sdm.stages.synchronize.search.average_groups`."""
    correlation: float
    """Root of the share of the second signal's variance that the first explains."""
    independent_samples: float
    """Samples a channel, fewer where the residual is correlated in time."""
    converged: bool


_NO_PEAK = SubsampleLag(np.nan, np.nan, np.nan, -np.inf, np.nan, 0.0, converged=False)


@dataclass(frozen=True)
class _Fit:
    """One group's regression on the first clock: arrays (T, q), zero where a sample is missing."""

    residual: FloatArray
    direction: FloatArray
    """What a later second signal would change, weighted by the inverse residual covariance."""
    slope: FloatArray
    """Time derivative of the second signal."""
    dependence: float
    explained: float
    total: float
    samples: int
    parameters: int


class SubsampleEstimator:
    """Estimates lags between two signals to a fraction of a sample.

    Parameters
    ----------
    first, second
        Signals of one rate, in one band.
    groups
        Channels compared together; every group has its own mixture.
    fewest
        Samples of a group below which it does not count.

    Notes
    -----
    Model: b(t + lag) = M a(t) + e(t) with an unknown M and covariance of e for every group. The weighted residual is
    made orthogonal to M da/dt, the derivative of the *first* signal at its own samples, freed from a itself. The usual
    choice, the derivative of the interpolated b, would carry the same noise as the residual, and an interpolated noise
    is weaker between samples than on them: that pulls the lag towards half samples.

    The variance of the lag is that of sum(w e) over the squared slope of the equation, with the cross-spectra of e
    averaged over neighbouring frequencies. So residuals that are coloured, or shared by points (a shaking camera),
    count as what they are.
    """

    def __init__(self, first: Signal, second: Signal, groups: Sequence[Group], *, fewest: float = 0.0) -> None:
        self.first, self.second, self.groups, self.fewest = first, second, groups, fewest
        self._rates_a = np.asarray(CubicSpline(first.time_s, first.values).derivative()(first.time_s))
        self._curves_a = make_interp_spline(first.time_s, first.values, k=min(_DEGREE, len(first.values) - 1))
        self._curves_b = CubicSpline(second.time_s, second.values)
        self._rates_b = self._curves_b.derivative()

    def estimate(self, start_lag_s: float, window_s: tuple[float, float] | None = None) -> SubsampleLag:
        """Lag at which a mixture of the first signal fits the second best, near a start value.

        Parameters
        ----------
        start_lag_s
            Start value, within about a quarter period of the fastest motion [s].
        window_s
            Beginning and end of the part of the first clock that is used, shape (2,) [s]; all of it without.

        Examples
        --------
        >>> time_s = np.arange(900) / 30
        >>> one, two = (np.sin(2 * np.pi * 1.3 * t) + np.sin(2 * np.pi * 2.1 * t) for t in (time_s, time_s - 0.01))
        >>> first, second = (Signal(0.0, 30.0, s[:, None], np.ones((900, 1), dtype=bool)) for s in (one, two))
        >>> found = SubsampleEstimator(first, second, [((0,), (0,))]).estimate(0.0)
        >>> found.converged, round(found.lag_s, 4)
        (True, 0.01)
        """
        begin, end = np.searchsorted(self.first.time_s, window_s) if window_s is not None else (0, None)
        part = slice(int(begin), None if end is None else int(end))
        present = self._present(start_lag_s, part)
        lag = start_lag_s
        for _ in range(_STEPS):
            fits = self._fit(lag, present, part)
            information = sum(float((fit.direction * fit.slope).sum()) for fit in fits)
            if not information > 0:
                break
            step = -sum(float((fit.direction * fit.residual).sum()) for fit in fits) / information
            # A step of more than a sample leaves the peak that the search found.
            lag += float(np.clip(step, -1 / self.first.rate_hz, 1 / self.first.rate_hz))
            if abs(step) < _SMALLEST_STEP_S:
                return _summarise(fits, lag, self.first.time_s[part], self.first.rate_hz)
        return _NO_PEAK

    def dependences_at(self, *lags_s: float) -> list[float]:
        """Dependence of the signals at each of some lags [1], wherever it peaks.

        Parameters
        ----------
        *lags_s
            Seconds by which the second signal happens later [s].

        Returns
        -------
        dependences
            Of the samples that meet at all of these lags: where nearly all of a motion is explained, a single sample at
            an end changes more than the lag does. NaN where no group has enough of them.
        """
        present = self._present(lags_s[0], slice(None))
        for lag_s in lags_s[1:]:
            met = [(group, mask & self._shared_samples(group, lag_s)) for group, mask in present]
            present = [(group, mask) for group, mask in met if mask.sum() > max(4 * len(group[0]), self.fewest)]
        found = []
        for lag_s in lags_s:
            fits = self._fit(lag_s, present, slice(None))
            samples = sum(fit.samples for fit in fits)
            found.append(sum(fit.dependence * fit.samples for fit in fits) / samples if samples else float("nan"))
        return found

    def compare(self, lag_s: float, other_s: float) -> float:
        """Standard deviations by which one lag explains the second signal better than another [1].

        Parameters
        ----------
        lag_s, other_s
            Seconds by which the second signal happens later: the better lag, and another [s].

        Returns
        -------
        score
            Of zero mean and unit variance where both are as good; NaN where no group has enough samples at both.

        Notes
        -----
        Both lags predict the same samples of the second signal, and leave e1 and e2. The better one gains
        ``sum(d (e1 + e2))`` with ``d = e2 - e1``, after a filter that makes e1 and e2 white and keeps of each frequency
        the share of the signal that they leave explained (the same for both). Where both lags are as good, d and
        e1 + e2 are not correlated, and the variance of the sum is that of d against noise as the better lag leaves it:
        with its colour, and with what points share.

        References
        ----------
        .. [1] Knapp, C. H., Carter, G. C. (1976). The generalized correlation method for estimation of time delay. IEEE
           Transactions on Acoustics, Speech, and Signal Processing 24(4), 320-327.
        """
        ahead = self._curves_a(self.first.time_s + lag_s - other_s)
        total, rounding, apart, residuals = 0.0, 0.0, [], []
        for group, mask in self._present(lag_s, slice(None)):
            both = mask & self._known_ahead(group[0], lag_s - other_s)
            count = int(both.sum())
            if count <= max(4 * len(group[0]), self.fewest):
                continue
            b = self._curves_b(self.first.time_s[both] + lag_s)[:, list(group[1])]
            left = [_residual(values[both][:, list(group[0])], b) for values in (self.first.values, ahead)]
            added = _AT_ENDS * float(b.var()) + 1e-300
            whiten = np.linalg.inv(np.linalg.cholesky(left[0].T @ left[0] / count + added * np.eye(b.shape[1]))).T
            least = added * np.sum(whiten**2, axis=0)
            first, other, signal = (_spread_out(x @ whiten, both) for x in (*left, b - b.mean(axis=0)))
            keep = _explained_shares(signal, (first, other), count * least, self.first.rate_hz) * np.sqrt(count)
            # What is added counts as white noise.
            rounding += float(np.sum(least * np.sum(_filter(other - first, keep**2) ** 2, axis=0)))
            first, other = (_filter(x, keep) for x in (first, other))
            total += float(np.sum((other - first) * (first + other))) / 2
            apart.append(other - first)
            residuals.append(first / np.sqrt(count))
        if not apart:
            return float("nan")
        variance = rounding + _variance_of_sum(np.hstack(apart), np.hstack(residuals), self.first.rate_hz)
        return total / float(np.sqrt(variance)) if variance > 0 else float("nan")

    def _known_ahead(self, channels: Sequence[int], shift_s: float) -> BoolArray:
        """Samples of the first clock at which the first signal is known a shift later, (T,)."""
        valid = group_samples(self.first, channels)[1] > 0
        below = np.floor(np.arange(len(valid)) + shift_s * self.first.rate_hz).astype(int)
        inside = (below >= 0) & (below < len(valid) - 1)
        below = np.clip(below, 0, len(valid) - 2)
        return np.asarray(inside & valid[below] & valid[below + 1])

    def _present(self, lag_s: float, part: slice) -> list[tuple[Group, BoolArray]]:
        """The groups that count in a part of the first clock, each with its samples there."""
        masks = [(group, self._shared_samples(group, lag_s)[part]) for group in self.groups]
        return [(group, mask) for group, mask in masks if mask.sum() > max(4 * len(group[0]), self.fewest)]

    def _fit(self, lag_s: float, present: Sequence[tuple[Group, BoolArray]], part: slice) -> list[_Fit]:
        """Regression of every group's b on its a at a lag."""
        time_s = self.first.time_s[part] + lag_s
        shifted, slopes = self._curves_b(time_s), self._rates_b(time_s)
        values, rates = self.first.values[part], self._rates_a[part]
        return [_fit_group(values, rates, shifted, slopes, group, mask) for group, mask in present]

    def _shared_samples(self, group: Group, lag_s: float) -> BoolArray:
        """Samples of the first clock at which both signals are valid, (T,)."""
        valid_a = group_samples(self.first, group[0])[1] > 0
        valid_b = group_samples(self.second, group[1])[1] > 0
        place = (self.first.time_s + lag_s - self.second.start_s) * self.second.rate_hz
        below = np.floor(place).astype(int)
        last = len(valid_b) - 1
        inside = (below >= 0) & (below < last)
        below = np.clip(below, 0, last - 1)
        return np.asarray(valid_a & inside & valid_b[below] & valid_b[below + 1])


def _fit_group(
    values_a: FloatArray, rates_a: FloatArray, values_b: FloatArray, rates_b: FloatArray, group: Group, mask: BoolArray
) -> _Fit:
    """Regression of one group's b on its a, over the samples of a mask."""
    columns_a, columns_b = list(group[0]), list(group[1])
    a, b = values_a[mask][:, columns_a], values_b[mask][:, columns_b]
    rate_a, rate_b = rates_a[mask][:, columns_a], rates_b[mask][:, columns_b]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    own, own_b, cross = a.T @ a, b.T @ b, a.T @ b
    inverse = np.linalg.pinv(own, rcond=1e-9, hermitian=True)
    mixture = inverse @ cross
    residual = b - a @ mixture
    spread = residual.T @ residual / len(a)
    spread += np.eye(len(spread)) * (_LEAST_NOISE * np.trace(own_b) / len(a) + 1e-300)
    direction = rate_a @ mixture
    direction = direction - direction.mean(axis=0)
    direction = (direction - a @ (inverse @ (a.T @ direction))) @ np.linalg.inv(spread)
    return _Fit(
        residual=_spread_out(residual, mask),
        direction=_spread_out(direction, mask),
        slope=_spread_out(rate_b, mask),
        dependence=float(log_explained(own, own_b, cross)),
        explained=float(np.trace(own_b) - (residual**2).sum()),
        total=float(np.trace(own_b)),
        samples=len(a),
        parameters=len(own) + 2,
    )


def _residual(values_a: FloatArray, values_b: FloatArray) -> FloatArray:
    """What a regression of b (T, q) on a (T, p) leaves, shape (T, q)."""
    a, b = values_a - values_a.mean(axis=0), values_b - values_b.mean(axis=0)
    return np.asarray(b - a @ (np.linalg.pinv(a.T @ a, rcond=1e-9, hermitian=True) @ (a.T @ b)))


def _explained_shares(signal: FloatArray, left: Sequence[FloatArray], least: FloatArray, rate_hz: float) -> FloatArray:
    """Amplitudes of a filter that whitens residuals and keeps what both leave explained, (F, q).

    Signal and residuals have shape (T, q); ``least``, shape (q,), is the least power of a residual at any frequency.
    """
    power = sum(_smooth_power(one, rate_hz) for one in left) / len(left) + least
    share = np.clip(1 - power / np.maximum(_smooth_power(signal, rate_hz), 1e-300), 0.0, 1.0)
    return np.asarray(np.sqrt(share / power))


def _filter(series: FloatArray, amplitudes: FloatArray) -> FloatArray:
    """Series (T, q) with each frequency times an amplitude (F, q), shape (N, q) with N of the padded transform."""
    length = _padded_length(len(series))
    return np.asarray(fft.irfft(amplitudes * fft.rfft(series, length, axis=0), length, axis=0))


def _smooth_power(series: FloatArray, rate_hz: float) -> FloatArray:
    """Power of series (T, q) averaged over neighbouring frequencies, (F, q): the sum of squares for white noise."""
    length = _padded_length(len(series))
    covariance = fft.irfft(np.abs(fft.rfft(series, length, axis=0)) ** 2, length, axis=0)
    return np.asarray(np.maximum(fft.rfft(covariance * _taper(length, rate_hz)[:, None], axis=0).real, 0.0))


def _padded_length(samples: int) -> int:
    return int(fft.next_fast_len(2 * samples, real=True))


def _taper(length: int, rate_hz: float) -> FloatArray:
    """Weights of covariances by their delay: averaging spectra over a triangle of frequencies, shape (N,)."""
    delay_s = np.minimum(np.arange(length), length - np.arange(length)) / rate_hz
    return np.asarray(np.sinc(delay_s * _SMOOTHING_HZ) ** 2)


def _spread_out(values: FloatArray, mask: BoolArray) -> FloatArray:
    """Values of the masked samples on the whole clock, zero elsewhere."""
    out = np.zeros((mask.size, values.shape[1]))
    out[mask] = values
    return out


def _summarise(fits: Sequence[_Fit], lag_s: float, time_s: FloatArray, rate_hz: float) -> SubsampleLag:
    """The lag, its uncertainty and its quality at the last step of the fit."""
    # Each channel's residual over the root of its samples: a point that is lost for long is not thought calmer.
    residual = np.hstack([fit.residual / np.sqrt(fit.samples) for fit in fits])
    direction = np.hstack([fit.direction for fit in fits])
    weight = np.sum([(fit.direction * fit.slope).sum(axis=1) for fit in fits], axis=0)
    information = float(weight.sum())
    samples = sum(fit.samples for fit in fits)
    mean_samples = sum(fit.samples**2 for fit in fits) / samples
    independent = mean_samples * _independent_share(residual)
    variance = _variance_of_sum(direction, residual, rate_hz)
    # The fit takes its parameters from the residual near the motion's frequencies, where the variance is read.
    nearby = min(independent, 2 * _SMOOTHING_HZ * mean_samples / rate_hz)
    variance *= nearby / max(nearby - max(fit.parameters for fit in fits), 1.0)
    explained, total = sum(fit.explained for fit in fits), sum(fit.total for fit in fits)
    return SubsampleLag(
        lag_s=lag_s,
        lag_std_s=float(np.sqrt(variance) / information),
        at_s=float((weight * time_s).sum() / information),
        dependence=sum(fit.dependence * fit.samples for fit in fits) / samples,
        correlation=float(np.sqrt(max(explained / total, 0.0))),
        independent_samples=independent,
        converged=True,
    )


def _independent_share(residual: FloatArray) -> float:
    """Independent squares a sample: 1 / sum of the squared autocorrelation, mean over channels of unit power."""
    power = np.abs(fft.fft(residual, axis=0)) ** 2
    power = (power / np.maximum(power.sum(axis=0), 1e-300)).mean(axis=1)
    # A raw spectrum scatters by 100 % in each channel, which its square would take for a coloured residual.
    scatter = 1 + 1 / residual.shape[1]
    return float(min(1.0, scatter * power.sum() ** 2 / max(len(power) * (power**2).sum(), 1e-300)))


def _variance_of_sum(weights: FloatArray, residual: FloatArray, rate_hz: float) -> float:
    """Variance of the sum of weights times a stationary residual, given over the root of its samples; both (T, Q)."""
    length = _padded_length(len(weights))
    spectrum_w, spectrum_e = fft.rfft(weights, length, axis=0), fft.rfft(residual, length, axis=0)
    taper = _taper(length, rate_hz)
    total = 0.0
    for w, e in zip(spectrum_w.T, spectrum_e.T, strict=True):
        covariance_w = fft.irfft(np.conj(w)[:, None] * spectrum_w, length, axis=0)
        covariance_e = fft.irfft(np.conj(e)[:, None] * spectrum_e, length, axis=0)
        total += float((taper[:, None] * covariance_w * covariance_e).sum())
    return max(total, 0.0)
