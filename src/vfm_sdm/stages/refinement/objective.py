"""The objective of the refinement, its terms' scales, and its normal equations."""

from dataclasses import dataclass, fields

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.errors import DatasetError

__all__ = ["Baseline", "Objective", "SgrWeights", "make_objective"]

_RESOLUTION_PX = 1e-3
"""Least motion that counts as a scale: no tracker resolves less."""


@dataclass(frozen=True)
class SgrWeights:
    """Weights of the five terms of the objective; they multiply squared, normalised residuals [1].

    Parameters
    ----------
    longitudinal
        Weight of displacement along the suppressed axis; w_Z,abs of the paper.
    longitudinal_rate
        Weight of its difference between neighbouring frames; w_Z,diff.
    others
        Weight of the departure from the baseline triangulation along the two other axes; w_XY,abs.
    others_rate
        Weight of that departure's difference between neighbouring frames; w_XY,diff.
    pixel
        Weight of the pixel correction; w_2d.

    Raises
    ------
    DatasetError
        A weight is negative or not finite, or ``pixel`` is zero, which would leave points undetermined.
    """

    longitudinal: float = 4.0
    longitudinal_rate: float = 8.0
    others: float = 6.0
    others_rate: float = 12.0
    pixel: float = 0.05

    def __post_init__(self) -> None:
        weights = {f.name: getattr(self, f.name) for f in fields(self)}
        if not all(np.isfinite(w) and w >= 0 for w in weights.values()) or self.pixel == 0:
            raise DatasetError(f"weights: expected finite values >= 0 and pixel > 0, got {weights}; correct them")


@dataclass(frozen=True, eq=False)
class Baseline:
    """Triangulation of P points in T frames without correction.

    Parameters
    ----------
    position, slope
        Positions along the axes (suppressed, other, other), and their change with the pixel coordinate that is refined,
        shape (3, P, T) [m, m/px].
    valid, reference
        Samples that take part, and those whose mean is the origin of displacement, shape (P, T).
    origin
        Positions that displacement is relative to instead, shape (3, P) [m]; NaN where those samples tell.
    """

    position: FloatArray
    slope: FloatArray
    valid: BoolArray
    reference: BoolArray
    origin: FloatArray | None = None

    def of(self, chosen: BoolArray) -> "Baseline":
        """The chosen points alone, from shape (P,)."""
        origin = None if self.origin is None else self.origin[:, chosen]
        position, slope = self.position[:, chosen], self.slope[:, chosen]
        return Baseline(position, slope, self.valid[chosen], self.reference[chosen], origin)

    def displacement(self) -> FloatArray:
        """Positions relative to the origin, shape (3, P, T) [m]."""
        found = _mean(self.position, self.reference)
        if self.origin is not None:
            found = np.where(np.isfinite(self.origin), self.origin, found)
        return self.position - found[..., None]


