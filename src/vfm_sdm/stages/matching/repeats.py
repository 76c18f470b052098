"""Features of patterns that repeat: the look-alikes of neighbours lie apart by one and the same step."""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.stages.matching.detection import Float32Array, ImageFeatures

__all__ = ["find_repeats", "lie_on_repeats"]

_MAPS = 8
"""Number of steps that are sought: to four neighbours, and of two patterns."""
_APART, _WITHIN = 0.02, 0.004
"""Distance from which a look-alike is another place, and tolerance of a step, over the longer side of what features
cover: two per cent are a few times the size of a feature."""
_LEAST = 16
"""Number of look-alikes from which a step is no chance. Among a thousand that lie anywhere, a tolerance of 0.004 of the
side holds 0.1, and three more fix the map."""
_SHARE = 0.25
"""Share of the features around a place that makes it one of a pattern: between them noise has features, too."""
_AROUND = 0.01
_ROWS = 500


def find_repeats(features: ImageFeatures) -> BoolArray:
    """Which features of an image as it is belong to a pattern that repeats.

    Parameters
    ----------
    features
        N features of the image.

    Returns
    -------
    repeated
        Shape (N,); False for features of other versions of the image.

    Notes
    -----
    Each feature's most similar one at another place of the image is sought. Where nothing repeats, it lies anywhere;
    where tiles, balusters or windows do, those of many features follow one affine map, as the pattern's step is seen in
    perspective. Such maps are found one after the other by random samples [1]_. How similar the two are is not asked:
    a distant window of a row resembles its neighbour less than the one in the other view that is seen at its angle.

    References
    ----------
    .. [1] Fischler, M. A., Bolles, R. C. (1981). Random sample consensus. Communications of the ACM 24(6), 381-395.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> from vfm_sdm.stages.matching.detection import detect_features
    >>> rng = np.random.default_rng(0)
    >>> texture = [gaussian_filter(rng.normal(0, 1, (240, 80)), 2) for _ in range(4)]
    >>> wall, meadow = np.hstack([texture[0]] * 4), np.hstack(texture)
    >>> images = [np.rint(128 + 300 * one).clip(0, 255).astype(np.uint8) for one in (wall, meadow)]
    >>> shares = [find_repeats(detect_features(image)).mean() for image in images]
    >>> bool(shares[0] > 0.8), bool(shares[1] < 0.1)
    (True, True)
    """
    rows = np.flatnonzero(features.version == 0)
    repeated = np.zeros(len(features), dtype=np.bool_)
    if rows.size <= _LEAST:
        return repeated
    points, descriptors = features.points[rows], features.descriptors[rows]
    side = float(np.ptp(points, axis=0).max())
    partner = np.concatenate(
        [
            _find_elsewhere(descriptors, points, np.arange(start, min(start + _ROWS, rows.size)), _APART * side)
            for start in range(0, rows.size, _ROWS)
        ]
    )
    there, left = points[partner], np.ones(rows.size, dtype=np.bool_)
    cv2.setRNGSeed(0)
    for _ in range(_MAPS):
        members = np.flatnonzero(left)
        if members.size <= _LEAST:
            break
        found, inside = cv2.estimateAffine2D(
            points[members], there[members], method=cv2.RANSAC, ransacReprojThreshold=_WITHIN * side, maxIters=3000
        )
        agree = members[inside.ravel() > 0]
        if found is None or len(agree) < _LEAST:
            break
        left[agree] = False
    repeated[rows[~left]] = True
    return repeated


def lie_on_repeats(points2d: FloatArray, features: ImageFeatures) -> BoolArray:
    """Which places of an image lie on patterns that repeat.

    Parameters
    ----------
    points2d
        Pixels, shape (N, 2) [px].
    features
        Features of the image.

    Returns
    -------
    on_repeats
        Whether a quarter of the features around a place or more belong to such a pattern, shape (N,).

    Examples
    --------
    >>> descriptors, version = np.zeros((0, 128), dtype=np.float32), np.zeros(0, dtype=np.intp)
    >>> features = ImageFeatures(np.zeros((0, 2)), descriptors, version, 3.0)
    >>> lie_on_repeats(np.array([[11.0, 9.0], [200.0, 9.0]]), features).tolist()
    [False, False]
    """
    repeated = find_repeats(features)[features.version == 0]
    if not repeated.any() or not len(points2d):
        return np.zeros(len(points2d), dtype=np.bool_)
    points = features.points[features.version == 0]
    near = cKDTree(points).query_ball_point(points2d, _AROUND * float(np.ptp(points, axis=0).max()))
    return np.array([bool(rows) and bool(repeated[rows].mean() >= _SHARE) for rows in near], dtype=np.bool_)


def _find_elsewhere(descriptors: Float32Array, points: FloatArray, rows: IntArray, apart_px: float) -> IntArray:
    """Index of the most similar feature at another place, for some rows."""
    likeness = descriptors[rows] @ descriptors.T
    u, v = points.T.astype(np.float32)
    near = (u[rows, None] - u) ** 2 + (v[rows, None] - v) ** 2 < apart_px**2
    likeness[near] = -1.0
    return np.asarray(likeness.argmax(axis=1), dtype=np.intp)
