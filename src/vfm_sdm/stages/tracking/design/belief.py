"""Which pixels around a point move with it: seen in sample frames, from the named place outwards."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.stages.tracking.design.window import SLOW_PX, Image, Window, soften

__all__ = ["DISTINCT_PX", "SURE", "Belief", "find_belief", "is_distinct"]

_SEEDS_PX = (3.0, 4.5, 6.5, 9.0, 13.0, 19.0, 28.0)
"""Radii (standard deviations) of the surroundings that are asked for the point's motion, the nearest first [px]."""
_SEED_STD_PX = 0.05
"""The first surroundings are believed whose motion has this standard deviation in its best direction [px]."""
_GROWTH = 3
_SMOOTH_PX, _AREA_PX = 1.2, 1.5
"""Softening against a codec's frozen noise, and the area over which pixels vote [px]."""
DISTINCT_PX = 0.1
"""Two motions that differ by less (rms over frames, both directions) are one: rotation and noise make as much [px]."""
SURE = 4.0
"""Standard deviations by which the vote of an area must leave one motion before it counts for the other."""
_VOTE_NOISE = 2 / (0.2 * 4 * np.pi * _AREA_PX**2)
"""Variance of an area's vote for unit variance of a softened pixel and unit mean square change: two noises, the pixels
of the area, and the fifth of white noise that softening keeps."""
_LEAST_AREA_PX = 30
_LAYER_PX = 400
"""Area on which a motion other than standing still must be seen: a codec moves blocks of 16 px by themselves [px]."""
_NEAR_PX = 10.0
"""Within this of what moves otherwise, what is unknown is more likely part of it: about a block's side [px]."""
_RESTLESS = 3.0
_RESTLESS_PX = 0.6
"""What is left of an area after its best motion must exceed the quiet noise by the first factor (std), and be more than
this motion would make of its texture [px], to be restless: moving shadows, leaves, water."""
_OTHERS = 2


@dataclass(frozen=True, eq=False)
class Belief:
    """What moves with a point in its surroundings.

    Parameters
    ----------
    motion
        Motion of the point in each sample frame, shape (K, 2) [px]; zero along a direction that nothing shows.
    covariance
        Of one frame's motion, shape (2, 2) [px2].
    believed
        Pixels that move with it, or of which nothing is known, shape (R, R).
    against
        Pixels that are seen to move otherwise, shape (R, R).
    supporting
        Pixels that are seen to move with it, shape (R, R).
    radius_px
        Radius (standard deviation) of the nearest surroundings that show its motion [px].
    noise
        Variance of a softened pixel in one frame, shape (R, R) [squared grey levels].
    rest
        Motions that what is behind or beside the point may have: none, and that of the air, shape (K, 2) each [px].
    """

    motion: FloatArray
    covariance: FloatArray
    believed: BoolArray
    against: BoolArray
    supporting: BoolArray
    radius_px: float
    noise: Image
    rest: Sequence[FloatArray]


