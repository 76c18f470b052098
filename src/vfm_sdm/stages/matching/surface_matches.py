"""Feature matches guided by an approximate pose, which draws the second view as the first one sees a surface."""

from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.stages.matching.detection import ImageFeatures, detect_features, to_eight_bit

__all__ = ["match_through"]

_GRID = 64
"""Nodes of the map along the longer side; between them it is interpolated."""
_LONG_SIDE_PX = 1500
_RATIO = 0.85
_TWIN_PX = 2.0
_PAIRS = 20_000
"""Pairs of descriptors that are compared at a time: 20 MB."""

Descriptors = np.ndarray[tuple[int, int], np.dtype[np.float32]]
Similarities = np.ndarray[tuple[int], np.dtype[np.float32]]


def match_through(
    first: ImageFeatures,
    images: tuple[LumaArray, LumaArray],
    through: Callable[[FloatArray], FloatArray],
    reach_px: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Features of two images that lie nearly where a known map leads.

    Parameters
    ----------
    first
        Features of the first image as it is.
    images
        Luma of both, shape (H, W) each.
    through
        Map of pixels of the first image, shape (N, 2) [px], to those of the second; NaN where there is none.
    reach_px
        How far along the rows and along the columns of the first image the map may be wrong [px].

    Returns
    -------
    points_first, points_second
        Pixels in both images, shape (N, 2) each [px]; empty when nothing matches.

    Notes
    -----
    The second image is resampled by the map, so that the difference of the two directions of view does not change the
    descriptors, and every feature is compared with those in its neighbourhood alone: what repeats farther off is no
    rival.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> image = np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8)
    >>> pair = (image[:, 20:], image[:, :-20])
    >>> features = detect_features(pair[0])
    >>> first, second = match_through(features, pair, lambda pixels: pixels + [17.0, 0.0], (8.0, 4.0))
    >>> len(first) > 50, bool(np.allclose(np.median(second - first, axis=0), [20, 0], atol=0.1))
    (True, True)
    """
    seen, second = images
    scale = min(1.0, _LONG_SIDE_PX / max(seen.shape))
    size = (round(seen.shape[1] * scale), round(seen.shape[0] * scale))
    places = _map_pixels(seen.shape, size, through)
    if not np.isfinite(places).any():
        return np.empty((0, 2)), np.empty((0, 2))
    known = np.nan_to_num(places, nan=-1e4).astype(np.float32)
    drawn = cv2.remap(
        to_eight_bit(second), known[..., 0], known[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    other = detect_features(np.asarray(drawn, np.uint8))
    points, there = first.points, (other.points + 0.5) / scale - 0.5
    if min(len(points), len(there)) < 2:
        return np.empty((0, 2)), np.empty((0, 2))
    best, kept = _match_nearby((points, first.descriptors), (there, other.descriptors), reach_px)
    first_points, second_points = points[kept], through(there[best[kept]])
    height, width = second.shape
    inside = np.isfinite(second_points).all(axis=1)
    inside &= ((second_points >= 0) & (second_points <= [width - 1, height - 1])).all(axis=1)
    return first_points[inside], second_points[inside]


def _map_pixels(
    shape: tuple[int, ...], size: tuple[int, int], through: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Where every pixel of a reduced first image lies in the second one, shape (height, width, 2) [px]."""
    height, width = shape
    columns = np.linspace(0, width - 1, _GRID)
    rows = np.linspace(0, height - 1, max(2, round(_GRID * height / width)))
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1)
    mapped = through(nodes.reshape(-1, 2)).reshape(nodes.shape)
    u = np.linspace(0, len(columns) - 1, size[0], dtype=np.float32)
    v = np.linspace(0, len(rows) - 1, size[1], dtype=np.float32)
    grid_u, grid_v = np.meshgrid(u, v)
    return np.asarray(cv2.remap(mapped.astype(np.float32), grid_u, grid_v, cv2.INTER_LINEAR), dtype=np.float64)


def _match_nearby(
    one: tuple[FloatArray, Descriptors], other: tuple[FloatArray, Descriptors], reach_px: tuple[float, float]
) -> tuple[IntArray, BoolArray]:
    """Index of the most similar neighbour of each feature, and whether the two are each other's and distinct."""
    (points, descriptors), (there, others) = one, other
    reach = np.asarray(reach_px)
    near = cKDTree(points / reach).sparse_distance_matrix(cKDTree(there / reach), 1.0, output_type="ndarray")
    rows, columns = near["i"], near["j"]
    similarity = np.empty(len(rows), np.float32)
    for start in range(0, len(rows), _PAIRS):
        part = slice(start, start + _PAIRS)
        similarity[part] = np.einsum("pd,pd->p", descriptors[rows[part]], others[columns[part]])
    best, top = _most_similar(rows, columns, similarity, len(points))
    back, _ = _most_similar(columns, rows, similarity, len(there))
    # The same corner in another orientation is no rival.
    rival = np.linalg.norm(there[columns] - there[best[rows]], axis=1) >= _TWIN_PX
    _, next_best = _most_similar(rows[rival], columns[rival], similarity[rival], len(points))
    distinct = (1 - top) < _RATIO**2 * (1 - next_best)
    return best, (back[best] == np.arange(len(points))) & distinct & (top > 0)


def _most_similar(
    rows: IntArray, columns: IntArray, similarity: Similarities, count: int
) -> tuple[IntArray, Similarities]:
    """Most similar partner of each row and how similar it is, of pairs; 0 and -1 for a row without one."""
    order = np.lexsort((columns, -similarity, rows))
    known, first = np.unique(rows[order], return_index=True)
    best, top = np.zeros(count, np.intp), np.full(count, -1.0, np.float32)
    best[known], top[known] = columns[order[first]], similarity[order[first]]
    return best, top
