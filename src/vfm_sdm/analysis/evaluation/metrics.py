"""Metrics of an estimated displacement against a reference: the paper's three, and others that show what they hide."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.filters import band_pass
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = [
    "Score",
    "correlation",
    "coverage",
    "gain",
    "nrmse_range",
    "rppae",
    "score",
    "skill",
]

_FEWEST_SAMPLES = 10


@dataclass(frozen=True)
class Score:
    """All metrics of one series against its reference; NaN where a metric is not defined or not known.

    Parameters
    ----------
    nrmse_range, correlation, rppae
        The paper's metrics [1].
    gain, gain_std
        Slope of the estimate on the reference and its standard deviation [1].
    skill
        Share of the reference's variance that the estimate explains: 1 is perfect, 0 is as bad as no motion at all
        [1].
    coverage
        Share of samples whose stated interval holds the reference [1].
    offset
        Mean of estimate minus reference, before it was removed if it was [unit of the series].
    lag_s
        How much later the estimate happens than the reference [s], as the caller passed it.
    samples
        Number of samples at which both series are known.
    band_hz
        Band that both series were filtered to here [Hz]; ``None`` when they were not.
    offset_removed
        Whether all metrics are those of the estimate less ``offset``.
    """

    nrmse_range: float
    correlation: float
    rppae: float
    gain: float
    gain_std: float
    skill: float
    coverage: float
    offset: float
    lag_s: float
    samples: int
    band_hz: tuple[float, float] | None
    offset_removed: bool


def score(
    estimate: npt.ArrayLike,
    reference: npt.ArrayLike,
    *,
    estimate_std: npt.ArrayLike | None = None,
    rate_hz: float | None = None,
    band_hz: tuple[float, float] | None = None,
    remove_offset: bool = False,
) -> Score:
    """All metrics of one estimated series against its reference.

    Parameters
    ----------
    estimate, reference
        The same quantity at the same times, shape (T,), both in mm or in another common unit; NaN where not known.
    estimate_std
        Stated standard deviation of each sample, shape (T,), in the same unit; the interval reaches `COVERAGE_FACTOR`
        of them to each side.
    rate_hz, band_hz
        Sampling rate [Hz], and the band [Hz] that both series are filtered to first (`band_pass`) where one is given.
    remove_offset
        Whether to take the mean difference from the estimate first, as is due where the zeros of the two are
        unrelated; without it the metrics are the paper's to the letter.

    Returns
    -------
    score
        All metrics; ``lag_s`` is NaN, because it is the caller who knows the lag.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, the reference does not move, or a band is given
        without the sampling rate.

    Notes
    -----
    Stated intervals are those of the samples as measured; `coverage` is therefore computed before any filtering. Pass
    no ``estimate_std`` where the reference itself lacks a part of the band.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> found = score(1.02 * truth + 0.5, truth, remove_offset=True)
    >>> round(found.gain, 3), round(found.offset, 2), round(found.nrmse_range, 3)
    (1.02, 0.5, 0.007)
    """
    values, truth = _check_shapes(estimate, reference)
    offset = _compute_mean_difference(values, truth)
    covered = float("nan")
    if estimate_std is not None:
        covered = coverage(values - offset if remove_offset else values, estimate_std, truth, k=COVERAGE_FACTOR)
    if band_hz is not None:
        if rate_hz is None:
            raise DatasetError("rate_hz: expected the sampling rate for filtering, got None; pass it with band_hz")
        values, truth = (band_pass(series, rate_hz, band_hz) for series in (values, truth))
        offset = _compute_mean_difference(values, truth)
    if remove_offset:
        values = values - offset
    slope, slope_std = gain(values, truth)
    return Score(
        nrmse_range=nrmse_range(values, truth),
        correlation=correlation(values, truth),
        rppae=rppae(values, truth),
        gain=slope,
        gain_std=slope_std,
        skill=skill(values, truth),
        coverage=covered,
        offset=offset,
        lag_s=float("nan"),
        samples=int(_find_known(values, truth).sum()),
        band_hz=band_hz,
        offset_removed=remove_offset,
    )


def nrmse_range(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Root mean square difference over the reference's range [1].

    Parameters
    ----------
    estimate, reference
        Series of one quantity, shape (T,), both in mm or in another common unit; only samples at which both are finite
        count.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, or the reference does not move.

    Notes
    -----
    Paper, section Evaluation metrics: ``sqrt(mean (e - r)^2) / (max r - min r)``; means are not removed.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> round(nrmse_range(truth + 0.1, truth), 3)
    0.05
    """
    e, r = _pair_samples(estimate, reference)
    return float(np.sqrt(np.mean((e - r) ** 2)) / np.ptp(r))


