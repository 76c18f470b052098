"""A smooth field through many points: a Gaussian process whose covariance is learnt from the recording itself."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import cho_factor, cho_solve

from vfm_sdm.analysis.field.errors import PointErrors, measure_errors
from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray

__all__ = ["FittedAxis", "fit_axis"]

_MOST_TERMS, _POINTS_A_TERM = 16, 3
_ROUNDS = 12
_OUTLIER, _TIMES_MEDIAN = 5.0, 2.0
_GAIN_OUTLIER = 0.03
_MOST_SAMPLES = 2000
"""Samples from which covariances are learnt: more say the same."""
_LEAST_PRIOR = 1e-9
_BEYOND = 0.5 ** np.arange(8)
"""Variance of the terms beyond the last over that of the last two: shapes fade, how fast is not known."""
_KNOWN_TERMS = 5
"""Terms from which on the last two show whether shapes have faded; below, what is beyond is taken to be as large."""
_SHOWN = 3.0
"""Variance of a term over what the points leave open of it, above which it is more than noise [1]."""


@dataclass(frozen=True, eq=False)
class FittedAxis:
    """The field along one axis.

    Parameters
    ----------
    coefficients
        Coefficients of the M terms, shape (T, M) [mm]; NaN where too few points were seen.
    reach_m
        First and last station of the points [m], between which the terms are defined.
    prior
        Covariance of the coefficients over the recording, shape (M, M) [mm2].
    errors
        Errors of the points that were used.
    used
        Which of the P points were used, shape (P,).
    station_m, distance_m
        Stations (U,) [m] of those, and distances between them (U, U) [m].
    beyond_mm2
        Variance of the first term beyond the last, which so few points cannot tell [mm2].
    """

    coefficients: FloatArray
    reach_m: tuple[float, float]
    prior: FloatArray
    errors: PointErrors
    used: BoolArray
    station_m: FloatArray
    distance_m: FloatArray
    beyond_mm2: float

    def terms(self, station_m: FloatArray) -> FloatArray:
        """Terms of the field at stations, shape (S, M) [1].

        Parameters
        ----------
        station_m
            Stations, shape (S,) [m].
        """
        return _terms(station_m, self.reach_m, self.coefficients.shape[1])

    def variances(self, station_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Variance of the field at rest (S,) [mm2], and what it grows by with the square of motion (S,) [1].

        Parameters
        ----------
        station_m
            Stations, shape (S,) [m].

        Notes
        -----
        Noise that reaches the field through its weights, neighbours' common errors included, what the terms'
        covariance leaves undetermined between the points, and terms beyond the last, which a few points do not show
        and which reach the field through the same weights.
        """
        here, points = self.terms(station_m), self.terms(self.station_m)
        mean_square = np.einsum("pm,mk,pk->p", points, self.prior, points)
        covariance = _covariance(self.errors, self.distance_m, mean_square)
        weights = here @ _solve(points, covariance, self.prior)[1]
        missed = here - weights @ points
        still = np.einsum("sm,mk,sk->s", missed, self.prior, missed)
        still += np.einsum("sp,pq,sq->s", weights, self.errors.covariance(self.distance_m), weights)
        count = here.shape[1]
        more = [_terms(one, self.reach_m, count + len(_BEYOND))[:, count:] for one in (station_m, self.station_m)]
        still += self.beyond_mm2 * np.square(more[0] - weights @ more[1]) @ _BEYOND
        correlation = self.errors.correlation(self.distance_m)
        growing = self.errors.gain_std**2 * np.einsum("sp,pq,sq->s", weights, correlation, weights)
        return np.asarray(still), np.asarray(growing)


