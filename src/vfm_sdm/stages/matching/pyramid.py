"""Two views of a scene, and the same reduced by whole numbers: for points that the full images do not show."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.registration.records import Registration, Starts
from vfm_sdm.stages.registration.subsets import register_subset

__all__ = ["MIN_CORRELATION", "Level", "ViewPair", "reduce_pair"]

MIN_CORRELATION = 0.7
"""Below this correlation two subsets do not show the same [1]."""
_WANDER_PX = 1.5
"""How far, in pixels of the reduced images, the place found there may be off."""
_SOFTENING_PX = 1.0
_GREY_LEVELS = 64
"""Grey levels of a reduced image in one of the original: rounding must not matter."""


@dataclass(frozen=True, eq=False)
class ViewPair:
    """Two views of a scene.

    Parameters
    ----------
    images
        First frames of the views ``matches.first`` and ``matches.second``, shape (H, W) each.
    rig
        Approximate cameras of all views; the scale does not matter.
    matches
        Feature matches between the two views [px]; may be empty.
    """

    images: tuple[LumaArray, LumaArray]
    rig: Rig
    matches: Matches

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Cameras of the two views."""
        return self.rig.cameras[self.matches.first], self.rig.cameras[self.matches.second]


@dataclass(frozen=True, eq=False)
class Level:
    """Two views reduced by a whole number.

    Parameters
    ----------
    factor
        Pixels of the original, along an axis, in one of the reduced images.
    pair
        The reduced images, with cameras and matches to go with them.
    original
        The views at full size.
    """

    factor: int
    pair: ViewPair
    original: ViewPair

    def reduced(self, points2d: FloatArray) -> FloatArray:
        """Pixels of the original as pixels of the reduced images, shape (..., 2) [px]."""
        return (points2d + 0.5) / self.factor - 0.5

    def full(self, points2d: FloatArray) -> FloatArray:
        """Pixels of the reduced images as pixels of the original, shape (..., 2) [px]."""
        return (points2d + 0.5) * self.factor - 0.5

    def carry_on(self, point: FloatArray, found: Registration, size: int) -> tuple[Registration, bool]:
        """A registration of the reduced images in pixels of the original, and whether the original agrees with it.

        Parameters
        ----------
        point
            Place in the first view at full size, shape (2,) [px].
        found
            The registration of one point in the reduced images.
        size
            Side of the subset there [px].
        """
        if self.factor == 1:
            return found, True
        start = self.full(found.position)
        odd = size * self.factor // 2 * 2 + 1
        fine = register_subset(*self.original.images, point[None], Starts(start, found.affine), subset_px=odd)
        near = np.linalg.norm(fine.position[0] - start[0]) <= _WANDER_PX * self.factor
        if bool(fine.converged[0]) and fine.correlation[0] >= MIN_CORRELATION and near:
            return fine, True
        return replace(found, position=start, covariance=self.factor**2 * found.covariance), False


def reduce_pair(pair: ViewPair, factor: int) -> Level:
    """Both views reduced by a whole number."""
    if factor == 1:
        return Level(1, pair, pair)
    first, second = (_reduce_image(image, factor) for image in pair.images)
    cameras = tuple(_reduce_camera(camera, factor) for camera in pair.rig.cameras)
    level = Level(factor, pair, pair)
    m = pair.matches
    moved = Matches(m.first, m.second, level.reduced(m.points_first), level.reduced(m.points_second))
    small = ViewPair((first, second), Rig(pair.rig.names, cameras, metric=pair.rig.metric), moved)
    return replace(level, pair=small)


def _reduce_image(image: LumaArray, factor: int) -> LumaArray:
    """Means over squares of pixels, blurred a little: what only a view in focus shows is gone from both."""
    height, width = (n // factor * factor for n in image.shape)
    blocks = image[:height, :width].astype(np.float32).reshape(height // factor, factor, width // factor, factor)
    soft = gaussian_filter(blocks.mean(axis=(1, 3)), _SOFTENING_PX)
    levels: LumaArray = np.rint(np.clip(_GREY_LEVELS * soft, 0, np.iinfo(np.uint16).max)).astype(np.uint16)
    return levels


def _reduce_camera(camera: Camera, factor: int) -> Camera:
    K = camera.K.copy()
    K[:2, :2] /= factor
    K[:2, 2] = (K[:2, 2] + 0.5) / factor - 0.5
    size = camera.image_size[0] // factor, camera.image_size[1] // factor
    return replace(camera, K=K, image_size=size)
