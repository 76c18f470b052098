"""Small pictures around points, at full resolution: networks see these instead of whole frames.

The paper crops 294 x 294 px approximately centred on the point (section Implementation details).
"""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.video import Region

__all__ = ["Patch", "plan_patches"]

_STEP = 3
"""Patches start at multiples of their side over this, so that points close to each other share one."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A region of the frames and the points that are followed in it.

    Parameters
    ----------
    region
        In full-image pixels, not resized.
    rows
        Indices of its points.
    """

    region: Region
    rows: IntArray


def plan_patches(
    points2d: FloatArray, image_size: tuple[int, int], *, side_px: int, multiple: int, least_px: int
) -> list[Patch]:
    """Patches for all points; which one a point gets does not depend on the others.

    Parameters
    ----------
    points2d
        Shape (P, 2) [px], inside the image.
    image_size
        Width and height [px].
    side_px
        Side of a patch; less in an image that is smaller [px].
    multiple
        Sides are multiples of it [px].
    least_px
        Shortest side that will do [px].

    Raises
    ------
    DatasetError
        The image is smaller than that.
    """
    sides = tuple(min(side_px, length) // multiple * multiple for length in image_size)
    if min(sides) < least_px:
        raise DatasetError(
            f"image: expected at least {-(-least_px // multiple) * multiple} px a side, got {image_size[0]} x "
            f"{image_size[1]}; a network cannot follow points in it, use another tracker"
        )
    found: dict[tuple[int, int], list[int]] = {}
    for row, point in enumerate(points2d):
        corner = []
        for value, side, length in zip(point, sides, image_size, strict=True):
            step = side // _STEP
            corner.append(int(min(max(round((value - side / 2) / step), 0) * step, length - side)))
        found.setdefault((corner[0], corner[1]), []).append(row)
    return [Patch(Region(x, y, sides[0], sides[1]), np.array(rows)) for (x, y), rows in found.items()]
