"""Where a subset may be: peaks of the normalised cross-correlation around a place, and whether one stands out."""

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.stages.registration.designs import SubsetDesign

__all__ = ["AMBIGUITY_MARGIN", "DISTINCT_PX", "correlation_peaks", "cut_subset", "has_rival"]

AMBIGUITY_MARGIN = 0.05
"""Two places are equally good when their correlations differ by less."""
DISTINCT_PX = 2.0
"""Registrations that end closer to each other found the same place [px]."""
_SEPARATION_PX = 2  # two peaks are told apart when neither lies within this of the other
_BESIDE_PX = 0.75  # pixels within this of a line leave no gap in it
_NOWHERE = -2.0  # below every correlation
_SOUND = 1.001  # correlations reach 1 and a little more by rounding
_RANGE = 0.4
"""Peaks lower than the best by more are left out. Between the pixels a fine texture may correlate that much better."""


def cut_subset(image: LumaArray, center: IntArray, half: int) -> LumaArray:
    """The square of an image around a pixel, as a copy.

    Parameters
    ----------
    image
        Shape (H, W).
    center
        Middle pixel (u, v), shape (2,) [px].
    half
        Half the side of the square, without its middle [px].

    Returns
    -------
    subset
        Shape (2 half + 1, 2 half + 1).

    Examples
    --------
    >>> cut_subset(np.arange(25, dtype=np.uint8).reshape(5, 5), np.array([2, 1]), 1).tolist()
    [[1, 2, 3], [6, 7, 8], [11, 12, 13]]
    """
    u, v = int(center[0]), int(center[1])
    return image[v - half : v + half + 1, u - half : u + half + 1].copy()


def correlation_peaks(
    subset: LumaArray,
    image: LumaArray,
    place: FloatArray,
    *,
    radius_px: int,
    count: int,
    design: SubsetDesign | None = None,
) -> FloatArray:
    """The highest peaks of the zero-normalised cross-correlation of a subset with an image around a place.

    Parameters
    ----------
    subset
        Shape (S, S), S odd.
    image
        Shape (H, W).
    place
        Centre of the search (u, v), shape (2,) [px].
    radius_px
        Search radius along each axis [px].
    count
        Largest number of peaks.
    design
        Which pixels of the subset are believed, and the direction across an edge: the search is then along that line
        through the place.

    Returns
    -------
    centers
        Pixels where the subset's centre would lie, shape (K, 2) [px], best first; empty where the search area does not
        hold the subset.

    References
    ----------
    .. [1] Lewis, J. P. (1995). Fast normalized cross-correlation. Vision Interface.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8)
    >>> subset = cut_subset(image, np.array([40, 30]), 5)
    >>> correlation_peaks(subset, image, np.array([37.0, 32.0]), radius_px=8, count=1).tolist()
    [[40.0, 30.0]]
    """
    size = subset.shape[0]
    half = size // 2
    height, width = image.shape
    u, v = int(np.floor(place[0] + 0.5)), int(np.floor(place[1] + 0.5))
    left, top = max(u - radius_px - half, 0), max(v - radius_px - half, 0)
    area = image[top : min(v + radius_px + half + 1, height), left : min(u + radius_px + half + 1, width)]
    if min(area.shape) < size:
        return np.empty((0, 2))
    kind = np.uint8 if image.dtype == np.uint8 else np.float32  # matchTemplate knows no others
    mask = None if design is None or design.mask is None else design.mask.astype(np.uint8)
    response = cv2.matchTemplate(
        np.ascontiguousarray(area, dtype=kind),
        np.ascontiguousarray(subset, dtype=kind),
        cv2.TM_CCOEFF_NORMED,
        mask=mask,
    )
    if mask is not None:
        response[~(np.abs(response) <= _SOUND)] = _NOWHERE  # what has no contrast under the mask
    if design is not None and design.across is not None:
        v_steps, u_steps = np.indices(response.shape)
        across_u, across_v = design.direction()
        beside = (u_steps + left + half - place[0]) * across_v - (v_steps + top + half - place[1]) * across_u
        response[np.abs(beside) > _BESIDE_PX] = _NOWHERE
    window = np.ones((2 * _SEPARATION_PX + 1, 2 * _SEPARATION_PX + 1), np.uint8)
    rows, columns = np.nonzero(response >= cv2.dilate(response, window))
    height_of = response[rows, columns]
    best = np.argsort(-height_of, kind="stable")[:count]
    best = best[height_of[best] > _NOWHERE]
    best = best[height_of[best] >= height_of.max(initial=-1) - _RANGE]
    return np.column_stack([columns[best] + left + half, rows[best] + top + half]).astype(np.float64)


def has_rival(correlation: FloatArray, places: FloatArray, winner: int, *, distinct_px: float = DISTINCT_PX) -> bool:
    """Whether another position resembles the subset as well as the best one does, so that the choice is ambiguous.

    Parameters
    ----------
    correlation
        Correlation of the subset with each position that was tried, shape (K,) [1]; below -1 where the registration
        failed.
    places
        Positions that were tried, shape (K, 2) [px].
    winner
        Index of the position that would be chosen.
    distinct_px
        Distance within which positions count as the same one [px].

    Returns
    -------
    ambiguous
        Whether a distinct position has a correlation within `AMBIGUITY_MARGIN` of the best one's.

    Examples
    --------
    >>> places = np.array([[10.0, 10.0], [10.5, 10.0], [40.0, 10.0]])
    >>> has_rival(np.array([0.98, 0.97, 0.7]), places, 0), has_rival(np.array([0.98, 0.7, 0.975]), places, 0)
    (False, True)
    """
    apart = np.linalg.norm(places - places[winner], axis=1) > distinct_px
    return bool(np.any(correlation[apart] >= correlation[winner] - AMBIGUITY_MARGIN))
