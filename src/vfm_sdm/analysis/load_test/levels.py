"""Static levels: what displacement is while a load stands, beside vibration, and when it stands."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.errors import DatasetError

__all__ = ["FEWEST_SAMPLES", "LEVEL_FREEDOM", "Level", "find_level", "find_plateaus"]

FEWEST_SAMPLES = 20
"""Samples below which a level has no scatter to be known by."""
_LINES = range(3, 9)
"""Lines of frequency at which the scatter of a level is read, in inverse lengths of its interval: beyond what the
weights' own lobe covers, and still slow."""
LEVEL_FREEDOM = 2 * len(_LINES)
"""Degrees of freedom with which the scatter of a level is known."""
_BLOCKS = 600
"""Blocks into which a recording is divided, to find when it stands still."""
_MARGIN = 1 / 6
"""Share of a stretch that is left out at either end: the slow beginning of a movement hides in vibration."""
_GAP_COST = 9.0
"""Cost of a block that belongs to no step, a value: as of one that is three standard deviations off."""


@dataclass(frozen=True)
class Level:
    """A static level.

    Parameters
    ----------
    value_mm
        Weighted mean [mm].
    std_mm
        Its standard deviation by scatter, vibration included [mm].
    freedom
        Degrees of freedom with which that is known.
    """

    value_mm: float
    std_mm: float
    freedom: int


def find_level(values: FloatArray, ok: BoolArray) -> Level:
    """The level of evenly spaced samples beside vibration; NaN where too few are known.

    Parameters
    ----------
    values
        Displacement while the load stands, shape (N,) [mm].
    ok
        Samples that count, shape (N,).

    Notes
    -----
    Weights that rise and fall as a raised cosine (Hann's window) let less than a thousandth of a vibration of five
    periods through, of which a plain mean may keep a fifteenth. The scatter of the level is what the same weights find
    at neighbouring frequencies, from three to eight lines up: noise that is as strong there as at rest, such as white
    noise or the beating of a mode, is stated as large as it is, with twelve degrees of freedom.

    Examples
    --------
    >>> seconds = np.arange(600) / 30
    >>> level = find_level(2.0 + 0.3 * np.sin(2 * np.pi * 2.2 * seconds), np.ones(600, bool))
    >>> round(level.value_mm, 3), level.std_mm < 0.001
    (2.0, True)
    """
    count = len(values)
    good = ok & np.isfinite(values)
    if good.sum() < FEWEST_SAMPLES:
        return Level(float("nan"), float("nan"), 0)
    place = (np.arange(count) + 0.5) / count
    weights = np.where(good, 1 - np.cos(2 * np.pi * place), 0.0)
    weights /= weights.sum()
    filled = np.where(good, values, 0.0)
    value = float(weights @ filled)
    waves = np.exp(-2j * np.pi * np.outer(_LINES, place))
    beside = waves @ (weights * (filled - value))
    std = float(np.sqrt(np.mean(np.abs(beside) ** 2)))
    return Level(value, std, LEVEL_FREEDOM)