@dataclass(frozen=True, eq=False)
class Objective:
    """The objective for P points of T frames, with everything that stays fixed during the iteration.

    Parameters
    ----------
    target
        Positions along the axes (suppressed, other, other) that leave no residual, shape (3, P, T) [m]: the origin
        along the suppressed axis, the baseline triangulation along the others.
    valid
        Samples that take part, shape (P, T).
    level, rate
        Weight over squared scale of each axis' residual and of its difference in time, shape (3, P, 1) [1/m2].
    pixel
        Weight over squared scale of the pixel correction, shape (P, 1) [1/px2].
    """

    target: FloatArray
    valid: BoolArray
    level: FloatArray
    rate: FloatArray
    pixel: FloatArray

    @property
    def linked(self) -> BoolArray:
        """Whether a sample and its successor both take part, shape (P, T - 1)."""
        return np.asarray(self.valid[:, 1:] & self.valid[:, :-1])

    def departure(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Departure from the target, and its differences in time.

        Parameters
        ----------
        position
            Positions along the axes (suppressed, other, other), shape (3, P, T) [m].

        Returns
        -------
        departure, change
            Shapes (3, P, T) and (3, P, T - 1) [m]; zero where not valid.
        """
        departure = np.where(self.valid, position - self.target, 0.0)
        return departure, np.where(self.linked, np.diff(departure), 0.0)

    def cost(self, position: FloatArray, correction: FloatArray) -> FloatArray:
        """Objective of each point, shape (P,) [1].

        Parameters
        ----------
        position
            Positions along the axes (suppressed, other, other), shape (3, P, T) [m].
        correction
            Corrections of the pixel coordinate, shape (P, T) [px].

        Examples
        --------
        >>> time = np.arange(200) / 30
        >>> motion = np.stack([0.001 * np.cos(31 * time), 0.002 * np.sin(9 * time), 0.005 * np.sin(9 * time)])[:, None]
        >>> slope, valid = np.full((3, 1, 200), 0.004), np.ones((1, 200), dtype=bool)
        >>> pixel = 100 + 3 * motion[0] / 0.004
        >>> objective = make_objective(Baseline(motion, slope, valid, valid), pixel, SgrWeights())
        >>> without, half = np.zeros((1, 200)), motion.copy()
        >>> half[0] /= 2
        >>> bool(objective.cost(half, without)[0] < objective.cost(motion, without)[0])
        True
        """
        departure, change = self.departure(position)
        terms = np.einsum("ap,apt,apt->p", self.level[..., 0], departure, departure)
        terms += np.einsum("ap,apt,apt->p", self.rate[..., 0], change, change)
        return np.asarray(terms + np.einsum("p,pt,pt->p", self.pixel[:, 0], correction, correction))

    def normal_equations(
        self, position: FloatArray, slope: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Half the gradient and the tridiagonal Gauss-Newton matrix of each point.

        Parameters
        ----------
        position, slope
            Positions [m] and their change with the correction [m/px], shape (3, P, T); the slope is zero where not
            valid.
        correction
            Corrections of the pixel coordinate, shape (P, T) [px].

        Returns
        -------
        gradient, diagonal
            Half the gradient, shape (P, T) [1/px], and the diagonal of the matrix, shape (P, T) [1/px2].
        beside
            Element above the diagonal, shape (P, T) [1/px2]: entry t couples frames t - 1 and t; zero at t = 0 and over
            gaps.
        """
        departure, change = self.departure(position)
        pull = self.level * departure
        pull[..., 1:] += self.rate * change
        pull[..., :-1] -= self.rate * change
        gradient = np.einsum("apt,apt->pt", slope, pull) + self.pixel * correction
        neighbours = np.zeros(self.valid.shape)
        neighbours[:, 1:] += self.linked
        neighbours[:, :-1] += self.linked
        diagonal = np.einsum("apt,apt->pt", slope * slope, self.level + self.rate * neighbours) + self.pixel
        beside = np.zeros(self.valid.shape)
        beside[:, 1:] = -np.einsum("ap,apt,apt->pt", self.rate[..., 0], slope[..., 1:], slope[..., :-1]) * self.linked
        return gradient, diagonal, beside


def make_objective(baseline: Baseline, pixel: FloatArray, weights: SgrWeights) -> Objective:
    """The objective around a baseline triangulation.

    Parameters
    ----------
    baseline
        The triangulation; each point has an origin, or a sample of reference.
    pixel
        The pixel coordinate that is refined, shape (P, T) [px].
    weights
        Weights of the terms.

    Notes
    -----
    Scales, per point, from the baseline and then held fixed: the root mean square over the valid samples of
    displacement along the suppressed axis; of its difference in time; of in-plane displacement, the length of the
    vector along the two other axes; of that vector's difference; and of the pixel's own motion. Displacement and pixel
    motion are relative to the origin. A scale is at least what a thousandth of a pixel makes, so that a point at rest
    divides by no zero.

    Examples
    --------
    >>> time = np.arange(200) / 30
    >>> motion = np.stack([0.001 * np.cos(31 * time), 0.002 * np.sin(9 * time), 0.005 * np.sin(9 * time)])[:, None]
    >>> slope, valid = np.full((3, 1, 200), 0.004), np.ones((1, 200), dtype=bool)
    >>> pixel = 100 + 3 * motion[0] / 0.004
    >>> objective = make_objective(Baseline(motion, slope, valid, valid), pixel, SgrWeights())
    >>> objective.target.shape, objective.level.shape
    ((3, 1, 200), (3, 1, 1))
    """
    slope, valid, displacement = baseline.slope, baseline.valid, baseline.displacement()
    # Without samples of reference, of a later part of a recording, the pixel's own mean will do for its scale.
    rest = np.where(baseline.reference.any(axis=1, keepdims=True), baseline.reference, valid)
    level = np.where(valid, displacement, 0.0)
    linked = valid[:, 1:] & valid[:, :-1]
    rate = np.where(linked, np.diff(level), 0.0)
    motion = np.where(valid, pixel - _mean(pixel, rest)[:, None], 0.0)
    samples, pairs = valid.sum(axis=1), np.maximum(linked.sum(axis=1), 1)

    least = (_RESOLUTION_PX**2 * np.einsum("apt,apt->p", slope, slope) / samples)[None]
    level_square = np.maximum(_sum_by_term(np.einsum("apt,apt->ap", level, level) / samples), least)
    rate_square = np.maximum(_sum_by_term(np.einsum("apt,apt->ap", rate, rate) / pairs), least)
    pixel_square = np.maximum(np.einsum("pt,pt->p", motion, motion) / samples, _RESOLUTION_PX**2)

    target = baseline.position.copy()
    target[0] -= displacement[0]
    return Objective(
        target,
        valid,
        np.array([weights.longitudinal, weights.others, weights.others])[:, None, None] / level_square[..., None],
        np.array([weights.longitudinal_rate, weights.others_rate, weights.others_rate])[:, None, None]
        / rate_square[..., None],
        (weights.pixel / pixel_square)[:, None],
    )


def _sum_by_term(squares: FloatArray) -> FloatArray:
    """Mean squares of the terms from those of the axes, shape (3, P) both: the two other axes share theirs."""
    together = squares[1] + squares[2]
    return np.stack([squares[0], together, together])


def _mean(values: FloatArray, chosen: BoolArray) -> FloatArray:
    """Mean over the chosen samples, (..., P, T) to (..., P); 0 without any."""
    return np.asarray(np.where(chosen, values, 0.0).sum(axis=-1) / np.maximum(chosen.sum(axis=-1), 1))
