"""What comes between a camera and the structure: passers-by, vehicles, leaves of a branch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ndtr

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.defects import Frame, compute_wandering

__all__ = ["Blob", "Branch", "Passer", "cover"]

_ELLIPSE, _BOX = 2.0, 8.0
"""Exponents of outlines ``|x / a|^p + |y / b|^p = 1``."""
_STEP_HZ = 1.0
"""Swing of a walker's legs."""
_SWAY_HZ = (0.2, 1.5)
_EDGE_STDS = 4
_Part = tuple[float, float, float, float, float, float]
"""Middle ahead and above the ground, half lengths [m], exponent of the outline, luma."""
_VEHICLE: tuple[_Part, ...] = (
    (0.0, 0.62, 2.1, 0.36, _BOX, 75.0),
    (-0.2, 1.15, 1.25, 0.36, _BOX, 66.0),
    (-0.8, 1.17, 0.5, 0.24, _BOX, 40.0),
    (0.4, 1.17, 0.5, 0.24, _BOX, 44.0),
    (-1.3, 0.32, 0.32, 0.32, _ELLIPSE, 24.0),
    (1.3, 0.32, 0.32, 0.32, _ELLIPSE, 24.0),
)


@dataclass(frozen=True)
class Blob:
    """A patch of even luma: middle and half lengths along u and v [px], exponent of its outline, luma."""

    center_px: tuple[float, float]
    half_px: tuple[float, float]
    power: float
    luma: float


@dataclass(frozen=True)
class Passer:
    """Somebody who walks, or a car that drives, through a picture.

    Parameters
    ----------
    kind
        ``person`` or ``vehicle``.
    distance_m
        From the camera along its axis [m].
    speed_m_s
        Across the picture, to the right [m/s].
    middle_s
        True time in the middle of the picture [s].
    ground_m
        Of feet or wheels below the optical axis [m].

    Raises
    ------
    DatasetError
        The distance is not positive, or the speed is zero.
    """

    kind: Literal["person", "vehicle"]
    distance_m: float
    speed_m_s: float
    middle_s: float
    ground_m: float = 1.6

    def __post_init__(self) -> None:
        if self.kind not in ("person", "vehicle") or not (self.distance_m > 0 and self.speed_m_s != 0):
            raise DatasetError(
                f"passer: expected a person or vehicle, distance > 0 m and a speed, got {self}; correct it"
            )

    def blobs(self, time_s: float, focal_px: float, image_size: tuple[int, int]) -> list[Blob]:
        """Parts of the silhouette in a picture, the last in front.

        Parameters
        ----------
        time_s
            True time [s].
        focal_px
            Of the camera [px].
        image_size
            Width and height [px].

        Examples
        --------
        >>> walker = Passer("person", distance_m=10.0, speed_m_s=1.5, middle_s=2.0)
        >>> first, last = (walker.blobs(time, 1000.0, (640, 480))[0].center_px[0] for time in (2.0, 3.0))
        >>> float(round(last - first, 6))
        150.0
        """
        scale, elapsed = focal_px / self.distance_m, time_s - self.middle_s
        middle = 0.5 * (image_size[0] - 1) + scale * self.speed_m_s * elapsed
        ground = 0.5 * (image_size[1] - 1) + scale * self.ground_m
        parts = _VEHICLE if self.kind == "vehicle" else _person(np.sin(2 * np.pi * _STEP_HZ * elapsed))
        towards = np.sign(self.speed_m_s)
        return [
            Blob((middle + scale * towards * x, ground - scale * up), (scale * a, scale * b), power, luma)
            for x, up, a, b, power, luma in parts
        ]


