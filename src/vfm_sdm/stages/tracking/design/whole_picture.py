"""How a whole picture moves where its camera does: by hundreds of pixels, turned and in another size."""

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.stages.tracking.design.window import Image

__all__ = ["PictureMotion", "cut_turned"]

_SMALL_PX, _TINY_PX = 960, 160
"""Width of the copies in which features are looked for, and of those that show whether the whole picture moves [px]."""
_FAR = 0.02
"""Share of the width by which a whole picture must move for its camera to be taken for one that moves far."""
_CLEAR = 0.05
"""Response of the phase correlation [1] below which it found nothing: what moves then is not the picture."""
_RATIO = 0.75
"""A feature's best match must be nearer than its second best by this factor (Lowe)."""
_FEWEST = 12
_WITHIN_PX = 3.0
"""How far parallax may move features from where the picture on the whole goes, in the small copy [px]."""


class PictureMotion:
    """Motion of whole pictures against the reference frame.

    Parameters
    ----------
    reference
        The reference frame, shape (H, W).

    Notes
    -----
    Phase correlation of tiny copies says whether a picture moves at all: nothing else costs anything for cameras on
    tripods. Where it does, features (SIFT) matched over the whole picture give the homography that most of them follow.

    References
    ----------
    .. [1] Lowe, D. G. (2004). Distinctive image features from scale-invariant keypoints. International Journal of
       Computer Vision 60, 91-110.
    """

    def __init__(self, reference: LumaArray) -> None:
        self._width = reference.shape[1]
        self._tiny = _shrink(reference, _TINY_PX)
        self._window = cv2.createHanningWindow(self._tiny.shape[::-1], cv2.CV_32F)
        self._small = _shrink(reference, _SMALL_PX)
        self._features: tuple[FloatArray, Image] | None = None

    def find(self, luma: LumaArray) -> FloatArray | None:
        """Homography from the reference frame to a frame, shape (3, 3) [px]; ``None`` where the picture stays near.

        NaN where it does not stay near, and nothing tells where it went.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        """
        (u, v), response = cv2.phaseCorrelate(self._tiny, _shrink(luma, _TINY_PX), self._window)
        if response >= _CLEAR and np.hypot(u, v) <= _FAR * self._tiny.shape[1]:
            return None
        found = self._match(_shrink(luma, _SMALL_PX))
        if found is None:
            return None if response < _CLEAR else np.full((3, 3), np.nan)
        moved = cv2.perspectiveTransform(np.array([[[0.5 * n for n in self._small.shape[::-1]]]]), found)[0, 0]
        if np.hypot(*(moved - np.array(self._small.shape[::-1]) / 2)) <= _FAR * self._small.shape[1]:
            return None
        # A pixel's centre is a whole number in both sizes.
        scale = self._small.shape[1] / self._width
        grow = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1.0]])
        return np.asarray(np.linalg.inv(grow) @ found @ grow)

    def _match(self, small: Image) -> FloatArray | None:
        if self._features is None:
            self._features = _describe(self._small)
        (places, words), (others, theirs) = self._features, _describe(small)
        if min(len(places), len(others)) < _FEWEST:
            return None
        pairs = cv2.BFMatcher().knnMatch(words, theirs, k=2)
        kept = [best for best, second in pairs if best.distance < _RATIO * second.distance]
        if len(kept) < _FEWEST:
            return None
        source = places[[one.queryIdx for one in kept]]
        target = others[[one.trainIdx for one in kept]]
        found, inside = cv2.findHomography(source, target, cv2.USAC_MAGSAC, _WITHIN_PX)
        if found is None or int(inside.sum()) < _FEWEST:
            return None
        return np.asarray(found, np.float64)


def cut_turned(image: LumaArray, center: IntArray, half: int, homography: FloatArray) -> LumaArray:
    """The window around a pixel of the reference frame, as another frame shows it, turned back.

    Parameters
    ----------
    image
        The other frame, shape (H, W).
    center
        Middle of the window in the reference frame, shape (2,) [px].
    half
        Half its side, without its middle [px].
    homography
        From the reference frame to the other, shape (3, 3) [px].

    Returns
    -------
    window
        Shape (2 half + 1, 2 half + 1), of the image's depth; its border repeated where it leaves the image.
    """
    side, (u, v) = 2 * half + 1, center.tolist()
    shift = np.array([[1.0, 0.0, u - half], [0.0, 1.0, v - half], [0.0, 0.0, 1.0]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    turned = cv2.warpPerspective(image, homography @ shift, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    window: LumaArray = turned.astype(image.dtype)  # type: ignore[assignment]  # the depth of the video
    return window


def _shrink(luma: LumaArray, width: int) -> Image:
    """A copy of this width at most, from 0 to 255."""
    width = min(width, luma.shape[1])
    size = width, max(1, round(luma.shape[0] * width / luma.shape[1]))
    small = cv2.resize(luma.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    low, high = float(small.min()), float(small.max())
    return np.asarray((small - low) * (255.0 / max(high - low, 1.0)), np.float32)


def _describe(small: Image) -> tuple[FloatArray, Image]:
    points, words = cv2.SIFT.create(3000).detectAndCompute(small.astype(np.uint8), None)
    places = np.array([point.pt for point in points], np.float64).reshape(-1, 2)
    return places, np.zeros((0, 128), np.float32) if words is None else words
