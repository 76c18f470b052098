"""Errors of many points: what each has of its own, what neighbours share, and what grows with the motion."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray

__all__ = ["PointErrors", "measure_errors"]

_BINS = 12
_LENGTHS = 40
_FEWEST_PAIRS = 20
_FLOOR_MM = 1e-6


@dataclass(frozen=True, eq=False)
class PointErrors:
    """Errors of P points along one axis, as their departures from a smooth field show them.

    Parameters
    ----------
    std_mm
        Standard deviation of each point, shape (P,) [mm]: noise, and what a point keeps for seconds.
    gain_std
        Standard deviation of what each point measures too large or too small by [1].
    shared
        Share of the variance that points side by side have in common [1].
    length_m
        Distance over which that falls to 37 % [m].
    """

    std_mm: FloatArray
    gain_std: float
    shared: float
    length_m: float

    def correlation(self, distance_m: FloatArray) -> FloatArray:
        """Correlation of errors of points by their distance, 1 of a point with itself.

        Parameters
        ----------
        distance_m
            Distances, shape (P, P) [m], of the same points in rows and columns.

        Examples
        --------
        >>> errors = PointErrors(np.ones(2), 0.0, 0.5, 1.0)
        >>> errors.correlation(np.array([[0.0, 1.0], [1.0, 0.0]])).round(3).tolist()
        [[1.0, 0.184], [0.184, 1.0]]
        """
        found = self.shared * np.exp(-distance_m / self.length_m)
        return np.where(np.eye(len(distance_m), dtype=np.bool_), 1.0, found)

    def covariance(self, distance_m: FloatArray) -> FloatArray:
        """Covariance of what does not grow with the motion, shape (P, P) [mm2].

        Parameters
        ----------
        distance_m
            Distances between the points, shape (P, P) [m].

        Examples
        --------
        >>> PointErrors(np.array([2.0]), 0.0, 0.5, 1.0).covariance(np.zeros((1, 1))).tolist()
        [[4.0]]
        """
        return np.asarray(np.outer(self.std_mm, self.std_mm) * self.correlation(distance_m))


def measure_errors(
    residual_mm: FloatArray, field_mm: FloatArray, freedom: FloatArray, distance_m: FloatArray
) -> tuple[PointErrors, FloatArray]:
    """Errors of points from what a smooth field leaves of their displacement, and the gain error of each.

    Parameters
    ----------
    residual_mm, field_mm
        Measured displacement less the field, and the field at the points, shape (T, P) [mm]; NaN where not measured.
    freedom
        Share of each point's variance that the field leaves in its residual, shape (P,) [1].
    distance_m
        Distances between the points, shape (P, P) [m].

    Returns
    -------
    errors, gains
        Errors, and what each point measures too large by, shape (P,) [1].

    Notes
    -----
    Residuals are not centred: what a point keeps for the whole recording is an error as well. Correlation is the mean
    of products of standardised residuals of all pairs by their distance, to which an exponential is fitted.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> motion = np.outer(np.sin(np.arange(400)), np.ones(30))
    >>> noise = rng.normal(0, 0.1, (400, 30))
    >>> apart = np.abs(np.subtract.outer(np.arange(30.0), np.arange(30.0)))
    >>> errors, gains = measure_errors(noise + 0.05 * motion, motion, np.ones(30), apart)
    >>> float(errors.std_mm.mean().round(2)), float(gains.mean().round(2)), errors.shared < 0.1
    (0.1, 0.05, True)
    """
    known = np.isfinite(residual_mm) & np.isfinite(field_mm)
    residual, field = (np.where(known, values, 0.0) for values in (residual_mm, field_mm))
    power = np.maximum((field**2).sum(axis=0), _FLOOR_MM)
    gains = (field * residual).sum(axis=0) / power
    left = residual - gains * field
    count = np.maximum(known.sum(axis=0), 1)
    std = np.sqrt(np.maximum((left**2).sum(axis=0) / count / np.clip(freedom, 0.1, 1.0), _FLOOR_MM**2))
    # Noise gives gains as well.
    scatter = (MAD_TO_STD * np.median(np.abs(gains - np.median(gains)))) ** 2
    gain_std = float(np.sqrt(max(scatter - float(np.median(std**2 / power)), 0.0)))
    shared, length = _fit_correlation(left / std, known, distance_m)
    return PointErrors(std, gain_std, shared, length), gains


def _fit_correlation(standard: FloatArray, known: BoolArray, distance_m: FloatArray) -> tuple[float, float]:
    """Share and length of the correlation of standardised residuals (T, P)."""
    together = known.astype(np.float64).T @ known.astype(np.float64)
    product = standard.T @ standard / np.maximum(together, 1)
    rows, columns = np.triu_indices(len(distance_m), 1)
    apart, alike = distance_m[rows, columns], product[rows, columns]
    reach = np.quantile(apart, 0.25) if apart.size >= _FEWEST_PAIRS else 0.0
    near = apart <= reach
    if near.sum() < _FEWEST_PAIRS or not reach > 0:
        return 0.0, 1.0
    edges = np.unique(np.quantile(apart[near], np.linspace(0, 1, _BINS + 1)))
    bins = np.clip(np.searchsorted(edges, apart[near], side="right") - 1, 0, len(edges) - 2)
    size = np.bincount(bins, minlength=len(edges) - 1)
    middle = np.bincount(bins, apart[near], minlength=len(size)) / np.maximum(size, 1)
    mean = np.bincount(bins, alike[near], minlength=len(size)) / np.maximum(size, 1)
    best = (np.inf, 0.0, 1.0)
    for length in np.geomspace(max(float(apart.min()) / 3, reach / 1000), reach, _LENGTHS):
        shape = np.exp(-middle / length)
        share = float(np.clip((size * shape * mean).sum() / (size * shape**2).sum(), 0.0, 1.0))
        loss = float((size * (mean - share * shape) ** 2).sum())
        if loss < best[0]:
            best = (loss, share, float(length))
    return best[1], best[2]
