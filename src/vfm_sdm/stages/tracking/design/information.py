"""What the texture of a part of a window tells of its motion, and along which direction."""

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.stages.tracking.design.belief import DISTINCT_PX, SURE, Belief, is_distinct
from vfm_sdm.stages.tracking.design.window import SLOW_PX, Image, Window, kept_noise, noise_of_gradients, soften

__all__ = ["USABLE_STD_PX", "find_false_corners", "find_near_edge", "square_std", "std_around"]

USABLE_STD_PX = 0.1
"""Standard deviation of one frame up to which a direction is measured [px]; beyond it trackers say ``unreliable``."""
_RIM_PX = 3.0
"""Width of the rim along what moves otherwise, in which two surfaces mix [px]: their blur, and the area that votes."""
_NORMAL_PX = 2.0
_CORE, _LEAST_CORE_PX = 2.0, 9.0
"""Radius of the nearest surroundings in standard deviations of their weights, and at least [px]."""
_TOLD = 0.7
"""Share of an edge's information that makes a pixel part of it, the strongest pixels first."""
_BESIDE_PX = 2 * SLOW_PX
"""Further from an edge than this the light is another [px]."""
_AS_SURE = 0.5
"""Share of what tells the motion across that is seen to move with the point, over that of what tells it along: with one
texture they are alike, with lines of two surfaces across each other one of them is near zero."""
_UNKNOWN_PX = 10.0
"""Standard deviation from which on a direction counts as unknown [px]."""