def find_plateaus(time_s: FloatArray, series: FloatArray, count: int) -> list[tuple[float, float]]:
    """When displacement stood still, as often as asked for, in order [s].

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    series
        Displacement of all points and axes that move, shape (T, S) [mm]; NaN where it is not known.
    count
        Number of steps.

    Raises
    ------
    DatasetError
        The recording is too short for so many steps, or too little of it was seen.

    Notes
    -----
    Means of blocks, in units of their scatter from one to the next, are divided into so many stretches of one level
    each with loading between them, so that the squared deviations from the levels and a constant cost of each block of
    loading are least; by dynamic programming, exactly. What was not seen is known to be neither: it costs as loading
    does wherever it lies, a stretch is seen for half of its blocks at least, and it begins and ends with a seen one.
    """
    blocks = min(_BLOCKS, len(time_s) // FEWEST_SAMPLES)
    if blocks < 3 * count:
        raise DatasetError(
            f"load test: expected a recording in which {count} steps can be told, got {len(time_s)} frames; state "
            "begin_s and end_s of every step"
        )
    edges = np.linspace(0, len(time_s), blocks + 1).astype(int)
    scaled = _scale_blocks(np.stack([_block_mean(series[a:b]) for a, b in pairwise(edges)]))
    seen = np.asarray(np.isfinite(scaled).any(axis=1))
    if seen.sum() < 3 * count:
        raise DatasetError(
            f"load test: expected a recording in which {count} steps are seen, got {seen.mean():.0%} of it with points "
            "that are; state begin_s and end_s of every step"
        )
    found = []
    for begin, end in zip(*_divide(scaled, count), strict=True):
        first, last = begin + np.flatnonzero(seen[begin:end])[[0, -1]]
        found.append((float(time_s[edges[first]]), float(time_s[edges[last + 1] - 1])))
    return [(a + _MARGIN * (b - a), b - _MARGIN * (b - a)) for a, b in found]


def _block_mean(values: FloatArray) -> FloatArray:
    """Means of a block of samples, shape (N, S); NaN where less than half of it is known."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    means = np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(2 * count >= len(values), means, np.nan)


def _scale_blocks(means: FloatArray) -> FloatArray:
    """Means of blocks, shape (B, S), in units of their scatter from one to the next; zero where they have none."""
    scaled = np.full(means.shape, np.nan)
    for one, values in enumerate(means.T):
        change = np.diff(values)
        change = change[np.isfinite(change)]
        noise = 1.4826 * np.median(np.abs(change - np.median(change))) / np.sqrt(2) if change.size else 0.0
        scaled[:, one] = values / noise if noise > 0 else 0.0 * values
    return scaled


def _divide(scaled: FloatArray, count: int) -> tuple[list[int], list[int]]:
    """Beginnings and ends (exclusive) of so many stretches of blocks, shape (B, S), at the least cost."""
    size, series = scaled.shape
    known = np.isfinite(scaled)
    filled = np.where(known, scaled, 0.0)
    sums, counts = (np.vstack([np.zeros(series), np.cumsum(of, axis=0)]) for of in (filled, known))
    squares = np.concatenate([[0.0], np.cumsum((filled**2).sum(axis=1))])
    blocks_seen = np.concatenate([[0], np.cumsum(known.any(axis=1))])
    first, last = np.arange(size + 1)[:, None], np.arange(size + 1)[None]
    spread = squares[None] - squares[:, None]
    for one in range(series):
        of_step = counts[None, :, one] - counts[:, None, one]
        spread = spread - (sums[None, :, one] - sums[:, None, one]) ** 2 / np.maximum(of_step, 1)
        spread += _GAP_COST * (last - first - of_step)
    in_step = blocks_seen[None] - blocks_seen[:, None]
    may_be = (in_step >= 2) & (2 * in_step >= last - first)
    cost = np.where(may_be, spread, np.inf)  # of a step from first to last
    gap = _GAP_COST * series
    # best[k, b]: k steps lie in the blocks before b, the last of which need not belong to one.
    best = gap * np.arange(size + 1.0)
    origin: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(count):
        total = best[:, None] + cost
        start = total.argmin(axis=0)
        ended = total[start, np.arange(size + 1)]
        # Then blocks of loading may follow.
        carried = ended - gap * np.arange(size + 1)
        end = np.arange(size + 1)
        for b in range(1, size + 1):
            if carried[b - 1] <= carried[b]:
                carried[b], end[b] = carried[b - 1], end[b - 1]
        origin.append((start, end))
        best = carried + gap * np.arange(size + 1)
    begins: list[int] = []
    ends: list[int] = []
    at = size
    for start, end in reversed(origin):
        stop = int(end[at])
        begins.insert(0, int(start[stop]))
        ends.insert(0, stop)
        at = begins[0]
    return begins, ends