def find_belief(window: Window, half_px: int, start: FloatArray | None = None) -> Belief:
    """What moves with the point in the middle of a window.

    Parameters
    ----------
    window
        The surroundings in the reference frame and in K sample frames.
    half_px
        Half the side of the square in which the point's motion is looked for [px].
    start
        Motion near which that of the point is, shape (K, 2) [px]; rest where left out.

    Notes
    -----
    1. The nearest surroundings that have texture show the point's motion d0, at least across an edge.
    2. Other motions are what stands still, and those of blocks that are seen to do something else; where nothing stands
       still, as in trembling air, also that of the window on the whole.
    3. Every area of the window votes between d0 and another motion d1: with J(d) the frames under a motion,
       t = sum (J(d0) - J(d1)) (I - J(d1)) / sum (J(d0) - J(d1))^2 over its pixels and all frames is the most likely
       share of d0, 1 for what moves with the point and 0 for what does not; its standard deviation is
       sigma / sqrt(sum (J(d0) - J(d1))^2): the likelihood ratio of the two.
    4. What is sure to vote for d0 joins in measuring it, nearest first; what is sure to vote for another is not
       believed, and neither is what is unsure beside it.

    The majority has no say: a post before leaves is what was named, and a still wall beside a moving deck as well.
    """
    still = np.zeros((window.count, 2))
    start = still if start is None else start
    _, noise = window.local_motion(still)
    if start.any():  # what no translation explains, be it one near rest or one near the start
        noise = np.minimum(noise, window.local_motion(start)[1])
    steady = ~_find_restless(window, noise)
    inside = (np.abs(np.arange(len(noise)) - len(noise) // 2) <= half_px).astype(np.float32)
    square = inside[:, None] * inside[None, :]
    motion, covariance, radius = _find_seed(window, noise, steady, start)
    core = np.exp(-window.radius2 / (2 * radius**2))
    others = rest = _find_common(window, motion, noise, steady)
    for growth in range(_GROWTH + 1):
        others = _find_others(window, motion, noise, steady, others) if growth == _GROWTH else others
        against, supporting = _vote(window, motion, others, noise)
        believed = steady & _find_believed(against, supporting)
        if growth == _GROWTH or not is_distinct(motion, still):
            break
        near = np.exp(-window.radius2 / (2 * (radius * 2.0 ** (growth + 1)) ** 2))
        weights = believed * np.maximum(core, supporting * square * near)
        motion, covariance = window.register(weights.astype(np.float32), noise, motion)
    if not is_distinct(motion, still):
        others = _find_others(window, motion, noise, steady, others)
        against, supporting = _vote(window, motion, others, noise)
        believed = steady & _find_believed(against, supporting)
    return Belief(motion, covariance, believed, against, supporting & believed, radius, noise, rest)


def _find_restless(window: Window, noise: Image) -> BoolArray:
    """Areas that change in ways which no motion of theirs explains, shape (R, R)."""
    quiet = float(np.percentile(noise, 20))
    texture = soften(window.gradient[0] ** 2 + window.gradient[1] ** 2, _AREA_PX)
    return _without_specks((noise > _RESTLESS**2 * quiet) & (noise > _RESTLESS_PX**2 * texture / 2))


def _find_seed(
    window: Window, noise: Image, steady: BoolArray, start: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Motion of the nearest surroundings that have texture, its covariance, and their radius [px]."""
    for radius in _SEEDS_PX:
        weights = np.exp(-window.radius2 / (2 * radius**2)) * (window.radius2 < (2.5 * radius) ** 2) * steady
        motion, covariance = window.register(weights.astype(np.float32), noise, start)
        if np.linalg.eigvalsh(covariance)[0] < _SEED_STD_PX**2 or radius == _SEEDS_PX[-1]:
            break
    return motion, covariance, radius


def is_distinct(first: FloatArray, second: FloatArray) -> bool:
    """Whether two motions differ by more than one body and noise make of one.

    Parameters
    ----------
    first, second
        Motions in the sample frames, shape (K, 2) [px].
    """
    return bool(np.sqrt(np.mean(np.sum((first - second) ** 2, axis=1))) > DISTINCT_PX)


def _is_sure(difference: FloatArray, covariance: FloatArray) -> bool:
    """Whether motions (K, 2) [px] stand out of noise of this covariance (2, 2) [px2]."""
    variances, axes = np.linalg.eigh(covariance)
    # Where one direction is known and the other is not, rounding may leave a singular matrix, or a negative variance.
    variances = np.maximum(variances, np.finfo(np.float64).eps * max(variances[-1], 1.0))
    return bool(np.mean(np.sum((difference @ axes) ** 2 / variances, axis=1)) > SURE**2)


def _find_common(window: Window, motion: FloatArray, noise: Image, steady: BoolArray) -> list[FloatArray]:
    """Standing still; and where nothing does, as in trembling air, what the window does on the whole, each (K, 2) [px].

    The motion of the point's nearest surroundings is known, shape (K, 2) [px].
    """
    still = np.zeros((window.count, 2))
    common, _ = window.register(steady.astype(np.float32), noise, motion)
    # Two surfaces in one window have a mean motion, too, which is nobody's: some share of the point's.
    share = float(np.sum(common * motion) / max(np.sum(motion**2), np.finfo(np.float64).tiny))
    if not is_distinct(common, np.clip(share, 0, 1) * motion):
        return [still]
    _, carried = _vote(window, common, [still, motion], noise)
    _, stays = _vote(window, still, [common, motion], noise)
    moves = np.count_nonzero(carried & steady) >= _LAYER_PX > np.count_nonzero(stays & steady)
    return [still, common] if moves else [still]


def _find_others(
    window: Window, motion: FloatArray, noise: Image, steady: BoolArray, common: list[FloatArray]
) -> list[FloatArray]:
    """Those in common, and motions of blocks that are seen to move otherwise than the point, each (K, 2) [px]."""
    others = list(common)
    for _ in range(_OTHERS):
        known = [motion, *(other for other in others if is_distinct(other, motion))]
        departures = []
        for one in known:
            further, _ = window.local_motion(one)
            gu, gv = window.gradient
            # What a further motion changes in the picture, against the noise: its statistical weight.
            changed = [soften((gu * f[0] + gv * f[1]) ** 2, _AREA_PX) for f in further]
            departures.append(np.mean(changed, axis=0) / (2 * noise))
        least = np.min(departures, axis=0) * steady
        place = np.unravel_index(int(least.argmax()), least.shape)
        if least[place] < SURE**2 / window.count:
            break
        middle = len(least) // 2
        rows, columns = (np.arange(len(least)) - middle - (p - middle) for p in place)
        weights = np.exp(-(rows[:, None] ** 2 + columns[None, :] ** 2) / (2 * _SEEDS_PX[1] ** 2))
        further, _ = window.local_motion(motion)
        start = motion + further[:, :, place[0], place[1]]
        found, covariance = window.register((weights * steady).astype(np.float32), noise, start)
        if not all(is_distinct(found, one) and _is_sure(found - one, covariance) for one in [motion, *others]):
            break
        others.append(found)
    return others


def _vote(window: Window, motion: FloatArray, others: list[FloatArray], noise: Image) -> tuple[BoolArray, BoolArray]:
    """Areas that are sure to move otherwise than the point, and those that are sure to move with it, (R, R) each."""
    against, supporting = np.zeros(noise.shape, np.bool_), np.ones(noise.shape, np.bool_)
    smooth = np.stack([soften(frame, _SMOOTH_PX) for frame in window.soft])
    for other in others:
        if not is_distinct(motion, other):
            continue
        agree, spread = np.zeros_like(noise), np.zeros_like(noise)
        for frame in range(window.count):
            with_point = _quick(window.moved(frame, motion[frame], images=smooth) - smooth[0])
            with_other = _quick(window.moved(frame, other[frame], images=smooth) - smooth[0])
            change = with_point - with_other
            agree -= change * with_other
            spread += change * change
        agree, spread = soften(agree, _AREA_PX), np.maximum(soften(spread, _AREA_PX), 1e-6)
        share = agree / spread
        std = np.sqrt(noise * _VOTE_NOISE / spread)
        otherwise = _without_specks((share < 0.5) & (1 - share > SURE * std))
        if other.any() and np.count_nonzero(otherwise) < _LAYER_PX:
            continue
        against |= otherwise
        supporting &= (share > 0.6) & (share > SURE * std)
    return against, supporting


def _find_believed(against: BoolArray, supporting: BoolArray) -> BoolArray:
    """What does not move otherwise, but near to what does only what is seen to move with the point, shape (R, R)."""
    if not against.any():
        return ~against
    return np.asarray(~against & (supporting | (distance_transform_edt(~against) > _NEAR_PX)))


def _quick(image: Image) -> Image:
    """An image without what changes slowly over it, as light does."""
    return np.asarray(image - soften(image, SLOW_PX), np.float32)


def _without_specks(mask: BoolArray) -> BoolArray:
    """A mask without areas, or holes, too small to be told from noise."""
    for kind in (True, False):
        areas, count = label(mask == kind)
        if count:
            small = np.flatnonzero(np.bincount(areas.ravel()) < _LEAST_AREA_PX)
            mask = np.where(np.isin(areas, small[small > 0]), not kind, mask)
    return np.asarray(mask, np.bool_)
