"""How far an estimated displacement is from a reference: the paper's three metrics, and what they hide."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.filters import band_pass

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
    """All figures of one series against its reference; NaN where a figure is not defined or not known.

    Parameters
    ----------
    nrmse_range, correlation, rppae
        The paper's metrics [1].
    gain, gain_std
        Slope of the estimate on the reference and its standard deviation [1].
    skill
        1 is perfect, 0 is as bad as no motion at all [1].
    coverage
        Share of samples whose stated interval holds the reference [1].
    offset
        Mean of estimate minus reference, before it was removed if it was [unit of the series].
    lag_s
        How much later the estimate happens than the reference [s]; as passed by the caller.
    samples
        Number of samples at which both are known.
    band_hz
        Band that both were filtered to here [Hz]; ``None`` when they were not.
    offset_removed
        Whether all figures are those of the estimate less ``offset``.
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
    k: float = 2.0,
    rate_hz: float | None = None,
    band_hz: tuple[float, float] | None = None,
    remove_offset: bool = False,
    lag_s: float = float("nan"),
) -> Score:
    """All figures of one estimated series against its reference.

    Parameters
    ----------
    estimate, reference
        The same quantity in the same unit at the same times, shape (T,); NaN where not known.
    estimate_std, k
        Stated standard deviation of each sample, shape (T,), and how many of them the interval is wide to each side.
    rate_hz, band_hz
        With a band, both series are filtered to it first (`band_pass`).
    remove_offset
        Whether to take the mean difference from the estimate first, as is due where the zeros of the two are
        unrelated; without it the metrics are the paper's to the letter.
    lag_s
        Lag left between the two, where the caller knows it; only carried along [s].

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, the reference does not move, or a band is given
        without the sampling rate.

    Notes
    -----
    Stated intervals are those of the samples as measured; `coverage` is therefore computed before any filtering. Pass
    no ``estimate_std`` where the reference itself lacks a part of the band.
    """
    values, truth = _same_shape(estimate, reference)
    offset = _mean_difference(values, truth)
    covered = float("nan")
    if estimate_std is not None:
        covered = coverage(values - offset if remove_offset else values, estimate_std, truth, k=k)
    if band_hz is not None:
        if rate_hz is None:
            raise DatasetError("rate_hz: expected the sampling rate for filtering, got None; pass it with band_hz")
        values, truth = (band_pass(series, rate_hz, band_hz) for series in (values, truth))
        offset = _mean_difference(values, truth)
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
        lag_s=float(lag_s),
        samples=int(_known(values, truth).sum()),
        band_hz=band_hz,
        offset_removed=remove_offset,
    )


