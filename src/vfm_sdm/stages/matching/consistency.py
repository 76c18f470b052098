"""One place for each point, chosen together: what cameras and face get wrong, they get wrong for all points alike."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.stages.matching.resemblance import LEAST_CORRELATION, Candidate, score

__all__ = ["ABSENT", "GATE", "ODDS", "choose_consistent", "condition"]

GATE = 18.4
"""Squared standardised distance of a place from where it is expected, in two dimensions, that one in 10,000 exceeds."""
ABSENT = float(score(LEAST_CORRELATION))
"""Value of saying that a point is not seen: that of a place that just resembles it, exactly where it is expected. What
lies three standard deviations from there must have a correlation of 0.9."""
ODDS = 3.0
"""Difference of the values of two places, or two choices, that decides between them: odds of 20 to 1."""
_SEEDS = 24
_SWEEPS = 6
_ROUNDING = 1e-9
_ONE_PLACE_PX = 10.0
"""Distance within which two choices mean the same: nearer places are told apart once the others are known [px]."""

_Choice = list[int | None]


def choose_consistent(
    position: FloatArray, covariance: FloatArray, candidates: Sequence[Sequence[Candidate]]
) -> _Choice:
    """The candidate of every point that together resemble and fit the expectation best.

    Parameters
    ----------
    position, covariance
        Expected pixels of P points, shapes (P, 2) [px] and (2 P, 2 P) [px2].
    candidates
        Candidates of every point.

    Notes
    -----
    The value of a choice is the sum of the scores less half the squared standardised distance of all places together
    from the expectation. Every candidate of the points that are least in doubt is tried as the first; the others follow
    from what it says of cameras and face, and are changed one by one while that helps. Where choices of about the same
    value put a point elsewhere, as when all of them may be one stiffener further, the point has no place.

    Returns
    -------
    choice
        Number of the candidate of every point; ``None`` where none fits, or several do.
    """
    problem = _Problem(position, covariance, candidates)
    doubt = [one[0].value - one[1].value if len(one) > 1 else np.inf for one in candidates]
    order = [i for i in np.argsort([-d for d in doubt], kind="stable") if candidates[i]]
    seeds = [(i, j) for i in order for j in range(len(candidates[i]))][:_SEEDS]
    nothing: _Choice = [None] * len(candidates)
    found = [(problem.value(nothing), nothing)]
    for i, j in seeds:
        value, choice = problem.improve([j if k == i else None for k in range(len(candidates))])
        if all(choice != other for _, other in found):
            found.append((value, choice))
    highest, best = max(found, key=lambda one: one[0])
    tied = [choice for value, choice in found if value > highest - ODDS]
    return [j if _agree(candidates[i], [choice[i] for choice in tied]) else None for i, j in enumerate(best)]


def _agree(candidates: Sequence[Candidate], chosen: Sequence[int | None]) -> bool:
    """Whether several choices give a point one and the same place, as far as they give it any."""
    places = [candidates[j].position for j in chosen if j is not None]
    return all(np.linalg.norm(place - places[0]) <= _ONE_PLACE_PX for place in places)


class _Problem:
    """Value of choices, and how to raise it."""

    def __init__(self, position: FloatArray, covariance: FloatArray, candidates: Sequence[Sequence[Candidate]]) -> None:
        self._covariance = covariance
        self._apart = [[one.position - p for one in row] for p, row in zip(position, candidates, strict=True)]
        self._own = [[one.covariance for one in row] for row in candidates]
        self._gain = [[one.score - ABSENT for one in row] for row in candidates]

    def improve(self, choice: _Choice) -> tuple[float, _Choice]:
        """A choice changed one point at a time while that raises its value, and the value."""
        value = self.value(choice)
        for _ in range(_SWEEPS):
            before = value
            for i, row in enumerate(self._gain):
                for j in (None, *range(len(row))):
                    tried = [*choice[:i], j, *choice[i + 1 :]]
                    other = self.value(tried) if j != choice[i] else -np.inf
                    if other > value + _ROUNDING:
                        choice, value = tried, other
            if value <= before:
                break
        return value, choice

    def value(self, choice: _Choice) -> float:
        """Sum of scores above absence less half the squared standardised distance from the expectation."""
        picked = [(i, j) for i, j in enumerate(choice) if j is not None]
        if not picked:
            return 0.0
        rows = [row for i, _ in picked for row in (2 * i, 2 * i + 1)]
        apart = np.concatenate([self._apart[i][j] for i, j in picked])
        total = self._covariance[np.ix_(rows, rows)]
        for place, (i, j) in enumerate(picked):
            total[2 * place : 2 * place + 2, 2 * place : 2 * place + 2] += self._own[i][j]
        return sum(self._gain[i][j] for i, j in picked) - float(apart @ np.linalg.solve(total, apart)) / 2


def condition(
    position: FloatArray, covariance: FloatArray, seen: Sequence[Candidate | None]
) -> tuple[FloatArray, FloatArray]:
    """Where points are expected once some were found.

    Parameters
    ----------
    position, covariance
        Expected pixels of P points, shapes (P, 2) [px] and (2 P, 2 P) [px2].
    seen
        What was found of every point.

    Returns
    -------
    position, covariance
        The same, given that.
    """
    found = [(i, one) for i, one in enumerate(seen) if one is not None]
    if not found:
        return position, covariance
    rows = np.concatenate([[2 * i, 2 * i + 1] for i, _ in found])
    apart = np.concatenate([one.position for _, one in found]) - position.reshape(-1)[rows]
    total = cho_factor(covariance[np.ix_(rows, rows)] + block_diag(*(one.covariance for _, one in found)))
    gain = cho_solve(total, covariance[rows]).T
    moved = position + (gain @ apart).reshape(-1, 2)
    return moved, np.asarray(covariance - gain @ covariance[rows])
