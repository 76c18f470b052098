"""Feature matches between two images: SIFT, mutual nearest neighbours, ratio test."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.inputs.video import Region

__all__ = ["detect_features", "match_features", "to_eight_bit"]

_LONG_SIDE_PX = 1500
"""Images with a longer side are reduced to it: finer features cost time and add nothing to the geometry."""
_FEATURES = 4000
_RATIO = 0.85
_CUT_PER_CENT, _SAMPLES = 0.5, 400


def match_features(first: LumaArray, second: LumaArray) -> tuple[FloatArray, FloatArray]:
    """Pixels of features that look alike in two images, before any geometric check.

    Parameters
    ----------
    first, second
        Luma, shape (H, W); the two sizes may differ.

    Returns
    -------
    points_first, points_second
        Pixels in both images, shape (N, 2) each [px]; empty when nothing matches.

    Notes
    -----
    RootSIFT descriptors [1]_ are compared by their inner product; a match must be the best one in both directions and
    pass the ratio test of [2]_.

    References
    ----------
    .. [1] Arandjelovic, R., Zisserman, A. (2012). Three things everyone should know to improve object retrieval. IEEE
       Conference on Computer Vision and Pattern Recognition.
    .. [2] Lowe, D. G. (2004). Distinctive image features from scale-invariant keypoints. International Journal of
    Computer
       Vision 60(2), 91-110.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> image = np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8)
    >>> first, second = match_features(image[:, 20:], image[:, :-20])
    >>> len(first) > 50, bool(np.allclose(np.median(second - first, axis=0), [20, 0], atol=0.1))
    (True, True)
    """
    with ThreadPoolExecutor(2) as executor:
        (points_a, descriptors_a), (points_b, descriptors_b) = executor.map(detect_features, (first, second))
    if min(len(points_a), len(points_b)) < 2:
        return np.empty((0, 2)), np.empty((0, 2))
    similarity = descriptors_a @ descriptors_b.T
    best = similarity.argmax(axis=1)
    back = similarity.argmax(axis=0)
    rows = np.arange(len(points_a))
    top = similarity[rows, best]
    similarity[rows, best] = -1.0
    runner_up = similarity.max(axis=1)
    # For unit vectors the squared distance is 2 - 2 s, so the ratio test compares 1 - s.
    distinct = (1 - top) < _RATIO**2 * (1 - runner_up)
    kept = distinct & (back[best] == rows)
    return points_a[kept], points_b[best[kept]]


def to_eight_bit(luma: LumaArray) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
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


def detect_features(luma: LumaArray) -> tuple[FloatArray, np.ndarray[tuple[int, int], np.dtype[np.float32]]]:
    """Feature pixels, shape (N, 2), and RootSIFT descriptors, shape (N, 128)."""
    image = to_eight_bit(luma)
    height, width = image.shape
    scale = min(1.0, _LONG_SIDE_PX / max(height, width))
    size = (round(width * scale), round(height * scale))
    region = Region(0, 0, width, height, scale_u=size[0] / width, scale_v=size[1] / height)
    if scale < 1:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    # Without the precise upscale OpenCV's SIFT places every feature a quarter of a pixel off.
    sift = cv2.SIFT.create(_FEATURES, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(image, None)
    if descriptors is None:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    points = region.to_full(np.array([k.pt for k in keypoints], dtype=np.float64))
    # One corner gives several descriptors when it has several orientations: they stand at one place.
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return points, root.astype(np.float32)