def fit_axis(displacement_mm: FloatArray, std_mm: FloatArray, place_m: FloatArray, usable: BoolArray) -> FittedAxis:
    """The field along one axis, and the points that it rests on.

    Parameters
    ----------
    displacement_mm
        Displacement of points, shape (T, P) [mm]; NaN where it is not to be trusted.
    std_mm
        Stated standard deviation of a sample, shape (P,) [mm], with which the fit begins.
    place_m
        Places of the points, vertical and longitudinal, shape (P, 2) [m]; the last is the station.
    usable
        Which of them may be used, shape (P,).

    Notes
    -----
    Displacement at station s is ``sum_k phi_k(s) c_k(t)`` with Legendre polynomials phi and normally distributed
    coefficients. Their covariance, and size and correlation of the points' errors, are found in turn, each from what
    the other leaves (expectation maximisation): the field is as stiff as the recording shows it to be. Points that
    depart much more than the others do are left out.
    """
    used = usable.copy()
    reach = float(place_m[used, 1].min()), float(place_m[used, 1].max())
    distinct = len(np.unique(place_m[used, 1].round(3)))
    terms = int(np.clip(distinct // _POINTS_A_TERM, 2, _MOST_TERMS))
    rows = np.linspace(0, len(displacement_mm) - 1, min(len(displacement_mm), _MOST_SAMPLES)).astype(int)
    sample = displacement_mm[rows]
    sample = sample[np.isfinite(sample[:, used]).sum(axis=1) >= terms]
    guess = np.broadcast_to(np.nanmean(sample[:, used], axis=1, keepdims=True), sample.shape).copy()
    errors = PointErrors(np.maximum(np.nan_to_num(std_mm[used], nan=1.0), 1e-3), 0.0, 0.0, 1.0)
    prior = np.eye(terms) * max(float(np.nanmean(sample[:, used] ** 2)), 1e-6)
    for number in range(_ROUNDS):
        station, distance = place_m[used, 1], _distances(place_m[used])
        points = _terms(station, reach, terms)
        values = sample[:, used]
        mean_square = np.einsum("pm,mk,pk->p", points, prior, points)
        covariance = _covariance(errors, distance, mean_square)
        posterior, weights = _solve(points, covariance, prior)
        # What a point lacks is put in as the field so far has it: else each pattern of gaps would be solved alone.
        coefficients = np.where(np.isfinite(values), values, guess[:, used]) @ weights.T
        prior = coefficients.T @ coefficients / len(coefficients) + posterior
        prior += _LEAST_PRIOR * np.trace(prior) / terms * np.eye(terms)
        field = coefficients @ points.T
        guess[:, used] = field
        leverage = np.einsum("pm,mp->p", points, weights)
        errors, gains = measure_errors(values - field, field, 1 - leverage, distance)
        bad = _find_bad(errors.std_mm, gains) if number < _ROUNDS - 2 else np.zeros(len(gains), np.bool_)
        if bad.any() and (~bad).sum() > 2 * terms:
            used[np.flatnonzero(used)[bad]] = False
            errors = PointErrors(errors.std_mm[~bad], errors.gain_std, errors.shared, errors.length_m)
    station, distance = place_m[used, 1], _distances(place_m[used])
    points = _terms(station, reach, terms)
    mean_square = np.einsum("pm,mk,pk->p", points, prior, points)
    covariance = _covariance(errors, distance, mean_square)
    coefficients = _fit(displacement_mm[:, used], points, covariance, prior)
    beyond = _vary_beyond(np.diag(prior), np.diag(_solve(points, covariance, prior)[0]))
    return FittedAxis(coefficients, reach, prior, errors, used, station, distance, beyond)


def _vary_beyond(prior: FloatArray, posterior: FloatArray) -> float:
    """Variance of the first term beyond the last [mm2], from those of M terms and what points leave open of them."""
    last = prior[-2:] if len(prior) < _KNOWN_TERMS else np.where(prior > _SHOWN * posterior, prior, 0.0)[-2:]
    return float(last.max())


def _terms(station_m: FloatArray, reach_m: tuple[float, float], count: int) -> FloatArray:
    """Legendre polynomials over the reach, shape (S, M) [1]."""
    low, high = reach_m
    return np.asarray(legendre.legvander(2 * (station_m - low) / max(high - low, 1e-9) - 1, count - 1))


def _distances(place_m: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(place_m[:, None] - place_m[None], axis=2))


def _covariance(errors: PointErrors, distance_m: FloatArray, mean_square: FloatArray) -> FloatArray:
    """Covariance of errors of points over the recording, shape (P, P) [mm2], gains and all."""
    growing = errors.gain_std * np.sqrt(np.maximum(mean_square, 0.0))
    return np.asarray(errors.covariance(distance_m) + np.outer(growing, growing) * errors.correlation(distance_m))


def _solve(points: FloatArray, covariance: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance of coefficients after the measurement (M, M) [mm2], and what takes points to them, (M, P) [1]."""
    weighted = cho_solve(cho_factor(covariance), points)
    posterior = np.linalg.inv(np.linalg.inv(prior) + points.T @ weighted)
    return np.asarray(posterior, np.float64), np.asarray(posterior @ weighted.T)


def _fit(values: FloatArray, points: FloatArray, covariance: FloatArray, prior: FloatArray) -> FloatArray:
    """Coefficients (T, M) [mm] of samples (T, P), each from the points that it has; NaN where these are too few."""
    known = np.isfinite(values)
    coefficients = np.full((len(values), points.shape[1]), np.nan)
    patterns, of_sample = np.unique(known, axis=0, return_inverse=True)
    of_sample = of_sample.reshape(-1)
    for number, pattern in enumerate(patterns):
        if pattern.sum() < points.shape[1]:
            continue
        rows = of_sample == number
        weights = _solve(points[pattern], covariance[np.ix_(pattern, pattern)], prior)[1]
        coefficients[rows] = values[np.ix_(rows, pattern)] @ weights.T
    return coefficients


def _find_bad(std_mm: FloatArray, gains: FloatArray) -> BoolArray:
    """Points that depart from the field as the others do not, shape (P,)."""
    middle = np.median(std_mm)
    spread = MAD_TO_STD * np.median(np.abs(std_mm - middle))
    noisy = std_mm > max(_TIMES_MEDIAN * middle, middle + _OUTLIER * spread)
    off = np.abs(gains - np.median(gains))
    return np.asarray(noisy | (off > max(_GAIN_OUTLIER, _OUTLIER * MAD_TO_STD * float(np.median(off)))))