def nrmse_range(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Root mean square difference over the reference's range [1].

    Parameters
    ----------
    estimate, reference
        Shape (T,), same unit; only samples at which both are finite count.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known in both, or the reference does not move.

    Notes
    -----
    Paper, section Evaluation metrics: ``sqrt(mean (e - r)^2) / (max r - min r)``; means are not removed.
    """
    e, r = _paired(estimate, reference)
    return float(np.sqrt(np.mean((e - r) ** 2)) / np.ptp(r))


def correlation(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Pearson's correlation coefficient [1]; NaN for an estimate that does not move at all.

    Parameters, errors and the choice of samples are those of `nrmse_range`; the formula is the paper's.
    """
    e, r = _paired(estimate, reference)
    e, r = e - e.mean(), r - r.mean()
    power = float(np.sqrt(np.sum(e**2) * np.sum(r**2)))
    return float(np.sum(e * r) / power) if np.ptp(e) > 0 else float("nan")


def rppae(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Relative error of the peak-to-peak amplitude, without its sign [1].

    Parameters, errors and the choice of samples are those of `nrmse_range`; the formula is the paper's. One wrong
    sample decides it.
    """
    e, r = _paired(estimate, reference)
    return float(abs(np.ptp(e) - np.ptp(r)) / np.ptp(r))


def gain(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[float, float]:
    """Slope of the regression of the estimate on the reference, and its standard deviation [1].

    Parameters, errors and the choice of samples are those of `nrmse_range`.

    Notes
    -----
    ``e = c + gain r + residual`` by least squares. Residuals of displacement are correlated in time, so that the
    textbook's standard error is far too small; here their autocovariance enters with Bartlett weights over
    ``1.3 sqrt(T)`` samples (Newey and West 1987; the number of samples after Lazarus et al. 2018). Missing samples
    count as zero there. Noise in the reference makes the slope smaller; nothing is corrected for that.

    References
    ----------
    Newey, W. K. and West, K. D. (1987), Econometrica 55(3), 703-708.
    Lazarus, E., Lewis, D. J., Stock, J. H. and Watson, M. W. (2018), J. Business & Economic Statistics 36(4), 541-559.
    """
    e, r = _paired(estimate, reference)
    centred = r - r.mean()
    power = float(np.sum(centred**2))
    slope = float(np.sum(centred * e) / power)
    moments = np.zeros(np.shape(estimate))
    moments[_known(*_same_shape(estimate, reference))] = centred * (e - e.mean() - slope * centred)
    lags = min(round(1.3 * np.sqrt(len(e))), len(moments) - 1)
    variance = float(np.sum(moments**2))
    for lag in range(1, lags + 1):
        variance += 2 * (1 - lag / (lags + 1)) * float(np.sum(moments[lag:] * moments[:-lag]))
    # n / (n - 2) for the two parameters that were fitted, as in the textbook's standard error.
    return slope, float(np.sqrt(max(variance, 0.0) * len(e) / (len(e) - 2)) / power)


def skill(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """How much better than "nothing moves" the estimate is: 1 perfect, 0 no better, negative worse [1].

    Parameters, errors and the choice of samples are those of `nrmse_range`.

    Notes
    -----
    ``1 - sum (e - r)^2 / sum r^2`` with the mean of each removed, because the zero of a displacement is a choice.
    Unlike a range-normalised error it does not flatter where the reference has one large peak.
    """
    e, r = _paired(estimate, reference)
    e, r = e - e.mean(), r - r.mean()
    return float(1 - np.sum((e - r) ** 2) / np.sum(r**2))


def coverage(
    estimate: npt.ArrayLike, estimate_std: npt.ArrayLike, reference: npt.ArrayLike, *, k: float = 2.0
) -> float:
    """Share of samples whose interval, estimate plus or minus k standard deviations, holds the reference [1].

    Parameters
    ----------
    estimate, estimate_std, reference
        Shape (T,), same unit; only samples at which all three are finite count. NaN when fewer than 10 of the stated
        standard deviations are known, because nothing was stated then.
    k
        Half width of the interval in standard deviations.

    Raises
    ------
    DatasetError
        Shapes differ, fewer than 10 samples are known, a standard deviation is negative, or k is not positive.
    """
    e, r = _same_shape(estimate, reference)
    std = as_float_array(estimate_std, "estimate_std", (len(e),))
    if not k > 0:
        raise DatasetError(f"k: expected a factor > 0, got {k}; 2 is about 95 %")
    if np.any(std < 0):
        raise DatasetError(f"estimate_std: expected values >= 0, got {np.nanmin(std):g}; pass standard deviations")
    known = _known(e, r)
    _check_enough(known)
    known &= np.isfinite(std)
    if known.sum() < _FEWEST_SAMPLES:
        return float("nan")
    return float(np.mean(np.abs(e - r)[known] <= k * std[known]))


def _same_shape(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    r = as_float_array(reference, "reference", (None,))
    return as_float_array(estimate, "estimate", (len(r),)), r


def _known(estimate: FloatArray, reference: FloatArray) -> BoolArray:
    return np.isfinite(estimate) & np.isfinite(reference)


def _check_enough(known: BoolArray) -> None:
    if known.sum() < _FEWEST_SAMPLES:
        raise DatasetError(
            f"estimate: expected at least {_FEWEST_SAMPLES} samples known together with the reference, got "
            f"{known.sum()}; check that the two overlap in time"
        )


def _mean_difference(estimate: FloatArray, reference: FloatArray) -> float:
    known = _known(estimate, reference)
    _check_enough(known)
    return float(np.mean((estimate - reference)[known]))


def _paired(estimate: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """The samples at which both are finite."""
    e, r = _same_shape(estimate, reference)
    known = _known(e, r)
    _check_enough(known)
    e, r = e[known], r[known]
    if not np.ptp(r) > 0:
        raise DatasetError(f"reference: expected a signal that moves, got {r[0]:g} throughout; check the sensor")
    return e, r
