"""Size, shape and warp of a point's subset, from what moves with it and what its texture can carry."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX, SubsetDesign, Warp
from vfm_sdm.stages.registration.determined_warps import LINEAR_STD
from vfm_sdm.stages.tracking.design.belief import Belief, find_belief
from vfm_sdm.stages.tracking.design.coarse import coarse_motion
from vfm_sdm.stages.tracking.design.information import (
    USABLE_STD_PX,
    find_false_corners,
    find_near_edge,
    square_std,
    std_around,
)
from vfm_sdm.stages.tracking.design.trial import Trial
from vfm_sdm.stages.tracking.design.window import Window

__all__ = ["MARGIN_PX", "SIZES_PX", "SubsetChoice", "choose_subset"]

SIZES_PX = (41, 61, 81, 101)
"""Sides that are tried where the user names none, from small and clear to large and calm [px]."""
_GOOD_STD_PX = 0.01
"""A codec's errors alone are as large [px]: nothing is gained by a larger subset (decision record 008)."""
_WORTH = 0.8
"""A larger subset must lower the standard deviation to this share, as the noise of 1.5 times the pixels does."""
MARGIN_PX = 24
"""What is looked at beyond the square: where something else begins, and motion of the sample frames [px]."""
_SIGHT_PX = 30
"""Half a side within which a point's motion is looked for, however small its square [px]."""
_ORDERS = (Warp.TRANSLATION, Warp.SIMILARITY, Warp.AFFINE)
_SAME_PX = 0.005
"""Standard deviations this close are the same: the higher order is then taken, which is wrong about less [px]."""
_SHADINGS = (0, 2, 4)
"""Degrees of the surfaces of brightness that are tried: none, one bend, and two, as where a shadow begins and ends."""
_EDGE_SHADINGS = (0, 2)
"""Across an edge, what bends more often is the edge itself."""
_LIT = 0.5
"""Share to which shading must bring the variance to be taken: light that moves does then at least what all else does.
Surfaces that explain less may have explained it by chance, and took texture away."""
_UNLIT = 0.8
"""Share of the variance that is left by surfaces of which no more need to be tried; where light moves, more are taken
that leave less. Pixels far from an edge are left out where that leaves no more than this, either."""