@dataclass(frozen=True)
class Branch:
    """Leaves near a camera that sway in a part of the picture.

    Parameters
    ----------
    center
        Its middle as shares of width and height [1].
    radius
        Standard deviations of the leaves' places as shares of the width [1].
    leaves
        Their number.
    leaf
        Mean length of one as a share of the width [1].
    sway
        Standard deviation of their common movement as a share of the width [1].
    distance_m
        From the camera [m], which says how far out of focus they are.

    Raises
    ------
    DatasetError
        A size is not positive.
    """

    center: tuple[float, float]
    radius: tuple[float, float]
    leaves: int
    leaf: float = 0.02
    sway: float = 0.01
    distance_m: float = 6.0

    def __post_init__(self) -> None:
        if not (min(*self.radius, self.leaf, self.distance_m) > 0 and min(self.leaves, self.sway) >= 0):
            raise DatasetError(f"branch: expected sizes and a distance > 0, got {self}; correct them")

    def blobs(self, time_s: float, image_size: tuple[int, int], *, seed: tuple[int, ...]) -> list[Blob]:
        """The leaves in a picture at a true time [s].

        Examples
        --------
        >>> len(Branch((0.2, 0.3), (0.05, 0.05), leaves=30).blobs(0.0, (640, 360), seed=(1,)))
        30
        """
        rng, width = np.random.default_rng(seed), image_size[0]
        sway = self.sway * compute_wandering([time_s], _SWAY_HZ, seed=(*seed, 1))[0]
        places = rng.standard_normal((self.leaves, 2)) * self.radius + sway
        places = width * places + np.multiply(self.center, image_size)
        half = 0.5 * width * self.leaf * rng.uniform(0.6, 1.4, (self.leaves, 2))
        luma = rng.uniform(30.0, 75.0, self.leaves)
        return [
            Blob((float(u), float(v)), (float(a), float(b)), _ELLIPSE, float(grey))
            for (u, v), (a, b), grey in zip(places, half, luma, strict=True)
        ]


def _person(swing: float) -> tuple[_Part, ...]:
    """Head, trunk and two legs; the swing is from -1 to 1."""
    return (
        (0.22 * swing, 0.42, 0.09, 0.45, _BOX, 38.0),
        (-0.22 * swing, 0.42, 0.09, 0.45, _BOX, 44.0),
        (0.0, 1.13, 0.22, 0.36, 4.0, 62.0),
        (0.0, 1.62, 0.1, 0.13, _ELLIPSE, 85.0),
    )


def cover(luma: Frame, blobs: Sequence[Blob], sigma_px: float) -> tuple[Frame, Frame]:
    """The frame behind patches, and how much of each pixel they hide.

    Parameters
    ----------
    luma
        The frame, shape (H, W).
    blobs
        Patches, the last in front.
    sigma_px
        Standard deviation of the blur of their edges [px].

    Returns
    -------
    covered, share
        Shapes (H, W) [luma units] and [1].

    Examples
    --------
    >>> frame = np.full((40, 60), 200.0, np.float32)
    >>> covered, share = cover(frame, [Blob((30.0, 20.0), (10.0, 5.0), 2.0, 50.0)], 0.5)
    >>> float(covered[20, 30]), float(share[20, 30]), float(covered[0, 0])
    (50.0, 1.0, 200.0)
    """
    covered, hidden = luma.copy(), np.zeros_like(luma)
    sigma, (height, width) = max(sigma_px, 0.3), luma.shape
    for blob in blobs:
        margin, (u, v), (a, b) = _EDGE_STDS * sigma, blob.center_px, blob.half_px
        left, right = (int(np.clip(at, 0, width)) for at in (u - a - margin, u + a + margin + 1))
        top, bottom = (int(np.clip(at, 0, height)) for at in (v - b - margin, v + b + margin + 1))
        if left >= right or top >= bottom:
            continue
        x, y = np.abs(np.arange(left, right) - u) / a, np.abs(np.arange(top, bottom)[:, None] - v) / b
        outline = (x**blob.power + y**blob.power) ** (1 / blob.power)
        share = ndtr((1 - outline) * min(a, b) / sigma).astype(np.float32)
        part = np.s_[top:bottom, left:right]
        covered[part] += share * (np.float32(blob.luma) - covered[part])
        hidden[part] += share * (1 - hidden[part])
    return covered, hidden
