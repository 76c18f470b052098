"""Size, shape and warp of a point's subset, from what moves with it and what its texture can carry."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX, SubsetDesign, Warp
from vfm_sdm.stages.registration.subsets import SubsetBank
from vfm_sdm.stages.tracking.design.belief import Belief, find_belief
from vfm_sdm.stages.tracking.design.information import find_false_corners, square_std, std_around
from vfm_sdm.stages.tracking.design.window import Window

__all__ = ["SIZES_PX", "USABLE_STD_PX", "SubsetChoice", "choose_subset"]

SIZES_PX = (41, 61, 81, 101)
"""Sides that are tried where the user names none, from small and clear to large and calm [px]."""
USABLE_STD_PX = 0.1
"""Standard deviation of one frame up to which a direction is measured [px]; beyond it trackers say ``unreliable``."""
_GOOD_STD_PX = 0.01
"""A codec's errors alone are as large [px]: nothing is gained by a larger subset (decision record 008)."""
_WORTH = 0.8
"""A larger subset must lower the standard deviation to this share, as the noise of 1.5 times the pixels does."""
_LINEAR_STD = 3e-4
"""Rotation and strain that an ordinary recording makes unseen [1]: the slope of a girder that is bent by 1/10000 of its
span (pi/10000), as under pedestrians and wind; the limit of serviceability of a footbridge is ten times that."""
_FULL = (Warp.TRANSLATION, Warp.SIMILARITY, Warp.AFFINE)
_MARGIN_PX = 24
"""What is looked at beyond the square: where something else begins, and motion of the sample frames [px]."""
_SIGHT_PX = 30
"""Half a side within which a point's motion is looked for, however small its square [px]."""
_FAILED = 0.2
"""Largest share of the sample frames in which a warp may fail to converge."""
_SAME_PX = 0.005
"""Standard deviations this close are the same: the higher order is then taken, which is wrong about less [px]."""


@dataclass(frozen=True, eq=False)
class SubsetChoice:
    """The subset of a point, and how well it should measure.

    Parameters
    ----------
    design
        Size, warp and believed pixels; ``None`` where the point is refused.
    std_px
        Expected standard deviation of one frame, in the best and in the worst direction, shape (2,) [px]; that of the
        noise between the frames, without what a codec makes of a whole surface.
    direction
        Unit vector (u, v) of the best direction, shape (2,).
    believed
        Share of the square's pixels that are believed [1].
    status
        ``ok``, or why the point is refused.
    nearest
        Nearest place that would do, shape (2,) [px]; NaN where there is none near, and for points that are not refused.
    """

    design: SubsetDesign | None
    std_px: FloatArray
    direction: FloatArray
    believed: float
    status: PointStatus
    nearest: FloatArray