def square_std(window: Window, belief: Belief, part: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of one frame's motion of a part of a window, in its best and its worst direction.

    Parameters
    ----------
    window
        The surroundings of a point.
    belief
        What moves with it.
    part
        The part, such as a square, shape (R, R).

    Returns
    -------
    std
        Best and worst standard deviation, shape (2,) [px]; infinity where the texture cannot be told from noise.
    directions
        Unit vectors (u, v) of the two, one a row, shape (2, 2).

    Notes
    -----
    Where something else begins, both surfaces make the picture: the line between them moves with the nearer one, and
    across it its motion is seen; along it the farther one's texture ends at the line and makes corners that move with
    neither. In the rim of what moves otherwise only the part of a gradient across that line counts, therefore.

    A direction of which the point's nearest surroundings, as far as they are seen to move with it, say nothing is told
    by others only where they are seen to move along it, too, or where nothing moves at all: a post that moves sideways
    before a still wall shares no motion with the wall's joints, even if nothing contradicts them. Where the air moves
    the wall, they are to move beyond it.

    Lines that run along the motion agree with standing still as well. Where they are most of what tells the motion
    across it, as the joints of a wall between balusters are, they may be another surface: only what is seen to move
    counts.
    """
    believed = part & belief.believed
    covariance = _part_covariance(window, belief, believed, ~belief.against)
    values, axes = np.linalg.eigh(covariance)
    std = np.sqrt(np.maximum(values, 0.0))
    core = window.radius2 <= max(_CORE * belief.radius_px, _LEAST_CORE_PX) ** 2
    moves = is_distinct(belief.motion, 0 * belief.motion)
    sure = belief.supporting if moves else ~belief.against
    near = _part_covariance(window, belief, believed & core & sure, sure)
    along = [(belief.motion - rest) @ axes[:, 1] for rest in belief.rest]
    shared = min(np.sqrt(np.mean(one**2)) for one in along) > max(DISTINCT_PX, SURE * std[1])
    if not shared and (moves or (belief.against & part).any()):
        std[1] = max(std[1], float(np.sqrt(axes[:, 1] @ near @ axes[:, 1])))
    if moves and std[1] <= USABLE_STD_PX:
        moving = _part_covariance(window, belief, believed & belief.supporting, ~belief.against)
        if _crosses_lines(belief, covariance, moving):
            values, axes = np.linalg.eigh(moving)
            std = np.array([np.sqrt(max(values[0], 0.0)), np.inf])
    return np.where(std < _UNKNOWN_PX / 2, std, np.inf), axes.T.copy()


def _crosses_lines(belief: Belief, covariance: FloatArray, moving: FloatArray) -> bool:
    """Whether a point moves along one line only, and what tells its motion across it is not seen to move with it.

    Covariances (2, 2) [px2] of all that is believed, and of what is seen to move.
    """
    moments = [np.linalg.eigh((belief.motion - rest).T @ (belief.motion - rest)) for rest in belief.rest]
    squares, directions = min(moments, key=lambda one: float(one[0][0]))
    if squares[0] > len(belief.motion) * DISTINCT_PX**2:
        return False
    told = [np.einsum("ia,ij,ja->a", directions, np.linalg.inv(one), directions) for one in (moving, covariance)]
    across, along = told[0] / told[1]
    return bool(across < _AS_SURE * along)


def _part_covariance(window: Window, belief: Belief, chosen: BoolArray, surface: BoolArray) -> FloatArray:
    """Covariance of one frame's motion of some pixels, not weighted, as a registration takes them, (2, 2) [px2].

    What is not of the ``surface``, shape (R, R), moves otherwise or may do so.
    """
    gradient = window.gradient.astype(np.float64)
    across, rim = _find_rim(surface)
    told = np.where(rim, (gradient * across).sum(axis=0) * across, gradient)[:, chosen]
    noise = belief.noise[chosen].astype(np.float64)
    if not noise.size:
        return _UNKNOWN_PX**2 * 2 * np.eye(2)
    quiet = np.minimum(noise, 2 * np.percentile(belief.noise, 20))
    told = told - told.mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(told @ told.T)
    scatter = np.einsum("in,jn,n->ij", axes.T @ told, axes.T @ told, noise)
    # A direction in which the picture does not change at all is unknown; its scatter of nothing is no certainty.
    scatter[np.diag_indices(2)] = np.maximum(np.diag(scatter), 1e-9)
    # An unknown direction has a large variance, not an infinite one, which would drown the other in rounding.
    least = np.sqrt(2 / kept_noise() * np.diag(scatter)) / _UNKNOWN_PX
    true = np.maximum(values - noise_of_gradients() * quiet.sum(), least)
    return np.asarray(axes @ (2 / kept_noise() * scatter / np.outer(true, true)) @ axes.T)


def find_false_corners(window: Window, against: BoolArray) -> BoolArray:
    """Pixels in the rim of what moves otherwise whose gradients run along the line between, shape (R, R)."""
    across, rim = _find_rim(~against)
    gradient = window.gradient.astype(np.float64)
    ahead = (gradient * across).sum(axis=0)
    aside = gradient[0] * across[1] - gradient[1] * across[0]
    return np.asarray(rim & (np.abs(aside) > np.abs(ahead)))


def find_near_edge(window: Window, chosen: BoolArray, across: FloatArray) -> BoolArray:
    """Those of some pixels that lie near what tells the motion across an edge, shape (R, R).

    Pixels without texture tell the light of an edge, which is to be that beside it: shadows that move further away are
    not to be taken for a change of it.

    Parameters
    ----------
    window
        The surroundings of a point.
    chosen
        The pixels, shape (R, R).
    across
        Unit vector (u, v) across the edge, shape (2,).
    """
    told = np.where(chosen, (across[0] * window.gradient[0] + across[1] * window.gradient[1]) ** 2, 0.0)
    if not told.any():
        return chosen
    strongest = np.sort(told.ravel())[::-1]
    told_by = np.cumsum(strongest)
    edge = told >= strongest[np.searchsorted(told_by, _TOLD * told_by[-1])]
    return np.asarray(chosen & (distance_transform_edt(~edge) <= _BESIDE_PX))


def _find_rim(believed: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Unit vectors across the nearest line to what is not believed, (2, R, R), and the rim along it, (R, R)."""
    if believed.all():
        return np.zeros((2, *believed.shape)), np.zeros(believed.shape, np.bool_)
    rim = believed & (distance_transform_edt(believed) <= _RIM_PX)
    smooth = soften(believed.astype(np.float32), _NORMAL_PX)
    down, right = np.gradient(smooth.astype(np.float64))
    across = np.stack([right, down])
    return across / np.maximum(np.hypot(*across), 1e-9), np.asarray(rim, np.bool_)


def std_around(window: Window, noise: Image, believed: BoolArray, side_px: int) -> FloatArray:
    """Worst standard deviation of one frame's motion of the square around every pixel, shape (R, R) [px].

    Parameters
    ----------
    window, noise, believed
        As in `square_std`.
    side_px
        Side of the squares [px].
    """
    gu, gv = window.gradient
    weight = believed.astype(np.float32) / noise
    uu, uv, vv = (_sum_over_squares(weight * product, side_px) for product in (gu * gu, gu * gv, gv * gv))
    middle, spread = (uu + vv) / 2, np.hypot((uu - vv) / 2, uv)
    values = middle - spread
    true = values - noise_of_gradients() * _sum_over_squares(believed.astype(np.float32), side_px)
    variance = 2 / kept_noise() * np.maximum(values, 1e-12) / np.maximum(true, 1e-12) ** 2
    return np.where(true > 0, np.sqrt(variance), np.inf)


def _sum_over_squares(image: Image, side_px: int) -> FloatArray:
    """Sums over the squares around every pixel, shape (R, R)."""
    total = cv2.boxFilter(image, cv2.CV_64F, (side_px, side_px), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, np.float64)
