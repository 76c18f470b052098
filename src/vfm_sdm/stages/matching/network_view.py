"""Whole frames as VGGT sees them: resized to whole patches, in one array."""

from dataclasses import dataclass

import numpy as np
from PIL import Image

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.inputs.video import Region, RgbArray
from vfm_sdm.networks.interface import RgbFrames

__all__ = ["NetworkCanvas", "network_view"]

_LONG_SIDE_PX, _PATCH_PX = 518, 14
_WHITE = 255


@dataclass(frozen=True)
class NetworkCanvas:
    """Where an image lies in the array that a network sees.

    Parameters
    ----------
    region
        The whole image, resized to 518 px along the longer side and to whole patches along both.
    left, top
        Columns and rows of the array before it [px].
    """

    region: Region
    left: int = 0
    top: int = 0

    @classmethod
    def of(cls, image: RgbArray) -> "NetworkCanvas":
        """The canvas of an image, at the corner of an array of its own.

        Parameters
        ----------
        image
            The image, shape (height, width, 3); only its size in px is used.

        Examples
        --------
        >>> NetworkCanvas.of(np.zeros((480, 640, 3), np.uint8)).region.canvas_size
        (518, 392)
        """
        height, width = image.shape[:2]
        sides = [
            max(1, round(side * _LONG_SIDE_PX / max(width, height) / _PATCH_PX)) * _PATCH_PX for side in (width, height)
        ]
        return cls(Region(0, 0, width, height, scale_u=sides[0] / width, scale_v=sides[1] / height))

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the image in the array."""
        width, height = self.region.canvas_size
        return slice(self.top, self.top + height), slice(self.left, self.left + width)

    def from_full(self, points2d: FloatArray) -> FloatArray:
        """Pixels of the array for pixels of the image.

        Parameters
        ----------
        points2d
            Pixels of the image, shape (..., 2) [px].

        Returns
        -------
        points2d
            Pixels of the array, shape (..., 2) [px].
        """
        return self.region.from_full(points2d) + self._corner

    def to_full(self, points2d: FloatArray) -> FloatArray:
        """Pixels of the image for pixels of the array.

        Parameters
        ----------
        points2d
            Pixels of the array, shape (..., 2) [px].

        Returns
        -------
        points2d
            Pixels of the image, shape (..., 2) [px].

        Examples
        --------
        >>> canvas = NetworkCanvas.of(np.zeros((518, 518, 3), np.uint8))
        >>> canvas.to_full(canvas.from_full(np.array([10.0, 20.0]))).tolist()
        [10.0, 20.0]
        """
        return self.region.to_full(points2d - self._corner)

    @property
    def _corner(self) -> FloatArray:
        return np.array([self.left, self.top], dtype=np.float64)


def network_view(images: list[RgbArray]) -> tuple[RgbFrames, list[NetworkCanvas]]:
    """Images of any sizes in one array, and where each one lies in it.

    Parameters
    ----------
    images
        Red, green and blue, shape (height, width, 3) each, any height and width [px].

    Returns
    -------
    view, canvases
        Array of the S images, shape (S, H, W, 3), and the canvas of each.

    Notes
    -----
    Each image is resized along each axis by itself, by bicubic interpolation as in the published loader; where canvases
    differ, white is put around the smaller ones, which leaves their centres at the centre.

    Examples
    --------
    >>> view, canvases = network_view([np.zeros((480, 640, 3), np.uint8), np.zeros((640, 480, 3), np.uint8)])
    >>> view.shape, canvases[0].top
    ((2, 518, 518, 3), 63)
    """
    alone = [NetworkCanvas.of(image) for image in images]
    width, height = (max(one.region.canvas_size[axis] for one in alone) for axis in (0, 1))
    view = np.full((len(images), height, width, 3), _WHITE, dtype=np.uint8)
    placed = []
    for picture, image, one in zip(view, images, alone, strict=True):
        size = one.region.canvas_size
        canvas = NetworkCanvas(one.region, (width - size[0]) // 2, (height - size[1]) // 2)
        picture[canvas.window] = np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BICUBIC))
        placed.append(canvas)
    return view, placed
