"""Places of the scene that are seen in several key frames of a pan clip."""

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.stages.lens.key_frames import KeyFrames
from vfm_sdm.stages.matching.detection import ImageFeatures, find_mutual

__all__ = ["Pair", "join_pairs", "match_key_frames"]

_RATIO = 0.8
_INLIER = 0.004
"""Distance from the homography within which a match counts, over the longer side: distortion bends more than noise."""
_LEAST = 20
_FEATURES = 1200


@dataclass(frozen=True, eq=False)
class Pair:
    """Matches of two key frames.

    Parameters
    ----------
    first, second
        Numbers of the key frames, ``first < second``.
    rows
        Indices of the features in both, shape (N, 2).
    """

    first: int
    second: int
    rows: IntArray


def match_key_frames(keys: KeyFrames, image_size: tuple[int, int]) -> list[Pair]:
    """Matches of all pairs of key frames that a homography explains, as it does for a camera that only turns [1]_.

    Parameters
    ----------
    keys
        Key frames with their features.
    image_size
        Width and height [px].

    References
    ----------
    .. [1] Hartley, R. I. (1997). Self-calibration of stationary cameras. International Journal of Computer Vision
       22(1), 5-23.
    """
    strongest = [_strongest(one) for one in keys.features]
    pairs = []
    for first, second in combinations(range(len(keys.features)), 2):
        rows = _match(keys.features[first], keys.features[second], strongest[first], strongest[second], max(image_size))
        if len(rows) >= _LEAST:
            pairs.append(Pair(first, second, rows))
    return pairs


def _strongest(features: ImageFeatures) -> IntArray:
    """Features of the picture as it is, at most so many; the strongest and those shared out lie mixed: every n-th."""
    step = max(1, -(-len(features) // _FEATURES))
    return np.arange(0, len(features), step)


def _match(first: ImageFeatures, second: ImageFeatures, mine: IntArray, theirs: IntArray, longer: int) -> IntArray:
    none = np.zeros((0, 2), np.intp)
    if min(len(mine), len(theirs)) < _LEAST:
        return none
    likeness = first.descriptors[mine] @ second.descriptors[theirs].T
    places = (first.points[mine], second.points[theirs])
    rows, columns, distance, following = find_mutual(likeness, places, (first.place_px, second.place_px))
    good = distance < _RATIO * following
    rows, columns = mine[rows[good]], theirs[columns[good]]
    if len(rows) < _LEAST:
        return none
    _, inside = cv2.findHomography(
        first.points[rows], second.points[columns], cv2.USAC_MAGSAC, _INLIER * longer, maxIters=2000, confidence=0.999
    )
    if inside is None:
        return none
    kept = np.asarray(inside).ravel() > 0
    return np.column_stack([rows[kept], columns[kept]])


def join_pairs(keys: KeyFrames, pairs: list[Pair], *, least: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Scene points from matches that share features.

    Parameters
    ----------
    keys
        Key frames with their features.
    pairs
        Their matches.
    least
        Least number of key frames that see a point.

    Returns
    -------
    frame, point, pixel
        One row a sighting, sorted by point: shapes (N,), (N,) and (N, 2) [px]. A point with two places in one frame is
        left out: one of its matches is wrong.
    """
    offsets = np.concatenate([[0], np.cumsum([len(one) for one in keys.features])])
    links = [pair.rows + offsets[[pair.first, pair.second]] for pair in pairs]
    if not links:
        return np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros((0, 2))
    ends = np.concatenate(links)
    size = int(offsets[-1])
    graph = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    used = np.unique(ends)
    frame = np.searchsorted(offsets, used, side="right") - 1
    pixel = np.concatenate([one.points for one in keys.features])[used]
    label = label[used]
    count = np.bincount(label)
    twice = np.zeros(len(count), bool)
    order = np.lexsort((frame, label))
    same = (np.diff(label[order]) == 0) & (np.diff(frame[order]) == 0)
    twice[label[order][1:][same]] = True
    good = (count[label] >= least) & ~twice[label]
    order = order[good[order]]
    _, point = np.unique(label[order], return_inverse=True)
    return frame[order], point, pixel[order]
