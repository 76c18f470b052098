"""Interfaces of the matchers, which find the same places in two views; `vfm_sdm.core.parts` lists both kinds."""

from collections.abc import Sequence
from typing import Protocol

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.inputs.video import RgbArray
from vfm_sdm.stages.matching.features import FeatureMatches

__all__ = ["FeatureMatcher", "PointMatcher"]


class PointMatcher(Protocol):
    """Tells roughly where a named point lies in another view (``method.correspondence``)."""

    def locate(self, first: RgbArray, second: RgbArray, points2d: FloatArray) -> FloatArray:
        """Where points of one view lie in another, shape (P, 2) [px]; NaN where they are not seen.

        Parameters
        ----------
        first, second
            First frames of the two views in colour, shape (height, width, 3).
        points2d
            Points in the first view, shape (P, 2) [px], full-image pixels.

        Notes
        -----
        The places are registered afterwards to a fraction of a pixel, along the epipolar line.
        """
        ...


class FeatureMatcher(Protocol):
    """Matches distinctive features of images (``method.matching``)."""

    def match(self, images: Sequence[LumaArray]) -> dict[tuple[int, int], FeatureMatches]:
        """Features that look alike, by pair of images, before any geometric check.

        Parameters
        ----------
        images
            Luma, shape (H, W) each; sizes may differ.

        Returns
        -------
        matches
            Pixels in both images and quality, by pair ``i < j``.
        """
        ...
