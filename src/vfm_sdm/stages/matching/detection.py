"""Features of one image: SIFT on the image as it is and on stretched versions of it."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.inputs.video import Region

__all__ = [
    "Float32Array",
    "ImageFeatures",
    "add_stretched",
    "detect_features",
    "find_alike",
    "find_mutual",
    "to_eight_bit",
]

Float32Array = npt.NDArray[np.float32]

_LONG_SIDE_PX = 1500
"""Images with a longer side are reduced to it: finer features cost time and add nothing to the geometry."""
_FEATURES = 5000
"""Number of features of one version of an image."""
_CELLS = 16
"""Along a side of the grid over an image among whose cells half of the features are shared out. Leaves, bricks and
railings have the strongest ones; a painted or weathered surface has its own only if every place gets a share."""
_CONTRAST = 0.01
"""A quarter of what is usual for SIFT: real surfaces, painted or weathered, have little contrast."""
_STRETCHES = ((1.4, 1.0), (1.0, 1.4))
"""Factors along u and v of the stretched versions of an image: the step between the tilts of affine-SIFT, the square
root of two, is what SIFT itself bears."""
_SAME_PLACE_PX = 6.0
"""Features nearer than this describe one place, for instance with another orientation or size."""
_SAME_CORNER_PX = 0.75
_PASSES = 3
_CUT_PER_CENT, _SAMPLES = 0.5, 400


@dataclass(frozen=True, eq=False)
class ImageFeatures:
    """Features of one image.

    Parameters
    ----------
    points
        Full-image pixels, shape (N, 2) [px]. A corner that was found in several versions has the same digits in each.
    descriptors
        RootSIFT, shape (N, 128), of unit length.
    version
        Number of the version of the image in which each was found, shape (N,): 0 is the image as it is.
    place_px
        Distance up to which two features stand at one place [px].
    """

    points: FloatArray
    descriptors: Float32Array
    version: IntArray
    place_px: float

    def __len__(self) -> int:
        return len(self.points)


def detect_features(luma: LumaArray) -> ImageFeatures:
    """Features of an image as it is.

    Parameters
    ----------
    luma
        Image of 8 or 16 bits, shape (H, W).

    Returns
    -------
    features
        Half of them the strongest of the image, half shared out among its parts; empty where there is no contrast.

    Notes
    -----
    RootSIFT descriptors [1]_.

    References
    ----------
    .. [1] Arandjelovic, R., Zisserman, A. (2012). Three things everyone should know to improve object retrieval. IEEE
       Conference on Computer Vision and Pattern Recognition.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> features = detect_features(np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8))
    >>> len(features) > 100, set(features.version.tolist())
    (True, {0})
    """
    points, descriptors = _detect(to_eight_bit(luma), (1.0, 1.0))
    return ImageFeatures(points, descriptors, np.zeros(len(points), dtype=np.intp), _SAME_PLACE_PX / _scale(luma))


def add_stretched(features: ImageFeatures, luma: LumaArray) -> ImageFeatures:
    """Features of an image together with those of stretched versions of it, which resemble views at another angle.

    Parameters
    ----------
    features
        Those of the image as it is.
    luma
        The image, shape (H, W).

    Notes
    -----
    The versions are those of affine-SIFT [1]_ for one tilt in two directions, without its rotations.

    References
    ----------
    .. [1] Morel, J.-M., Yu, G. (2009). ASIFT: a new framework for fully affine invariant image comparison. SIAM Journal
       on Imaging Sciences 2(2), 438-469.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> image = np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8)
    >>> set(add_stretched(detect_features(image), image).version.tolist())
    {0, 1, 2}
    """
    image = to_eight_bit(luma)
    points, descriptors, version = [features.points], [features.descriptors], [features.version]
    for number, stretch in enumerate(_STRETCHES, start=1):
        places, described = _detect(image, stretch)
        if len(places) and len(features):
            apart, nearest = cKDTree(features.points).query(places)
            known = apart < _SAME_CORNER_PX / _scale(luma)
            places[known] = features.points[np.asarray(nearest)[known]]
        points.append(places)
        descriptors.append(described)
        version.append(np.full(len(places), number, dtype=np.intp))
    return ImageFeatures(
        np.concatenate(points), np.concatenate(descriptors), np.concatenate(version), features.place_px
    )


def find_alike(features: ImageFeatures, rows: IntArray) -> Float32Array:
    """Distance of descriptors to the most similar one at another place of the same version of the image.

    Parameters
    ----------
    features
        Features of one image.
    rows
        Indices of those in question, shape (K,).

    Returns
    -------
    distance
        Shape (K,) [1]; small where structure repeats itself, infinite where there is nothing else.
    """
    distance = np.full(rows.size, np.inf, np.float32)
    for number in np.unique(features.version[rows]):
        members = np.flatnonzero(features.version == number)
        own = np.flatnonzero(features.version[rows] == number)
        likeness = features.descriptors[rows[own]] @ features.descriptors[members].T
        best = np.searchsorted(members, rows[own])
        distance[own] = _distance(_best_elsewhere(likeness, features.points[members], best, features.place_px))
    return distance


def find_mutual(
    likeness: Float32Array, points: tuple[FloatArray, FloatArray], place_px: tuple[float, float]
) -> tuple[IntArray, IntArray, Float32Array, Float32Array]:
    """Pairs of features that are most similar to each other, their distance, and that to the next best elsewhere.

    Parameters
    ----------
    likeness
        Inner products of the unit descriptors of two images, shape (N, M).
    points
        Where the features of both stand, shapes (N, 2) and (M, 2) [px].
    place_px
        Distances in both up to which two features stand at one place [px].

    Returns
    -------
    rows, columns
        Indices of the features of K pairs, shape (K,) each.
    distance, next_distance
        Distance between the descriptors of each pair, and the lesser of those to the next best feature at another place
        of either image, shape (K,) each.

    Examples
    --------
    >>> likeness = np.array([[0.9, 0.2], [0.8, 0.1]], np.float32)
    >>> places = np.array([[0.0, 0.0], [9.0, 0.0]])
    >>> [found.tolist() for found in find_mutual(likeness, (places, places), (2.0, 2.0))[:2]]
    [[0], [0]]
    """
    best = likeness.argmax(axis=1)
    top = likeness[np.arange(len(likeness)), best]
    rows = np.flatnonzero(top >= likeness.max(axis=0)[best])
    # Of equals, the first.
    rows = rows[np.sort(np.unique(best[rows], return_index=True)[1])]
    columns = best[rows]
    # The rest is asked of these pairs alone: each of the passes over all would cost as much as those above.
    ahead = _best_elsewhere(likeness[rows], points[1], columns, place_px[1])
    back = _best_elsewhere(np.ascontiguousarray(likeness[:, columns].T), points[0], rows, place_px[0])
    return rows, columns, _distance(top[rows]), _distance(np.maximum(ahead, back))


def _best_elsewhere(likeness: Float32Array, points: FloatArray, best: IntArray, place_px: float) -> Float32Array:
    """Greatest likeness at a place other than that of ``best``, shape (N,); of the few greatest if all stand there.

    ``likeness`` (N, M) is overwritten.
    """
    found = np.empty(len(likeness), np.float32)
    left = np.arange(len(likeness))
    likeness[left, best] = -1.0
    for _ in range(_PASSES):
        here, column = np.arange(len(left)), likeness.argmax(axis=1)
        found[left] = likeness[here, column]
        beside = np.linalg.norm(points[column] - points[best[left]], axis=1) <= place_px
        likeness[here, column] = -1.0
        likeness, left = likeness[beside], left[beside]
    return found


def _distance(likeness: Float32Array) -> Float32Array:
    """Distance between unit vectors from their inner product."""
    distance: Float32Array = np.sqrt(np.maximum(2 - 2 * likeness, np.float32(1e-9)))
    return distance


def _scale(luma: LumaArray) -> float:
    """By how much an image is reduced [1]."""
    return min(1.0, _LONG_SIDE_PX / float(max(luma.shape)))


def _detect(image: npt.NDArray[np.uint8], stretch: tuple[float, float]) -> tuple[FloatArray, Float32Array]:
    """Feature pixels of the whole image, shape (N, 2), and descriptors, shape (N, 128), of a version of it."""
    height, width = image.shape
    wanted = np.array([width, height]) * stretch * _scale(image)
    size = (round(wanted[0]), round(wanted[1]))
    region = Region(0, 0, width, height, scale_u=size[0] / width, scale_v=size[1] / height)
    if size != (width, height):
        smaller = size[0] <= width and size[1] <= height
        resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
        image = np.asarray(resized, dtype=np.uint8)
    # Without the precise upscale OpenCV's SIFT places every feature a quarter of a pixel off.
    sift = cv2.SIFT.create(contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    found = sift.detect(image, None)
    if not found:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    chosen = _spread(np.array([k.pt for k in found]), np.array([k.response for k in found]), size)
    keypoints, descriptors = sift.compute(image, [found[index] for index in chosen])
    points = region.to_full(np.array([k.pt for k in keypoints], dtype=np.float64))
    # One corner gives several descriptors when it has several orientations: they stand at one place.
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return points, root.astype(np.float32)


def _spread(points: FloatArray, response: FloatArray, size: tuple[int, int]) -> IntArray:
    """Indices of features that are chosen: the strongest, and of the others the strongest of every cell in turn."""
    order = np.argsort(-response, kind="stable")
    strongest, others = np.split(order, [_FEATURES // 2])
    column, row = (points[others] * _CELLS // size).astype(int).T
    cell = row * _CELLS + column
    by_cell = np.argsort(cell, kind="stable")
    rank = np.empty(others.size, dtype=np.intp)
    rank[by_cell] = np.arange(others.size) - np.searchsorted(cell[by_cell], cell[by_cell])
    shared = others[np.argsort(rank, kind="stable")[: _FEATURES - _FEATURES // 2]]
    return np.sort(np.concatenate([strongest, shared]))


def to_eight_bit(luma: LumaArray) -> npt.NDArray[np.uint8]:
    """The image stretched to 8 bit for feature detection; grey values are not comparable between images.

    Parameters
    ----------
    luma
        Image of 8 or 16 bits, shape (H, W).

    Notes
    -----
    The stretch leaves out the darkest and brightest half per cent of the pixels: a dark or hazy view has features too,
    of a contrast below what detectors take for noise.

    Examples
    --------
    >>> to_eight_bit(np.array([[1000, 2000], [3000, 4000]], np.uint16)).dtype
    dtype('uint8')
    """
    every = max(1, min(luma.shape) // _SAMPLES)
    low, high = np.percentile(luma[::every, ::every], [_CUT_PER_CENT, 100 - _CUT_PER_CENT])
    stretched = (luma.astype(np.float32) - np.float32(low)) * np.float32(255.0 / max(high - low, 1.0))
    return np.asarray(np.round(np.clip(stretched, 0, 255)), dtype=np.uint8)
