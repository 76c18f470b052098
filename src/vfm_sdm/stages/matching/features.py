"""Feature matches between two images before any geometric check: SIFT, mutual nearest neighbours, ratio test."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.matching.detection import (
    ImageFeatures,
    add_stretched,
    detect_features,
    find_alike,
    find_mutual,
)

__all__ = ["FeatureMatches", "keep_one_a_place", "match_detected", "match_features", "unite_versions"]

_RATIO = 0.9
"""Of the distance to a match over that to the next one alike. The usual 0.8 is for one run that must be nearly free of
false matches; here a consensus follows, and two views at an angle differ more."""
_SAME_PLACE_PX = 2.5
"""Matches of two versions that stand as near in both images are one."""


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """Features that look alike in two images.

    Parameters
    ----------
    points_first, points_second
        Pixels in both images, shape (N, 2) each [px].
    quality
        How distinct each match is, shape (N,) [1], from 0 to 1. For SIFT it is one less the ratio of two distances:
        that between the two descriptors, and that to the next similar one at another place of either image. For
        networks it is their own score.

    Raises
    ------
    DatasetError
        An array has another shape, or they differ in length.

    Examples
    --------
    >>> matches = FeatureMatches([[10.0, 20.0]], [[12.0, 20.5]], [0.4])
    >>> len(matches)
    1
    """

    points_first: FloatArray
    points_second: FloatArray
    quality: FloatArray

    def __post_init__(self) -> None:
        for name, shape in (("points_first", (None, 2)), ("points_second", (None, 2)), ("quality", (None,))):
            object.__setattr__(self, name, as_float_array(getattr(self, name), name, shape))
        if not len(self.points_first) == len(self.points_second) == len(self.quality):
            raise DatasetError(
                f"feature matches: expected arrays of one length, got {len(self.points_first)}, "
                f"{len(self.points_second)} and {len(self.quality)}; keep only what is known of every match"
            )

    def __len__(self) -> int:
        return len(self.points_first)

    def chosen(self, rows: IntArray | BoolArray) -> "FeatureMatches":
        """Some of the matches, by their indices or a mask of shape (N,)."""
        return FeatureMatches(self.points_first[rows], self.points_second[rows], self.quality[rows])


def match_features(
    first: LumaArray, second: LumaArray, *, known: tuple[ImageFeatures, ImageFeatures] | None = None
) -> FeatureMatches:
    """Features that look alike in two images, before any geometric check.

    Parameters
    ----------
    first, second
        Luma, shape (H, W); the two sizes may differ.
    known
        Features of both images as they are, where they were detected before.

    Returns
    -------
    matches
        Pixels in both images and the quality of each match, the best first; empty when nothing matches.

    Notes
    -----
    Each image as it is is compared with the other and with stretched versions of it
    (`vfm_sdm.stages.matching.detection.add_stretched`), and the matches are united. A match must be the best one in
    both directions and pass the ratio test of [1]_ against everything that looks like it at another place of either
    image: a brick has as many look-alikes as the wall has bricks, though the other view may show but one of them.

    References
    ----------
    .. [1] Lowe, D. G. (2004). Distinctive image features from scale-invariant keypoints. International Journal of
       Computer Vision 60(2), 91-110.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> image = np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8)
    >>> matches = match_features(image[:, 20:], image[:, :-20])
    >>> shift = np.median(matches.points_second - matches.points_first, axis=0)
    >>> len(matches) > 50, bool(np.allclose(shift, [20, 0], atol=0.1))
    (True, True)
    """
    images = (first, second)
    # One after the other: SIFT itself works in threads, and holds eleven doubled images in single precision.
    found = known or map(detect_features, images)
    return match_detected(*map(add_stretched, found, images))


def match_detected(first: ImageFeatures, second: ImageFeatures) -> FeatureMatches:
    """As `match_features`, of features that were detected before: all versions of each image with the other as it is.

    Parameters
    ----------
    first, second
        Features of each image.
    """
    return unite_versions(first, second, lambda rows, columns: _match_versions(first, second, rows, columns))


def unite_versions(
    first: ImageFeatures,
    second: ImageFeatures,
    match: Callable[[IntArray, IntArray], tuple[IntArray, IntArray, FloatArray]],
) -> FeatureMatches:
    """Matches of each image as it is with every version of the other.

    Parameters
    ----------
    first, second
        Features of each image.
    match
        Called with the indices of features of one version of each image, two at least; gives the indices of matched
        ones in both images and the quality of each match.

    Returns
    -------
    matches
        One of those that stand at a place in either image, the best first.
    """
    versions = [(0, int(k)) for k in np.unique(second.version)] + [(int(k), 0) for k in np.unique(first.version) if k]
    pairs = [(np.flatnonzero(first.version == i), np.flatnonzero(second.version == j)) for i, j in versions]
    found = [match(*pair) for pair in pairs if min(pair[0].size, pair[1].size) >= 2]
    rows, partners = (np.concatenate([np.empty(0, np.intp), *(one[k] for one in found)]) for k in range(2))
    quality = np.concatenate([np.empty(0), *(one[2] for one in found)])
    return keep_one_a_place(FeatureMatches(first.points[rows], second.points[partners], quality), _SAME_PLACE_PX)


def keep_one_a_place(matches: FeatureMatches, radius_px: float) -> FeatureMatches:
    """The best match of those that share a place in either image, best first.

    Parameters
    ----------
    matches
        Matches, in any order.
    radius_px
        Distance up to which two features stand at one place [px].

    Examples
    --------
    >>> pixels = np.array([[10.0, 10.0], [11.0, 10.0], [50.0, 10.0]])
    >>> keep_one_a_place(FeatureMatches(pixels, pixels, [0.2, 0.3, 0.1]), 2.5).quality.tolist()
    [0.3, 0.1]
    """
    if not len(matches):
        return matches
    near = [
        cKDTree(points).query_ball_point(points, radius_px) for points in (matches.points_first, matches.points_second)
    ]
    taken, kept = np.zeros(len(matches), dtype=bool), []
    for row in np.argsort(-matches.quality, kind="stable"):
        if not taken[row]:
            kept.append(row)
            taken[near[0][row]] = taken[near[1][row]] = True
    return matches.chosen(np.array(kept))


def _match_versions(
    a: ImageFeatures, b: ImageFeatures, rows: IntArray, columns: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Indices of matched features of one version of each image, and the quality of each match."""
    likeness = a.descriptors[rows] @ b.descriptors[columns].T
    one, other, distance, next_distance = find_mutual(
        likeness, (a.points[rows], b.points[columns]), (a.place_px, b.place_px)
    )
    del likeness
    distinct = distance < _RATIO * next_distance
    chosen, partner = rows[one[distinct]], columns[other[distinct]]
    # Look-alikes within an image are asked of those that are left: this costs as much as matching two images.
    alike = np.minimum(find_alike(a, chosen), find_alike(b, partner))
    ratio = distance[distinct] / np.minimum(next_distance[distinct], alike)
    kept = ratio < _RATIO
    return chosen[kept], partner[kept], 1.0 - ratio[kept].astype(np.float64)