@dataclass(frozen=True, eq=False)
class SubsetChoice:
    """The subset of a point, and how well it should measure.

    Parameters
    ----------
    design
        Size, warp and believed pixels; ``None`` where the point is refused.
    std_px
        Expected standard deviation of one frame, in the best and in the worst direction, shape (2,) [px], from noise
        and from how halves of the subset disagree; without what a codec makes of a whole surface alike.
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


def choose_subset(
    frames: LumaArray, offset: FloatArray, sizes: Sequence[int], *, turning: bool = False
) -> SubsetChoice:
    """The subset of the point in the middle of a window.

    Parameters
    ----------
    frames
        The window [v, u] in the reference frame and in K sample frames, shape (K + 1, R, R).
    offset
        Vector from the middle pixel to the point, shape (2,) [px].
    sizes
        Sides of the square to choose from, rising [px].
    turning
        Whether the camera turns and comes nearer: an affine warp has to follow that, which the windows do not show.
    """
    start = coarse_motion(frames, sizes[0])
    far = int(np.abs(start).max(initial=0.0))
    window = Window(_middle(frames, sizes[-1] // 2 + MARGIN_PX + far))
    belief = find_belief(window, max(sizes[0] // 2, _SIGHT_PX), start)
    trial = Trial(frames, offset, belief.motion, (Warp.AFFINE,) if turning else _ORDERS)
    best = _choose_warp(window, belief, trial, sizes[0])
    for size in sizes[1:]:
        if best.design is not None and best.design.warp != Warp.EDGE and best.std_px[1] < _GOOD_STD_PX:
            break
        found = _choose_warp(window, belief, trial, size)
        direction = 1 if np.isfinite(best.std_px[1]) and best.design is not None else 0
        if _measures_more(found, best) or found.std_px[direction] < _WORTH * best.std_px[direction]:
            best = found
    return best if best.design is not None else replace(best, nearest=_find_nearest(frames, sizes[0]))


def _choose_warp(window: Window, belief: Belief, trial: Trial, size: int) -> SubsetChoice:
    """The best warp of a square of one size."""
    part = _square(belief.believed.shape[0], size)
    std, directions = square_std(window, belief, part)
    share = float(belief.believed[part].mean())
    refused = SubsetChoice(None, std, directions[0], share, PointStatus.NO_TEXTURE, np.full(2, np.nan))
    if not std[0] <= USABLE_STD_PX or np.count_nonzero(belief.believed & part) < FEWEST_BELIEVED_PX:
        return refused
    clean = _cut_mask(belief.believed & ~find_false_corners(window, belief.against), size)
    if std[1] <= USABLE_STD_PX and np.count_nonzero(clean) >= FEWEST_BELIEVED_PX:
        tried = _choose_shading(_SHADINGS, lambda shading: _try_warps(trial, size, clean, shading))
        if tried is not None:
            design, covariance = tried
            values, axes = np.linalg.eigh(covariance)
            if values[1] <= USABLE_STD_PX**2:
                return _accept(refused, design, np.sqrt(values), axes[:, 0])
    across = directions[0]
    near = find_near_edge(window, belief.believed & part, across)
    found = _choose_edge(trial, size, across, (_cut_mask(belief.believed, size), _cut_mask(near, size)))
    if found is None or np.trace(found[1]) > USABLE_STD_PX**2:
        return refused
    return _accept(refused, found[0], np.array([np.sqrt(np.trace(found[1])), np.inf]), across)


def _choose_edge(
    trial: Trial, size: int, across: FloatArray, masks: tuple[BoolArray, BoolArray]
) -> tuple[SubsetDesign, FloatArray] | None:
    """The edge on all that is believed or, where that is clearly better, on what lies near it; and its error (2, 2).

    It is shaded where light moves. ``None`` where no registration converges.
    """
    whole, near = (
        _try_edge(trial, size, mask, across, 0) if np.count_nonzero(mask) >= FEWEST_BELIEVED_PX else None
        for mask in masks
    )
    if whole is None or near is None:
        mask = masks[0] if near is None else masks[1]
    else:
        mask = masks[int(np.trace(near[1]) < _UNLIT * np.trace(whole[1]))]
    return _choose_shading(_EDGE_SHADINGS, lambda shading: _try_edge(trial, size, mask, across, shading))


def _choose_shading(
    degrees: Sequence[int], attempt: Callable[[int], tuple[SubsetDesign, FloatArray] | None]
) -> tuple[SubsetDesign, FloatArray] | None:
    """The attempt of the lowest degree of shading that no higher one betters clearly; ``None`` where the first fails.

    An attempt is a design and its expected mean square error as a covariance (2, 2) [px2]. Where the first is not
    usable, it stands: what only shading would let measure rests on the light being as smooth as it is thought.
    """
    best = attempt(degrees[0])
    if best is None or np.linalg.eigvalsh(best[1])[1] > USABLE_STD_PX**2:
        return best
    for degree in degrees[1:]:
        found = attempt(degree)
        share = np.inf if found is None else float(np.trace(found[1]) / np.trace(best[1]))
        if share > _UNLIT:
            break
        if found is not None and share < (_UNLIT if best[0].shading else _LIT):
            best = found
    return best


def _try_edge(
    trial: Trial, size: int, mask: BoolArray, across: FloatArray, shading: int
) -> tuple[SubsetDesign, FloatArray] | None:
    """An edge, and its expected mean square error as a covariance (2, 2) of rank one [px2]."""
    edge = SubsetDesign(size, Warp.EDGE, across, mask, LINEAR_STD, shading)
    stated = trial.covariance(edge)
    if stated is None:
        return None
    variance = max(float(across @ stated @ across), float(across @ trial.spread(edge) @ across))
    return edge, variance * np.outer(across, across)


def _accept(refused: SubsetChoice, design: SubsetDesign, std_px: FloatArray, direction: FloatArray) -> SubsetChoice:
    """The choice of a design; a mask that masks nothing is none."""
    if design.mask is not None and design.mask.all():
        design = replace(design, mask=None)
    return replace(refused, design=design, std_px=std_px, direction=direction, status=PointStatus.OK)


def _try_warps(trial: Trial, size: int, mask: BoolArray, shading: int) -> tuple[SubsetDesign, FloatArray] | None:
    """The warp with the least expected mean square error, and that error as a covariance (2, 2) [px2].

    Of those that are as good, the one of the highest order; ``None`` where none converges.
    """
    omitted = float(np.hypot(LINEAR_STD, trial.linear_std(size, mask, shading)))
    # What an affine warp allows and the texture does not determine is left out as well.
    designs = [SubsetDesign(size, warp, None, mask, omitted, shading) for warp in trial.orders]
    found = [(design, stated) for design in designs if (stated := trial.covariance(design)) is not None]
    if not found:
        return None
    errors = [float(np.trace(stated)) for _, stated in found]
    good = [one for one, error in zip(found, errors, strict=True) if error <= min(errors) + _SAME_PX**2]
    design, stated = good[-1]
    values, axes = np.linalg.eigh(stated)
    seen = np.einsum("ia,ij,ja->a", axes, trial.spread(design), axes)
    return design, np.asarray((axes * np.maximum(values, seen)) @ axes.T)


def _measures_more(found: SubsetChoice, before: SubsetChoice) -> bool:
    """Whether a subset measures in a direction in which the one before does not."""
    return bool(np.sum(found.std_px <= USABLE_STD_PX) > np.sum(before.std_px <= USABLE_STD_PX)) or (
        found.design is not None and before.design is None
    )


def _find_nearest(frames: LumaArray, size: int) -> FloatArray:
    """Nearest place whose square has texture in both directions, as a vector from the middle, shape (2,) [px]."""
    window = Window(frames)
    _, noise = window.local_motion(np.zeros((window.count, 2)))
    # Texture well inside the square, not at its border.
    std = std_around(window, noise, np.ones(noise.shape, np.bool_), 2 * size // 3 | 1)
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
