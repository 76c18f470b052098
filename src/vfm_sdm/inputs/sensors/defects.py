"""Samples that a sensor recorded and that are not true: clipped at the end of its range, stuck, or lost for a constant.

All three are equal values where a moving structure gives different ones, so each is told by how improbable its equal
values are beside the rest of the same recording. Nothing here knows a sensor's range or resolution.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, unbroken_runs
from vfm_sdm.core.statuses import ReadingStatus

__all__ = ["Reading", "find_defects", "find_held_samples"]


class Reading:
    """Codes of `vfm_sdm.core.statuses.ReadingStatus`, as arrays hold them."""

    OK, MISSING, CLIPPED, STUCK = range(len(ReadingStatus))


_SHORTEST_PLATEAU = 3
"""Equal samples that a parabola cannot pass through without a bulge between them."""
_STEPS_OF_BULGE = 3.0
"""Steps of the resolution by which a peak must have been cut; a rounded one is flat within about one."""
_TOUCHES, _TIMES_OTHERS, _LEVELS = 6, 6.0, 10
"""Samples at the outermost value, and how many times as many as at each of the next values. The outermost step of a
rounded sine holds 1 / (sqrt(11) - 1) * 10 = 4.3 times as many as the ten next ones."""
_NOISY_RAIL, _LONG_PLATEAU, _FEWEST_NOISY = 0.02, 4, 2
"""Share of the largest excursion within which tops are flat although there is noise on them, the samples that such a
top has at least, and how many such tops there must be."""
_IMPROBABLE = 1e-3
"""Expected number of runs of equal values as long, by chance, in the whole recording."""
_NEAR = 200
"""Samples on either side of a run that tell how often equal neighbours are usual there."""
_FAR_OUT = 5.0
"""Ranges of all other samples by which a repeated value must lie outside to be no reading at all."""
_JUMP, _JUMP_AT_ENDS, _FOLLOWING = 1.5, 3.0, 5
_SAME_LEVEL = 1e-9
_HELD_SHARE = 0.9


@dataclass(frozen=True)
class _Levels:
    """Values of a series, and the smallest step between them."""

    values: FloatArray
    counts: npt.NDArray[np.int64]
    step: float


def find_defects(values: FloatArray) -> npt.NDArray[np.int8]:
    """Which samples are no readings, as codes of `Reading`.

    Parameters
    ----------
    values
        Evenly sampled series of any unit, shape (T, A), each by itself; NaN where a sample is missing, infinity where
        the instrument reported an overload.

    Returns
    -------
    status
        Shape (T, A).

    Notes
    -----
    *Clipped*: three or more equal samples at the outermost value of a series, of which the neighbours say that the
    signal went on by more than three steps of the resolution: with the step d_m to the m-th sample beside a plateau of
    n, a parabola has the curvature c = d_m / (2 h m + m^2), h = (n - 1) / 2, and passes c h^2 above it. Or the
    outermost value is hit six times, and six times as often as each of the ten next to it: a peak-up that no vibration
    has. Then every sample with that value counts. Of a limit with noise on it the same holds with 2 % of the largest
    excursion for the step of resolution, twice, if at least two tops of four samples or more say so.

    *Stuck*: a run of equal values of which fewer than one in a thousand recordings holds one by chance, given how often
    neighbours are equal around it, and that ends in a jump. So a sensor of low resolution is not stuck where it rests.

    *Missing*: a value far outside all others, such as -9999, or exactly zero in an axis that is never near zero
    otherwise, on three samples or more.

    A series that has the same value throughout is left alone.

    Examples
    --------
    >>> time_s = np.arange(2000) / 200
    >>> rng = np.random.default_rng(0)
    >>> swing = np.sin(2 * np.pi * 1.7 * time_s) * np.exp(-0.2 * time_s) + rng.normal(0, 1e-3, 2000)
    >>> status = find_defects(np.clip(swing, -0.6, 2)[:, None])
    >>> bool((status[swing < -0.6] == Reading.CLIPPED).all()), int((status == Reading.STUCK).sum())
    (True, 0)
    """
    if find_held_samples(values) > 1:
        # Of a sensor that is read too often, what it gave counts, once each.
        known = np.where(np.isnan(values), np.inf, values)
        groups = np.concatenate([[0], np.cumsum((known[1:] != known[:-1]).any(axis=1))])
        once = find_defects(values[np.flatnonzero(np.diff(groups, prepend=-1))])
        return np.asarray(once[groups])
    status = np.zeros(values.shape, np.int8)
    absent = np.zeros(len(values), bool)
    for column in range(values.shape[1]):
        series, of_series = values[:, column], status[:, column]
        of_series[np.isnan(series)] = Reading.MISSING
        of_series[np.isinf(series)] = Reading.CLIPPED
        placeholders = _find_placeholders(series)
        of_series[placeholders] = Reading.MISSING
        absent |= placeholders & (series == 0)
        known = of_series == Reading.OK
        if known.sum() < _SHORTEST_PLATEAU or np.ptp(series[known]) == 0:
            continue
        plain = np.where(known, series, np.nan)
        levels = _find_levels(series[known])
        of_series[_find_stuck(plain, levels.step)] = Reading.STUCK
        for sign in (1.0, -1.0):
            at_limit = _find_clipped(sign * plain, levels, sign)
            of_series[at_limit] = Reading.CLIPPED
    status[absent[:, None] & (values == 0)] = Reading.MISSING  # zeros of a lost row look like readings near zero
    return status


def find_held_samples(values: FloatArray) -> int:
    """How many times each sample of all series is there: 1, or more where a slow sensor was read too often.

    Parameters
    ----------
    values
        Evenly sampled series of any unit, shape (T, A).

    Examples
    --------
    >>> find_held_samples(np.repeat(np.random.default_rng(0).normal(size=(100, 3)), 4, axis=0))
    4
    """
    moving = np.nanmax(values, axis=0) > np.nanmin(values, axis=0) if len(values) else np.array([], bool)
    if not moving.any():
        return 1
    changes = np.flatnonzero((values[1:, moving] != values[:-1, moving]).any(axis=1))
    lengths = np.diff(changes)
    if lengths.size < _LEVELS:
        return 1
    usual = int(np.median(lengths))
    return usual if usual > 1 and np.mean(lengths == usual) >= _HELD_SHARE else 1


def _find_placeholders(series: FloatArray) -> BoolArray:
    """Samples with a value that stands for none, such as -9999 or zeros in an axis that carries gravity."""
    result = np.zeros(len(series), bool)
    finite = np.isfinite(series)
    if not finite.any():
        return result
    candidates = {0.0, float(series[finite].min()), float(series[finite].max())}
    for value in candidates:
        here = finite & (series == value)
        rest = series[finite & ~here]
        if here.sum() < _SHORTEST_PLATEAU or rest.size < here.sum() or np.ptp(rest) == 0:
            continue
        outside = max(rest.min() - value, value - rest.max())
        # Zeros need less: that a sensor reads nothing else than exactly zero there is no accident.
        if outside > (0.5 if value == 0.0 else _FAR_OUT) * np.ptp(rest):
            result |= here
    return result


def _find_levels(known: FloatArray) -> _Levels:
    """Values of a series without the rounding of its arithmetic, how often each is there, and the step between them."""
    scale = _SAME_LEVEL * max(float(np.ptp(known)), _SAME_LEVEL * float(np.abs(known).max()))
    values, counts = np.unique(np.rint(known / scale).astype(np.int64), return_counts=True)
    gaps = np.diff(values)
    steps = gaps[gaps > 2]  # within two units of rounding, it is the same level
    group = np.concatenate([[0], np.cumsum(gaps > 2)])
    merged = np.bincount(group, weights=counts).astype(np.int64)
    level = values[np.concatenate([[True], gaps > 2])] * scale
    return _Levels(level, merged, float(steps.min() * scale) if steps.size else float(np.ptp(known)))


def _find_stuck(series: FloatArray, step: float) -> BoolArray:
    """Runs of equal values that are too long for chance, and left by a jump."""
    equal = np.diff(series) == 0
    result = np.zeros(len(series), bool)
    chances = max(int(np.isfinite(series).sum()), 1)
    for run in unbroken_runs(equal):
        length = run.stop - run.start
        if length < _SHORTEST_PLATEAU - 1:
            continue
        reach = max(_NEAR, length)
        before, after = equal[: max(run.start - 1, 0)][-reach:], equal[run.stop + 1 :][:reach]
        usual = max([(side.sum() + 1) / (side.size + 2) for side in (before, after) if side.size], default=1.0)
        improbable = chances * max(usual, 1 / (_NEAR + 2)) ** length < _IMPROBABLE
        if improbable and _is_amid_motion(series, run, step) and _is_left_by_a_jump(series, run, step):
            result[run.start : run.stop + 1] = True
    return result


def _is_amid_motion(series: FloatArray, run: slice, step: float) -> bool:
    """Whether the signal moved by more than its resolution on either side of a run: it did not in a lull."""
    reach = 2 * (run.stop - run.start) + _FOLLOWING
    sides = (series[max(run.start - reach, 0) : run.start], series[run.stop + 1 :][:reach])
    known = [side[np.isfinite(side)] for side in sides]
    return all(side.std() > _JUMP_AT_ENDS * step for side in known if side.size)


def _is_left_by_a_jump(series: FloatArray, run: slice, step: float) -> bool:
    """Whether the signal was elsewhere when a run of equal values ended; one that begins or ends in rest was not.

    A signal of low resolution leaves a rest by one step. Where rest is usual, as between impacts and at the beginning
    of a recording, it may leave by more, but not by more than it moves then; at the end of a recording, it must have
    been moving.
    """
    moves = np.diff(series)
    if run.stop >= len(moves):
        return run.start > 0 and bool(abs(moves[run.start - 1]) > _JUMP_AT_ENDS * step)
    jump, length = abs(moves[run.stop]), run.stop - run.start
    at_rest = int((series == series[run.start]).sum()) - length > length
    if run.start == 0 or at_rest:
        following = np.abs(moves[run.stop + 1 :][:_FOLLOWING])
        following = following[np.isfinite(following)]
        return following.size > 0 and bool(jump > _JUMP_AT_ENDS * max(step, float(np.max(following))))
    return bool(jump > _JUMP * step)


def _find_clipped(series: FloatArray, levels: _Levels, sign: float) -> BoolArray:
    """Samples at the highest value, where that is the end of the range."""
    top = float(np.nanmax(series))
    at_top = series >= top - levels.step / 2
    counts = levels.counts if sign < 0 else levels.counts[::-1]
    next_ones = counts[1 : 1 + _LEVELS]
    piled = (
        next_ones.size == _LEVELS and counts[0] >= _TOUCHES and counts[0] > _TIMES_OTHERS * float(np.mean(next_ones))
    )
    if piled or any(_is_cut(series, run, levels.step) for run in unbroken_runs(at_top)):
        return np.asarray(at_top)
    # A rail with noise on it: flat within a tolerance, for which the same holds as for a step of resolution.
    noise = _NOISY_RAIL * float(np.nanmax(np.abs(series - np.nanmedian(series))))
    near_top = series >= top - noise
    tops = [run for run in unbroken_runs(near_top) if run.stop - run.start >= _LONG_PLATEAU]
    fine = levels.step < noise / _LEVELS  # a rounded peak is as flat as its steps
    if fine and sum(_is_cut(series, run, 2 * noise) for run in tops) >= _FEWEST_NOISY:
        return np.asarray(near_top)
    return np.zeros(len(series), bool)


def _is_cut(series: FloatArray, plateau: slice, step: float) -> bool:
    """Whether the samples beside a plateau say that the signal went on above it."""
    length = plateau.stop - plateau.start
    if length < _SHORTEST_PLATEAU:
        return False
    half, beside = (length - 1) / 2, -(-length // 4)
    level = series[plateau.start]
    places = (plateau.start - beside, plateau.stop - 1 + beside)
    if places[0] < 0 or places[1] >= len(series):
        return False
    drops = level - series[list(places)]
    if not np.isfinite(drops).all():
        return False
    curvature = float(drops.min()) / (2 * half * beside + beside**2)
    return bool(curvature * half**2 > _STEPS_OF_BULGE * step)
