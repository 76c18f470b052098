"""What every statement and observation contributes to the uncertainty of the adjusted cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["Contribution", "list_contributions", "share_variance"]

_OTHERS = "other cameras that agree as well"
"""What the covariance holds beyond the adjustment: see `vfm_sdm.stages.cameras.hypotheses`."""
_LEAST = 1e-9
"""Share of the largest variance below which a direction of a contribution is rounding."""


@dataclass(frozen=True, eq=False)
class Contribution:
    """Part that one source has in the covariance of cameras and axes.

    Parameters
    ----------
    source
        What was stated or observed.
    factor
        Factor F of its part F F' of the covariance, shape (10 V + 3, k), in the parameters' units.
    """

    source: str
    factor: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Its part of the covariance, shape (10 V + 3, 10 V + 3)."""
        return np.asarray(self.factor @ self.factor.T)


def list_contributions(
    sources: Mapping[str, Sequence[int]], jacobian: FloatArray, influence: FloatArray
) -> tuple[Contribution, ...]:
    """Contributions of all sources; together they are the covariance.

    Parameters
    ----------
    sources
        Residuals by their source.
    jacobian
        Derivative of the R residuals, each over its standard deviation, by M parameters, shape (R, M) [1].
    influence
        Derivative of N results by the parameters, times the inverse of the normal matrix, shape (N, M).

    Notes
    -----
    An error e of residual i, in standard deviations, moves the parameters by ``(J'J)^-1 J_i' e``. Errors of different
    residuals are independent, so that the covariance is the sum of what each gives alone, and the parts add up to it
    because the normal matrix is the sum of all ``J_i' J_i``.

    Examples
    --------
    >>> jacobian = np.array([[1.0], [2.0]])
    >>> normal = np.linalg.inv(jacobian.T @ jacobian)
    >>> found = list_contributions({"prior": [0], "length": [1]}, jacobian, normal)
    >>> [(one.source, round(one.covariance.item(), 3)) for one in found], round(normal.item(), 3)
    ([('prior', 0.04), ('length', 0.16)], 0.2)
    """
    found = []
    for source, rows in sources.items():
        moved = influence @ jacobian[list(rows)].T
        # Thousands of matches move the results in no more directions than there are results.
        directions, sizes, _ = np.linalg.svd(moved, full_matrices=False)
        kept = sizes > _LEAST * sizes[:1]
        if kept.any():
            found.append(Contribution(source, directions[:, kept] * sizes[kept]))
    return tuple(found)


def share_variance(
    contributions: Sequence[Contribution], covariance: FloatArray, slope: FloatArray
) -> dict[str, float]:
    """Share of every source in the variance of a result, the largest first [1]; they add up to one.

    Parameters
    ----------
    contributions
        Of the cameras; may be empty, where nobody knows them.
    covariance
        Covariance of cameras and axes, shape (10 V + 3, 10 V + 3).
    slope
        Change of the result with their parameters, shape (10 V + 3,).

    Returns
    -------
    shares
        By source; empty where the result does not depend on the cameras, or nobody knows the contributions.

    Examples
    --------
    >>> parts = [Contribution("lens", np.array([[3.0]])), Contribution("baseline", np.array([[4.0]]))]
    >>> share_variance(parts, np.array([[25.0]]), np.array([1.0]))
    {'baseline': 0.64, 'lens': 0.36}
    """
    total = float(slope @ covariance @ slope)
    if not contributions or not total > 0:
        return {}
    shares = {one.source: float(np.sum(np.square(slope @ one.factor))) / total for one in contributions}
    rest = 1 - sum(shares.values())
    if rest > _LEAST**0.5:
        shares[_OTHERS] = rest
    return dict(sorted(shares.items(), key=lambda pair: -pair[1]))
