"""Patches around points, at full resolution, which networks see instead of whole frames.

The paper crops 294 x 294 px approximately centred on the point (section Implementation details).
"""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.video import Region

__all__ = ["Patch", "plan_patches"]

_STEP = 3
"""Patches start at multiples of their side over this number, so that points close to each other share one."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A region of the frames and the points that are followed in it.

    Parameters
    ----------
    region
        The part of the frames, in full-image pixels, not resized.
    rows
        Indices of the points that are followed in it, shape (N,).
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
        Positions of the points, inside the image, shape (P, 2) [px].
    image_size
        Width and height [px].
    side_px
        Side of a patch; less in an image that is smaller [px].
    multiple
        Sides are multiples of this length [px].
    least_px
        Shortest side that will do [px].

    Raises
    ------
    DatasetError
        The image is smaller than the shortest side.

    Examples
    --------
    >>> points2d = np.array([[100.0, 90.0], [110.0, 95.0], [500.0, 300.0]])
    >>> patches = plan_patches(points2d, (640, 480), side_px=126, multiple=14, least_px=98)
    >>> [(patch.region.x, patch.region.y, patch.rows.tolist()) for patch in patches]
    [(42, 42, [0, 1]), (420, 252, [2])]
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
