"""Images as the networks that match features take them: reduced to the size on which they were trained."""

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.inputs.video import Region
from vfm_sdm.stages.matching.detection import to_eight_bit

__all__ = ["LONG_SIDE_PX", "reduce_image"]

LONG_SIDE_PX = 1024
"""Images with a longer side are reduced to it: the networks were trained on images of about this size."""


def reduce_image(luma: LumaArray) -> tuple[LumaArray, Region]:
    """A whole image, reduced so that its longer side fits the networks.

    Parameters
    ----------
    luma
        Luma, shape (H, W), 8 or 16 bits.

    Returns
    -------
    reduced
        8 bits, shape (h, w) with a longer side of at most `LONG_SIDE_PX`; no image is enlarged.
    region
        Its place in the whole image, for the pixels of what is found in it.

    Examples
    --------
    >>> import numpy as np
    >>> reduced, region = reduce_image(np.zeros((1080, 2048), np.uint8))
    >>> reduced.shape, region.to_full(np.array([[511.5, 269.5]])).tolist()
    ((540, 1024), [[1023.5, 539.5]])
    """
    height, width = luma.shape
    scale = min(1.0, LONG_SIDE_PX / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    region = Region(0, 0, width, height, scale_u=size[0] / width, scale_v=size[1] / height)
    return region.crop(to_eight_bit(luma)), region
