"""Two images at full size or reduced, with the cameras and the matches that go with them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["ImagePair"]

_SOFTENING_PX = 1.0
_GREY_LEVELS = 64
"""Grey levels of a reduced image in one of the original: rounding must not matter."""


@dataclass(frozen=True, eq=False)
class ImagePair:
    """First frames of two views, as they are or reduced by a whole number.

    Parameters
    ----------
    images
        Frames of the views ``matches.first`` and ``matches.second``, shape (H, W) each, uint8 or uint16.
    rig
        Approximate cameras for images of this size; the scale of the rig does not matter.
    matches
        Feature matches between the two views, in pixels of these images; may be empty.
    factor
        Pixels of the full images along the side of one of these [1].
    """

    images: tuple[LumaArray, LumaArray]
    rig: Rig
    matches: Matches
    factor: int = 1

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """The cameras of the two views."""
        return self.rig.cameras[self.matches.first], self.rig.cameras[self.matches.second]

    def reduce(self, factor: int) -> "ImagePair":
        """The pair reduced by a whole number; itself for 1.

        Parameters
        ----------
        factor
            Pixels of these images along the side of one of the reduced ones [1].
        """
        if factor == 1:
            return self
        cameras = tuple(_reduce_camera(camera, factor) for camera in self.rig.cameras)
        between = self.matches
        return ImagePair(
            (_reduce_image(self.images[0], factor), _reduce_image(self.images[1], factor)),
            Rig(self.rig.names, cameras, metric=self.rig.metric),
            Matches(
                between.first,
                between.second,
                (between.points_first + 0.5) / factor - 0.5,
                (between.points_second + 0.5) / factor - 0.5,
            ),
            self.factor * factor,
        )

    def from_full(self, points2d: FloatArray) -> FloatArray:
        """Pixels of these images for pixels of the full ones, shape (..., 2) both [px]."""
        return (points2d + 0.5) / self.factor - 0.5

    def to_full(self, points2d: FloatArray) -> FloatArray:
        """Pixels of the full images for pixels of these, shape (..., 2) both [px]."""
        return (points2d + 0.5) * self.factor - 0.5


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
