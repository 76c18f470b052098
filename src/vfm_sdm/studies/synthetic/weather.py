"""Haze and rain between camera and structure.

Frames are float32, shape (H, W), linear in light, black is 16 and white 235.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.defects import BLACK, WHITE, Frame

__all__ = ["Haze", "Rain", "add_rain", "count_streaks"]

_KOSCHMIEDER = 3.912
"""Optical depth of the visibility: where the contrast has fallen to 2 %."""
_STREAK_SIGMA_PX = 0.8
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Haze:
    """Air that takes contrast with the distance.

    Parameters
    ----------
    visibility_m
        Distance at which contrast has fallen to 2 % [m].
    airlight
        Luma of the horizon, linear in light.

    Raises
    ------
    DatasetError
        The visibility is not positive, or the airlight is no luma.

    References
    ----------
    .. [1] Middleton, W. E. K. (1952). Vision through the atmosphere. University of Toronto Press, chapter 6
       (Koschmieder's law).

    Examples
    --------
    >>> haze = Haze(visibility_m=100.0)
    >>> haze.transmission(np.array([0.0, 100.0])).round(2).tolist()
    [1.0, 0.02]
    """

    visibility_m: float
    airlight: float = 150.0

    def __post_init__(self) -> None:
        if not (self.visibility_m > 0 and BLACK <= self.airlight <= WHITE):
            raise DatasetError(f"haze: expected a visibility > 0 m and luma of 16 to 235, got {self}; correct them")

    def transmission(self, distance_m: FloatArray) -> FloatArray:
        """Share of the light that arrives, shape (...) [1], from distances, shape (...) [m], also infinite."""
        return np.asarray(np.exp(-_KOSCHMIEDER * distance_m / self.visibility_m))


@dataclass(frozen=True)
class Rain:
    """Drops that draw streaks, other ones in each frame.

    Parameters
    ----------
    streaks
        Mean number in a frame.
    length
        Mean length as a share of the picture's height [1].
    slant_deg
        From the vertical, towards the right below [deg].
    strength
        How far luma is lifted towards white in the middle of a streak [1].

    Raises
    ------
    DatasetError
        A number is out of its range.

    Notes
    -----
    A drop of 2 mm falls at 6 m/s, 24 mm while a frame is exposed for 4 ms: 10 m before a lens of ten degrees that is
    0.03 of the picture's height. Drops are clear and the streaks of most are out of focus, hence faint.
    """

    streaks: float
    length: float = 0.03
    slant_deg: float = 8.0
    strength: float = 0.12

    def __post_init__(self) -> None:
        if not (self.streaks >= 0 and self.length > 0 and 0 <= self.strength <= 1):
            raise DatasetError(
                f"rain: expected streaks >= 0, a length > 0 and a strength in [0, 1], got {self}; correct"
            )


def count_streaks(rain: Rain, seed: tuple[int, ...]) -> int:
    """Number of streaks in the frame of a seed."""
    return int(np.random.default_rng(seed).poisson(rain.streaks))


def add_rain(luma: Frame, rain: Rain, *, seed: tuple[int, ...]) -> Frame:
    """The frame behind the streaks of an instant.

    Parameters
    ----------
    luma
        The frame, shape (H, W).
    rain
        Settings.
    seed
        Of the frame.

    Examples
    --------
    >>> dark = np.full((90, 160), 60.0, np.float32)
    >>> bool((add_rain(dark, Rain(40.0), seed=(1, 2)) >= 60).all())
    True
    """
    rng = np.random.default_rng(seed)
    count, (height, width) = int(rng.poisson(rain.streaks)), luma.shape
    start = rng.uniform((0, -rain.length * height), (width, height), (count, 2))
    length = rain.length * height * rng.uniform(0.5, 1.5, (count, 1))
    angle = np.deg2rad(rain.slant_deg)
    ends = start + length * np.array([np.sin(angle), np.cos(angle)])
    drawn = np.zeros((height, width), np.uint8)
    for first, last in zip(start, ends, strict=True):
        a, b = (tuple(np.rint(p * 2**_SUBPIXEL_BITS).astype(int).tolist()) for p in (first, last))
        cv2.line(drawn, a, b, 255, 1, cv2.LINE_AA, _SUBPIXEL_BITS)
    share = cv2.GaussianBlur(drawn.astype(np.float32), (7, 7), _STREAK_SIGMA_PX) * np.float32(rain.strength / 255)
    wet: Frame = np.asarray(luma + share * (np.float32(WHITE) - luma), np.float32)
    return wet
