"""Second derivatives by differences."""

from collections.abc import Callable

import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["curvature"]


def curvature(cost: Callable[[FloatArray], float], at: FloatArray, *, step: float = 0.05) -> FloatArray:
    """Second derivatives of a smooth function of M values by central differences, shape (M, M).

    Parameters
    ----------
    cost
        The function.
    at
        Where, shape (M,).
    step
        Difference, in units of the values.

    Examples
    --------
    >>> curvature(lambda z: float(3 * z[0] ** 2 + z[0] * z[1]), np.zeros(2)).round(6).tolist()
    [[6.0, 1.0], [1.0, 0.0]]
    """
    count, here = len(at), cost(at)
    steps = step * np.eye(count)
    result = np.zeros((count, count))
    for i in range(count):
        result[i, i] = (cost(at + steps[i]) - 2 * here + cost(at - steps[i])) / step**2
        for j in range(i):
            corners = [cost(at + a * steps[i] + b * steps[j]) * a * b for a in (1, -1) for b in (1, -1)]
            result[i, j] = result[j, i] = sum(corners) / (4 * step**2)
    return result
