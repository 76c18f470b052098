"""Motion of a point's surroundings to a pixel, however far they go between the sample frames."""

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.stages.tracking.design.window import REACH_PX, SLOW_PX, SOFT_PX, Image, soften

__all__ = ["coarse_motion"]

_AS_GOOD = 1.5
"""Places whose misfit is up to this many times the least are as good: along an edge, or on what repeats."""
_FAR_BETTER = 0.5
"""A far place must leave less than this share of the misfit that is left near rest, or nothing was found there."""
_LEAST_CONTRAST = 0.2
"""Contrast over that of the point's own square below which a place shows something else, however well it correlates."""
_LEAST_MISFIT = 1e-3
"""Single precision and whole pixels leave as much where nothing else does [1]."""


def coarse_motion(frames: LumaArray, template_px: int) -> FloatArray:
    """Motion of the middle of a window in each sample frame, whole pixels, shape (K, 2) [px]; zero where it stays near.

    Parameters
    ----------
    frames
        The window [v, u] in the reference frame and in K sample frames, shape (K + 1, R, R).
    template_px
        Side of the square that is looked for, odd [px].

    Notes
    -----
    Photographs between the states of a load test, and bridges that swing by many pixels, leave the reach of a
    registration that starts from rest. The correlation coefficient rho of the square leaves 1 - rho^2 of its contrast
    unexplained. Of all places that are as good as the best one, the nearest is taken: an edge is not followed along
    itself, and of bricks that repeat, the first will do. What is near, is found from rest, as is what is hidden.
    What changes slowly over the picture, as light does, has no part in it.
    """
    detail = [_detail(frame) for frame in frames]
    middle, half = frames.shape[1] // 2, template_px // 2
    square = np.s_[middle - half : middle + half + 1, middle - half : middle + half + 1]
    room = middle - half
    steps = np.arange(-room, room + 1)
    far2 = steps[:, None] ** 2 + steps[None, :] ** 2
    near = far2 <= (REACH_PX / 2) ** 2
    motion = np.zeros((len(frames) - 1, 2))
    for row, frame in enumerate(detail[1:]):
        correlation = _correlate(frame, detail[0][square])
        misfit = _LEAST_MISFIT + 1 - np.clip(correlation, 0, 1) ** 2
        if misfit.min() >= _FAR_BETTER * misfit[near].min():
            continue
        nearest = np.where(misfit <= _AS_GOOD * misfit.min(), far2, np.inf)
        v, u = np.unravel_index(int(nearest.argmin()), nearest.shape)
        motion[row] = steps[u], steps[v]
    return motion


def _correlate(frame: Image, template: Image) -> Image:
    """Correlation coefficient of a square with all places of a frame [1]; 0 where these are flat and it has none."""
    found = cv2.matchTemplate(frame, template, cv2.TM_CCOEFF_NORMED)
    half, size = template.shape[0] // 2, template.shape
    inner = np.s_[half : half + found.shape[0], half : half + found.shape[1]]
    variance = (cv2.boxFilter(frame * frame, -1, size) - cv2.boxFilter(frame, -1, size) ** 2)[inner]
    flat = variance < _LEAST_CONTRAST**2 * float(template.var())
    return np.where(flat | ~np.isfinite(found), np.float32(0), found)


def _detail(frame: LumaArray) -> Image:
    """A frame without its noise and without what changes slowly over it."""
    soft = soften(frame.astype(np.float32), SOFT_PX)
    return np.asarray(soft - soften(soft, SLOW_PX), np.float32)