def choose_subset(frames: LumaArray, offset: FloatArray, sizes: Sequence[int]) -> SubsetChoice:
    """The subset of the point in the middle of a window.

    Parameters
    ----------
    frames
        The window [v, u] in the reference frame and in K sample frames, shape (K + 1, R, R).
    offset
        Vector from the middle pixel to the point, shape (2,) [px].
    sizes
        Sides of the square to choose from, rising [px].
    """
    window = Window(_middle(frames, sizes[-1] // 2 + _MARGIN_PX))
    belief = find_belief(window, max(sizes[0] // 2, _SIGHT_PX))
    best = _choose_warp(window, belief, frames, offset, sizes[0])
    for size in sizes[1:]:
        if best.design is not None and best.design.warp != Warp.EDGE and best.std_px[1] < _GOOD_STD_PX:
            break
        found = _choose_warp(window, belief, frames, offset, size)
        if _measures_more(found, best) or found.std_px[0] < _WORTH * best.std_px[0]:
            best = found
    return best if best.design is not None else replace(best, nearest=_find_nearest(frames, sizes[0]))


def _choose_warp(window: Window, belief: Belief, frames: LumaArray, offset: FloatArray, size: int) -> SubsetChoice:
    """The best warp of a square of one size."""
    part = _square(belief.believed.shape[0], size)
    std, directions = square_std(window, belief, part)
    share = float(belief.believed[part].mean())
    refused = SubsetChoice(None, std, directions[0], share, PointStatus.NO_TEXTURE, np.full(2, np.nan))
    if not std[0] <= USABLE_STD_PX or np.count_nonzero(belief.believed & part) < FEWEST_BELIEVED_PX:
        return refused
    if std[1] <= USABLE_STD_PX:
        clean = belief.believed & ~find_false_corners(window, belief.against)
        mask = _cut_mask(clean, size)
        if np.count_nonzero(mask) >= FEWEST_BELIEVED_PX:
            kinds = [SubsetDesign(size, warp, None, mask, _LINEAR_STD) for warp in _FULL if warp != Warp.AFFINE]
            found = _try_designs([*kinds, SubsetDesign(size, Warp.AFFINE, None, mask)], belief, frames, offset)
            chosen = _least_error(found)
            if chosen is not None:
                design, covariance = chosen
                values, axes = np.linalg.eigh(covariance)
                if values[1] <= USABLE_STD_PX**2:
                    return replace(
                        refused,
                        design=_bare(design),
                        std_px=np.sqrt(values),
                        direction=axes[:, 0],
                        status=PointStatus.OK,
                    )
    across = directions[0]
    edge = SubsetDesign(size, Warp.EDGE, across, _cut_mask(belief.believed, size), _LINEAR_STD)
    found = _try_designs([edge], belief, frames, offset)
    if found and across @ found[0][1] @ across <= USABLE_STD_PX**2:
        tried = float(np.sqrt(across @ found[0][1] @ across))
        return replace(refused, design=_bare(edge), std_px=np.array([tried, np.inf]), status=PointStatus.OK)
    return refused


def _try_designs(
    designs: list[SubsetDesign], belief: Belief, frames: LumaArray, offset: FloatArray
) -> list[tuple[SubsetDesign, FloatArray]]:
    """Those designs that converge in the sample frames, each with its middle covariance (2, 2) [px2]."""
    middle = frames.shape[1] // 2
    point = middle + offset
    bank = SubsetBank.prepare(frames[0], np.tile(point, (len(designs), 1)), designs=designs)
    rows = np.arange(len(designs))
    start = np.tile([middle, middle, 1.0, 0.0, 0.0, 1.0], (len(designs), 1))
    covariances = []
    for frame, motion in zip(frames[1:], belief.motion, strict=True):
        moved = start.copy()
        moved[:, :2] += motion
        covariances.append(bank.interpret(bank.run(frame, rows, moved)).covariance)
    of_designs = np.stack(covariances, axis=1)
    found = []
    for design, covariance in zip(designs, of_designs, strict=True):
        known = np.isfinite(covariance).all(axis=(1, 2))
        if np.mean(known) >= 1 - _FAILED:
            found.append((design, np.median(covariance[known], axis=0)))
    return found


def _least_error(found: list[tuple[SubsetDesign, FloatArray]]) -> tuple[SubsetDesign, FloatArray] | None:
    """The design with the least expected mean square error; of those that are as good, the one of the highest order."""
    if not found:
        return None
    errors = [float(np.trace(covariance)) for _, covariance in found]
    return [one for one, error in zip(found, errors, strict=True) if error <= min(errors) + _SAME_PX**2][-1]


def _bare(design: SubsetDesign) -> SubsetDesign:
    """The design, without a mask that masks nothing."""
    return replace(design, mask=None) if design.mask is not None and design.mask.all() else design


def _measures_more(found: SubsetChoice, before: SubsetChoice) -> bool:
    """Whether a subset measures in a direction in which the one before does not."""
    return bool(np.sum(found.std_px <= USABLE_STD_PX) > np.sum(before.std_px <= USABLE_STD_PX)) or (
        found.design is not None and before.design is None
    )


def _find_nearest(frames: LumaArray, size: int) -> FloatArray:
    """Nearest place whose square has texture in both directions, as a vector from the middle, shape (2,) [px]."""
    window = Window(frames)
    _, noise = window.local_motion(np.zeros((window.count, 2)))
    std = std_around(window, noise, np.ones(noise.shape, np.bool_), size)
    margin, middle = size // 2, len(noise) // 2
    std[:margin], std[-margin:], std[:, :margin], std[:, -margin:] = np.inf, np.inf, np.inf, np.inf
    far = np.where(std <= USABLE_STD_PX / 2, window.radius2, np.inf)
    place = np.unravel_index(int(far.argmin()), far.shape)
    if not np.isfinite(far[place]):
        return np.full(2, np.nan)
    return np.array([place[1] - middle, place[0] - middle], np.float64)


def _middle(frames: LumaArray, half: int) -> LumaArray:
    """The inner part of windows, with this half of a side."""
    cut = max(frames.shape[1] // 2 - half, 0)
    inner: LumaArray = frames[:, cut : frames.shape[1] - cut, cut : frames.shape[2] - cut]
    return inner


def _square(window_px: int, size: int) -> BoolArray:
    """The square of a size in the middle of a window, shape (R, R)."""
    inside = np.abs(np.arange(window_px) - window_px // 2) <= size // 2
    return np.asarray(inside[:, None] & inside[None, :])


def _cut_mask(mask: BoolArray, size: int) -> BoolArray:
    """The middle of a mask, shape (S, S)."""
    first = mask.shape[0] // 2 - size // 2
    return mask[first : first + size, first : first + size].copy()
