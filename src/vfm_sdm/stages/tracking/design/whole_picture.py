"""How a whole picture moves where its camera does: by hundreds of pixels, turned and in another size."""

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.stages.tracking.design.window import Image

__all__ = ["PictureMotion", "cut_turned"]

_SMALL_PX, _TINY_PX = 960, 160
"""Width of the copies in which features are looked for, and of those that show whether the whole picture moves [px]."""
_DETAIL_PX = 4.0
"""What is coarser than this (standard deviation) in the tiny copies hardly changes as a camera moves [px]."""
_STILL = 0.5
"""Correlation of their detail with that of the reference frame [1] from which on the camera is where it was."""
_GAIN = 0.25
"""By how much turning a picture back must raise that correlation [1]: else it is not the camera that moved."""
_FAR_PX = 24.0
"""Shift of a part of the picture that windows hold with their margin [px]."""
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
    Tiny copies that correlate say that the camera is where it was: nothing else costs anything on a tripod. Where they
    do not, features (SIFT) matched over the whole picture give the homography that most of them follow; it counts where
    the picture turned back by it is clearly more like the reference frame.

    References
    ----------
    .. [1] Lowe, D. G. (2004). Distinctive image features from scale-invariant keypoints. International Journal of
       Computer Vision 60, 91-110.
    """

    def __init__(self, reference: LumaArray) -> None:
        self._width = reference.shape[1]
        right, bottom = np.array(reference.shape[::-1], float) - 1
        self._corners = np.array([[0, 0, 1], [right, 0, 1], [0, bottom, 1], [right, bottom, 1]])
        self._small, self._tiny = _shrink(reference, _SMALL_PX), _detail(reference)
        self._features: tuple[FloatArray, Image] | None = None

    def find(self, luma: LumaArray) -> FloatArray | None:
        """Homography from the reference frame to a frame, shape (3, 3) [px]; ``None`` where no camera moved far.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        """
        still = _correlate(self._tiny, _detail(luma))
        if still >= _STILL:
            return None
        small = _shrink(luma, _SMALL_PX)
        found = self._match(small)
        if found is None:
            return None
        size = self._small.shape[::-1]
        turned = cv2.warpPerspective(small, found, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        back = np.asarray(turned, np.float32)
        if not _correlate(self._tiny, _detail(back)) >= still + _GAIN:
            return None
        # A pixel's centre is a whole number in both sizes.
        scale = self._small.shape[1] / self._width
        grow = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1.0]])
        homography = np.asarray(np.linalg.inv(grow) @ found @ grow)
        return homography if self._is_far(homography) else None

    def _is_far(self, homography: FloatArray) -> bool:
        """Whether it moves a corner of the picture farther than subsets follow by themselves."""
        moved = self._corners @ homography.T
        shift = moved[:, :2] / moved[:, 2:] - self._corners[:, :2]
        return bool(np.linalg.norm(shift, axis=1).max() > _FAR_PX)

    def _match(self, small: Image) -> FloatArray | None:
        """Homography from the small copy of the reference frame to another one; ``None`` where too few agree."""
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


def _shrink(luma: LumaArray | Image, width: int) -> Image:
    """A copy of this width at most, from 0 to 255."""
    width = min(width, luma.shape[1])
    size = width, max(1, round(luma.shape[0] * width / luma.shape[1]))
    small = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.float32)
    low, high = float(small.min()), float(small.max())
    return np.asarray((small - low) * (255.0 / max(high - low, 1.0)), np.float32)


def _detail(luma: LumaArray | Image) -> Image:
    """What is fine in a tiny copy."""
    tiny = _shrink(luma, _TINY_PX)
    return np.asarray(tiny - cv2.GaussianBlur(tiny, (0, 0), _DETAIL_PX), np.float32)


def _correlate(first: Image, second: Image) -> float:
    """Correlation coefficient of two pictures [1]; 0 where one is flat."""
    spread = float(first.std() * second.std())
    return float(np.mean((first - first.mean()) * (second - second.mean()))) / spread if spread > 0 else 0.0


def _describe(small: Image) -> tuple[FloatArray, Image]:
    """Places (N, 2) [px] and descriptors (N, 128) of the features of a picture."""
    points, words = cv2.SIFT.create(3000).detectAndCompute(small.astype(np.uint8), None)
    places = np.array([point.pt for point in points], np.float64).reshape(-1, 2)
    return places, np.zeros((0, 128), np.float32) if words is None else np.asarray(words, np.float32)