def correlation(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Pearson's correlation coefficient [1]; NaN for an estimate that does not move at all.

    Parameters
    ----------
    estimate, reference
        Series of one quantity, shape (T,), both in mm or in another common unit; only samples at which both are finite
        count.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, or the reference does not move.

    Notes
    -----
    Paper, section Evaluation metrics: ``sum (e - mean e)(r - mean r) / sqrt(sum (e - mean e)^2 sum (r - mean r)^2)``.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> round(correlation(1.02 * truth, truth), 3)
    1.0
    """
    e, r = _pair_samples(estimate, reference)
    e, r = e - e.mean(), r - r.mean()
    power = float(np.sqrt(np.sum(e**2) * np.sum(r**2)))
    return float(np.sum(e * r) / power) if np.ptp(e) > 0 else float("nan")


def rppae(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Relative error of the peak-to-peak amplitude, without its sign [1].

    Parameters
    ----------
    estimate, reference
        Series of one quantity, shape (T,), both in mm or in another common unit; only samples at which both are finite
        count.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, or the reference does not move.

    Notes
    -----
    Paper, section Evaluation metrics: ``|(max e - min e) - (max r - min r)| / (max r - min r)``. One wrong sample
    decides it.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> round(rppae(1.02 * truth, truth), 3)
    0.02
    """
    e, r = _pair_samples(estimate, reference)
    return float(abs(np.ptp(e) - np.ptp(r)) / np.ptp(r))


def gain(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[float, float]:
    """Slope of the regression of the estimate on the reference, and its standard deviation [1].

    Parameters
    ----------
    estimate, reference
        Series of one quantity, shape (T,), both in mm or in another common unit; only samples at which both are finite
        count.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, or the reference does not move.

    Notes
    -----
    ``e = c + gain r + residual`` by least squares. Residuals of displacement are correlated in time, so that the
    textbook's standard error is far too small; here their autocovariance enters with Bartlett weights over
    ``1.3 sqrt(T)`` samples ([1]_; the number of samples after [2]_). Missing samples
    count as zero there. Noise in the reference makes the slope smaller; nothing is corrected for that.

    References
    ----------
    .. [1] Newey, W. K., West, K. D. (1987). A simple, positive semi-definite, heteroskedasticity and autocorrelation
       consistent covariance matrix. Econometrica 55(3), 703-708.
    .. [2] Lazarus, E., Lewis, D. J., Stock, J. H., Watson, M. W. (2018). HAR inference: recommendations for practice.
       Journal of Business and Economic Statistics 36(4), 541-559.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> noise = np.random.default_rng(0).normal(0, 0.1, 200)
    >>> slope, slope_std = gain(1.02 * truth + noise, truth)
    >>> bool(abs(slope - 1.02) < 3 * slope_std)
    True
    """
    e, r = _pair_samples(estimate, reference)
    centred = r - r.mean()
    power = float(np.sum(centred**2))
    slope = float(np.sum(centred * e) / power)
    moments = np.zeros(np.shape(estimate))
    moments[_find_known(*_check_shapes(estimate, reference))] = centred * (e - e.mean() - slope * centred)
    lags = min(round(1.3 * np.sqrt(len(e))), len(moments) - 1)
    variance = float(np.sum(moments**2))
    for lag in range(1, lags + 1):
        variance += 2 * (1 - lag / (lags + 1)) * float(np.sum(moments[lag:] * moments[:-lag]))
    # n / (n - 2) for the two parameters that were fitted, as in the textbook's standard error.
    return slope, float(np.sqrt(max(variance, 0.0) * len(e) / (len(e) - 2)) / power)


def skill(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """How much better than "nothing moves" the estimate is: 1 perfect, 0 no better, negative worse [1].

    Parameters
    ----------
    estimate, reference
        Series of one quantity, shape (T,), both in mm or in another common unit; only samples at which both are finite
        count.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, or the reference does not move.

    Notes
    -----
    ``1 - sum (e - r)^2 / sum r^2`` with the mean of each removed, because the zero of a displacement is a choice.
    Unlike a range-normalised error it does not flatter where the reference has one large peak.

    References
    ----------
    .. [1] Murphy, A. H. (1988). Skill scores based on the mean square error and their relationships to the correlation
       coefficient. Monthly Weather Review 116(12), 2417-2424.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> round(skill(0.9 * truth, truth), 3)
    0.99
    """
    e, r = _pair_samples(estimate, reference)
    e, r = e - e.mean(), r - r.mean()
    return float(1 - np.sum((e - r) ** 2) / np.sum(r**2))


def coverage(
    estimate: npt.ArrayLike, estimate_std: npt.ArrayLike, reference: npt.ArrayLike, *, k: float = 2.0
) -> float:
    """Share of samples whose interval, estimate plus or minus k standard deviations, holds the reference [1].

    Parameters
    ----------
    estimate, estimate_std, reference
        Series, shape (T,), all in mm or in another common unit; only samples at which all three are finite count. NaN
        when fewer than 10 of the stated standard deviations are known, because nothing was stated then.
    k
        Half width of the interval in standard deviations.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known, a standard deviation is negative, or k is not positive.

    Examples
    --------
    >>> truth = np.sin(np.arange(200) / 8)
    >>> coverage(truth + 0.1, np.full(200, 0.06), truth)
    1.0
    """
    e, r = _check_shapes(estimate, reference)
    std = as_float_array(estimate_std, "estimate_std", (len(e),))
    if not k > 0:
        raise DatasetError(f"k: expected a factor > 0, got {k}; 2 is about 95 %")
    if np.any(std < 0):
        raise DatasetError(f"estimate_std: expected values >= 0, got {np.nanmin(std):g}; pass standard deviations")
    known = _find_known(e, r)
    _check_enough(known)
    known &= np.isfinite(std)
    if known.sum() < _FEWEST_SAMPLES:
        return float("nan")
    return float(np.mean(np.abs(e - r)[known] <= k * std[known]))


def _check_shapes(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    r = as_float_array(reference, "reference", (None,))
    return as_float_array(estimate, "estimate", (len(r),)), r


def _find_known(estimate: FloatArray, reference: FloatArray) -> BoolArray:
    return np.isfinite(estimate) & np.isfinite(reference)


def _check_enough(known: BoolArray) -> None:
    if known.sum() < _FEWEST_SAMPLES:
        raise DatasetError(
            f"estimate: expected at least {_FEWEST_SAMPLES} samples known together with the reference, got "
            f"{known.sum()}; check that the two overlap in time"
        )


def _compute_mean_difference(estimate: FloatArray, reference: FloatArray) -> float:
    known = _find_known(estimate, reference)
    _check_enough(known)
    return float(np.mean((estimate - reference)[known]))


def _pair_samples(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """The samples at which both are finite."""
    e, r = _check_shapes(estimate, reference)
    known = _find_known(e, r)
    _check_enough(known)
    e, r = e[known], r[known]
    if not np.ptp(r) > 0:
        raise DatasetError(f"reference: expected a signal that moves, got {r[0]:g} throughout; check the sensor")
    return e, r
