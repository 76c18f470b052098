"""Features of one image: SIFT on the image as it is and on stretched versions of it."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.inputs.video import Region

__all__ = ["Float32Array", "ImageFeatures", "detect_features", "find_alike", "find_nearest", "to_eight_bit"]

Float32Array = npt.NDArray[np.float32]

_LONG_SIDE_PX = 1500
"""Images with a longer side are reduced to it: finer features cost time and add nothing to the geometry."""
_FEATURES = 4000
_CELLS = 16
"""Along a side of the grid over an image in whose cells features are chosen. Leaves, bricks and railings have the
strongest ones; the painted or weathered surface of interest has its own if every place gets a share."""
_CONTRAST = 0.01
"""A quarter of what is usual for SIFT: real surfaces, painted or weathered, have little contrast."""
_STRETCHES = ((1.0, 1.0), (1.4, 1.0), (1.0, 1.4))
"""Factors along u and v of the versions of an image. SIFT bears a relative stretch of up to about 1.4 (the step between
tilts in affine-SIFT is the square root of two); with one version of each image stretched in turn it is bridged up to
two."""
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


def detect_features(luma: LumaArray, *, stretched: bool = True) -> ImageFeatures:
    """Features of an image and of stretched versions of it, so that a view at another angle resembles one of them.

    Parameters
    ----------
    luma
        Image of 8 or 16 bits, shape (H, W).
    stretched
        Whether versions are searched at all; not where the views already resemble each other.

    Returns
    -------
    features
        Features of all versions; empty where there is no contrast.

    Notes
    -----
    RootSIFT descriptors [1]_. The versions are those of affine-SIFT [2]_ for one tilt in two directions, without its
    rotations.

    References
    ----------
    .. [1] Arandjelovic, R., Zisserman, A. (2012). Three things everyone should know to improve object retrieval. IEEE
       Conference on Computer Vision and Pattern Recognition.
    .. [2] Morel, J.-M., Yu, G. (2009). ASIFT: a new framework for fully affine invariant image comparison. SIAM Journal
       on Imaging Sciences 2(2), 438-469.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> features = detect_features(np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8))
    >>> len(features) > 100, sorted(set(features.version.tolist()))
    (True, [0, 1, 2])
    """
    image = to_eight_bit(luma)
    height, width = image.shape
    scale = min(1.0, _LONG_SIDE_PX / max(height, width))
    place_px = _SAME_PLACE_PX / scale
    versions = _STRETCHES if stretched else _STRETCHES[:1]
    found = [_detect(image, (round(width * scale * u), round(height * scale * v))) for u, v in versions]
    plain = found[0][0]
    points, descriptors, version = [np.empty((0, 2))], [np.empty((0, 128), np.float32)], [np.empty(0, dtype=np.intp)]
    for number, (places, described) in enumerate(found):
        if len(places) < 2:
            continue
        if number and len(plain):
            apart, nearest = cKDTree(plain).query(places)
            corner = np.asarray(nearest)
            known = apart < _SAME_CORNER_PX / scale
            places[known] = plain[corner[known]]
        points.append(places)
        descriptors.append(described)
        version.append(np.full(len(places), number))
    return ImageFeatures(np.concatenate(points), np.concatenate(descriptors), np.concatenate(version), place_px)


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
        likeness[np.arange(own.size), best] = -1.0
        distance[own] = _distance(_best_elsewhere(likeness, features.points[members], best, features.place_px))
    return distance


def find_nearest(
    likeness: Float32Array, points: FloatArray, place_px: float
) -> tuple[IntArray, Float32Array, Float32Array]:
    """Most similar feature of each, its distance, and the distance to the next best at another place.

    Parameters
    ----------
    likeness
        Inner products of unit descriptors, shape (N, M); overwritten. -1 where a pair is out of the question.
    points
        Where the M features stand, shape (M, 2) [px].
    place_px
        Distance up to which two features stand at one place [px].

    Returns
    -------
    best, distance, next_distance
        Index of the most similar feature, the distance between descriptors, and that of the next, shape (N,) each.
    """
    rows = np.arange(len(likeness))
    best = likeness.argmax(axis=1)
    top = likeness[rows, best]
    likeness[rows, best] = -1.0
    return best, _distance(top), _distance(_best_elsewhere(likeness, points, best, place_px))


def _best_elsewhere(likeness: Float32Array, points: FloatArray, best: IntArray, place_px: float) -> Float32Array:
    """Greatest likeness at a place other than that of ``best``, shape (N,); of the few greatest if all stand there."""
    rows = np.arange(len(likeness))
    found = np.full(len(likeness), np.nan, np.float32)
    for _ in range(_PASSES):
        column = likeness.argmax(axis=1)
        value = likeness[rows, column]
        likeness[rows, column] = -1.0
        elsewhere = np.linalg.norm(points[column] - points[best], axis=1) > place_px
        found = np.where(np.isnan(found) & elsewhere, value, found)
    return np.where(np.isnan(found), value, found)


def _distance(likeness: Float32Array) -> Float32Array:
    """Distance between unit vectors from their inner product."""
    distance: Float32Array = np.sqrt(np.maximum(2 - 2 * likeness, np.float32(1e-9)))
    return distance


def _detect(image: npt.NDArray[np.uint8], size: tuple[int, int]) -> tuple[FloatArray, Float32Array]:
    """Feature pixels of the whole image, shape (N, 2), and descriptors, shape (N, 128), at a size (width, height)."""
    height, width = image.shape
    region = Region(0, 0, width, height, scale_u=size[0] / width, scale_v=size[1] / height)
    if size != (width, height):
        smaller = size[0] <= width and size[1] <= height
        image = np.asarray(
            cv2.resize(image, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR), dtype=np.uint8
        )
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
    """Indices of the strongest features of every cell of an image, in equal number where there are as many."""
    column, row = (points * _CELLS // size).astype(int).T
    cell = row * _CELLS + column
    order = np.lexsort((-response, cell))
    start = np.searchsorted(cell[order], cell[order])
    rank = np.arange(order.size) - start
    return np.asarray(np.sort(order[np.argsort(rank, kind="stable")[:_FEATURES]]))


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
