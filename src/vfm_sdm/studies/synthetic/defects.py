"""Effects of optics, light and a phone's processing on frames, each as a function of one frame of luma.

Frames are float32, shape (H, W), in luma units of 8-bit video, not rounded; black is 16 and white 235. Every function
returns a new frame. Lengths in pixels are of the frame at hand, so they scale with its width.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.errors import DatasetError

__all__ = [
    "BLACK",
    "WHITE",
    "Frame",
    "Glare",
    "Stabilization",
    "add_glare",
    "compute_exposure_times",
    "compute_row_delays",
    "compute_stabilization_path",
    "compute_wandering",
    "defocus",
    "lower_light",
    "sharpen",
    "warp",
]

Frame = npt.NDArray[np.float32]

BLACK, WHITE = 16.0, 235.0
"""Luma of black and white in 8-bit video."""
_KERNEL_STDS = 4
_WAVES = 8
_WANDER_HZ = (0.05, 0.4)
_DRIFT_HZ = (0.2, 3.0)


@dataclass(frozen=True)
class Glare:
    """Stray light in a lens that looks towards the sun.

    Parameters
    ----------
    strength
        How far luma is lifted towards white where the veil is thickest, from 0 to 1.
    center
        Middle of the veil as shares of width and height.
    radius
        Standard deviation of its Gaussian profile as a share of the width.
    floor
        Share of the strength that covers the whole frame.
    wander
        Standard deviation of the slow movement of its middle as a share of the width.
    seed
        Seed of that movement.

    Raises
    ------
    DatasetError
        A share is outside 0 to 1, or the radius is not positive.
    """

    strength: float
    center: tuple[float, float] = (0.3, 0.2)
    radius: float = 0.35
    floor: float = 0.25
    wander: float = 0.02
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0 <= self.strength <= 1 and 0 <= self.floor <= 1 and self.radius > 0 and self.wander >= 0):
            raise DatasetError(
                "glare: expected strength and floor in [0, 1], radius > 0 and wander >= 0, got "
                f"{self.strength}, {self.floor}, {self.radius} and {self.wander}; correct them"
            )


@dataclass(frozen=True)
class Stabilization:
    """A phone's electronic stabilisation, which moves the frame although the phone stands still.

    Parameters
    ----------
    follow
        Share of the scene's dominant motion that it takes for shake and takes out, from 0 to 1.
    drift_px
        Standard deviation of its own wandering along each direction [px].
    roll_std_deg
        Standard deviation of the rotation about the frame's centre [deg].
    seed
        Seed of both.

    Raises
    ------
    DatasetError
        The share is outside 0 to 1, or a standard deviation is negative.
    """

    follow: float = 0.5
    drift_px: float = 1.0
    roll_std_deg: float = 0.005
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0 <= self.follow <= 1 and self.drift_px >= 0 and self.roll_std_deg >= 0):
            raise DatasetError(
                "stabilization: expected follow in [0, 1] and standard deviations >= 0, got "
                f"{self.follow}, {self.drift_px} and {self.roll_std_deg}; correct them"
            )


def defocus(luma: Frame, sigma_px: float) -> Frame:
    """The frame through a Gaussian point spread.

    Parameters
    ----------
    luma
        The frame, shape (H, W), in luma units of 8-bit video.
    sigma_px
        Standard deviation of the point spread [px]; 0 leaves the frame as it is.

    Raises
    ------
    DatasetError
        The standard deviation is negative.

    Examples
    --------
    >>> luma = np.zeros((9, 9), np.float32)
    >>> luma[4, 4] = 100.0
    >>> round(float(defocus(luma, 1.0)[4, 4]), 1)
    15.9
    """
    _check_not_negative("sigma_px", sigma_px)
    if sigma_px == 0:
        return luma.copy()
    # The window cuts the kernel where it is below 4e-4 of its height.
    side = 2 * int(np.ceil(_KERNEL_STDS * sigma_px)) + 1
    blurred: Frame = np.asarray(cv2.GaussianBlur(luma, (side, side), sigma_px, borderType=cv2.BORDER_REFLECT_101))
    return blurred


def add_glare(luma: Frame, glare: Glare, *, time_s: float) -> Frame:
    """The frame behind a veil of light: ``luma + a (white - luma)``, with a smooth over the frame and 1 at most.

    Parameters
    ----------
    luma
        The frame, shape (H, W), in luma units of 8-bit video.
    glare
        Settings of ``a = strength (floor + (1 - floor) exp(-r^2 / 2 radius^2))``.
    time_s
        Time of the frame [s]; the veil's middle wanders slowly.

    Examples
    --------
    >>> dark = np.full((48, 64), 16.0, np.float32)
    >>> bool(add_glare(dark, Glare(0.5), time_s=0.0).max() <= 16 + 0.5 * (235 - 16))
    True
    """
    height, width = luma.shape
    offset = glare.wander * compute_wandering([time_s], _WANDER_HZ, seed=glare.seed)[0]
    u = (np.arange(width) + 0.5) / width - glare.center[0] - offset[0]
    v = (np.arange(height) + 0.5) / width - glare.center[1] * height / width - offset[1]
    profiles = [np.exp(-0.5 * (x / glare.radius) ** 2).astype(np.float32) for x in (v, u)]
    veil = np.outer(np.float32(glare.strength * (1 - glare.floor)) * profiles[0], profiles[1])
    veil += np.float32(glare.strength * glare.floor)
    lifted = np.float32(WHITE) - luma
    lifted *= veil
    lifted += luma
    return lifted


def lower_light(luma: Frame, gain: float) -> Frame:
    """The frame with less light; noise that is added afterwards weighs more.

    Parameters
    ----------
    luma
        The frame, shape (H, W), in luma units of 8-bit video.
    gain
        Share of the light that is left [1].

    Raises
    ------
    DatasetError
        The gain is not in (0, 1].

    Examples
    --------
    >>> float(lower_light(np.full((2, 2), 116.0, np.float32), 0.5)[0, 0])
    66.0
    """
    if not 0 < gain <= 1:
        raise DatasetError(
            f"gain: expected more than 0 and at most 1, got {gain}; give the share of light that is left"
        )
    return luma * np.float32(gain) + np.float32(BLACK * (1 - gain))


def sharpen(luma: Frame, amount: float, *, sigma_px: float = 1.0) -> Frame:
    """Unsharp mask, as phones apply it: ``luma + amount (luma - blurred)``.

    Parameters
    ----------
    luma
        The frame, shape (H, W), in luma units of 8-bit video.
    amount
        Strength of the mask [1]; 0 leaves the frame as it is.
    sigma_px
        Standard deviation of the Gaussian blur [px].

    Raises
    ------
    DatasetError
        The amount or the standard deviation is negative.

    Examples
    --------
    >>> luma = np.repeat([[50.0, 50.0, 50.0, 100.0, 100.0, 100.0]], 6, axis=0).astype(np.float32)
    >>> sharpen(luma, 0.8)[3].round().tolist()
    [50.0, 48.0, 38.0, 112.0, 102.0, 100.0]
    """
    _check_not_negative("amount", amount)
    sharp: Frame = np.asarray(cv2.addWeighted(luma, 1 + amount, defocus(luma, sigma_px), -amount, 0))
    return sharp


def compute_stabilization_path(
    time_s: npt.ArrayLike,
    scene_motion_px: npt.ArrayLike,
    stabilization: Stabilization,
    *,
    image_size: tuple[int, int],
) -> FloatArray:
    """Movement of each frame, as affine maps from its pixels to those of the written frame.

    Parameters
    ----------
    time_s
        Times of the frames, shape (T,) [s].
    scene_motion_px
        Image displacement of what dominates the picture, shape (T, 2) [px].
    stabilization
        Settings of the path: ``-follow`` times that motion, plus a smooth wandering and roll.
    image_size
        Width and height [px]; the roll is about the centre.

    Returns
    -------
    path
        Affine maps, shape (T, 2, 3) [1 and px].

    Raises
    ------
    DatasetError
        A shape is wrong.

    Examples
    --------
    >>> still = Stabilization(follow=0.5, drift_px=0.0, roll_std_deg=0.0)
    >>> path = compute_stabilization_path([0.0, 0.1], [[0.0, 0.0], [2.0, -1.0]], still, image_size=(64, 48))
    >>> path[1].tolist()
    [[1.0, -0.0, -1.0], [0.0, 1.0, 0.5]]
    """
    time = as_float_array(time_s, "time_s", (None,))
    motion = as_float_array(scene_motion_px, "scene_motion_px", (len(time), 2))
    roll = compute_wandering(time, _DRIFT_HZ, seed=stabilization.seed)[:, 0] * np.deg2rad(stabilization.roll_std_deg)
    drift = stabilization.drift_px * compute_wandering(time, _DRIFT_HZ, seed=stabilization.seed + 1)
    center = (np.asarray(image_size) - 1) / 2
    path = np.empty((len(time), 2, 3))
    path[:, 0, 0] = path[:, 1, 1] = np.cos(roll)
    path[:, 0, 1], path[:, 1, 0] = -np.sin(roll), np.sin(roll)
    path[:, :, 2] = center - path[:, :, :2] @ center + drift - stabilization.follow * motion
    return path


def warp(luma: Frame, affine: npt.ArrayLike) -> Frame:
    """The frame moved by an affine map of its pixels to the new ones, by cubic interpolation.

    Parameters
    ----------
    luma
        The frame, shape (H, W), in luma units of 8-bit video.
    affine
        Map of pixels, shape (2, 3) [1 and px].

    Raises
    ------
    DatasetError
        The map has another shape.

    Notes
    -----
    Places are rounded to 1/32 px, as OpenCV does.

    Examples
    --------
    >>> luma = np.zeros((5, 5), np.float32)
    >>> luma[2, 2] = 100.0
    >>> float(warp(luma, [[1, 0, 1], [0, 1, 0]])[2, 3])
    100.0
    """
    matrix = as_float_array(affine, "affine", (2, 3))
    size = luma.shape[::-1]
    moved: Frame = np.asarray(
        cv2.warpAffine(luma, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    )
    return moved


def compute_exposure_times(time_s: float, exposure_s: float, samples: int) -> FloatArray:
    """Instants whose frames have the exposed one as their mean, shape (samples,) [s].

    Parameters
    ----------
    time_s
        Middle of the exposure [s].
    exposure_s
        Duration of the exposure [s].
    samples
        Number of instants: the middles of equal parts of the exposure.

    Raises
    ------
    DatasetError
        The exposure is negative, or there is no sample.

    Examples
    --------
    >>> compute_exposure_times(1.0, 0.02, 2).round(6).tolist()
    [0.995, 1.005]
    """
    if not (exposure_s >= 0 and samples >= 1):
        raise DatasetError(
            f"exposure: expected >= 0 s and at least one sample, got {exposure_s} s and {samples}; correct them"
        )
    return time_s + exposure_s * ((np.arange(samples) + 0.5) / samples - 0.5)


def compute_row_delays(height: int, read_out_s: float) -> FloatArray:
    """Times at which a rolling shutter reads each row, relative to the middle of the frame, shape (height,) [s].

    Parameters
    ----------
    height
        Number of rows [px].
    read_out_s
        Duration of the read-out of all rows [s].

    Raises
    ------
    DatasetError
        There is no row, or the read-out time is negative.

    Examples
    --------
    >>> compute_row_delays(4, 0.01).round(6).tolist()
    [-0.00375, -0.00125, 0.00125, 0.00375]
    """
    if not (height >= 1 and read_out_s >= 0):
        raise DatasetError(f"rows: expected at least one and >= 0 s, got {height} and {read_out_s} s; correct them")
    return read_out_s * ((np.arange(height) + 0.5) / height - 0.5)


def compute_wandering(
    time_s: npt.ArrayLike, band_hz: tuple[float, float], *, seed: int | tuple[int, ...]
) -> FloatArray:
    """Two smooth random functions of time with standard deviation 1, shape (T, 2).

    A sum of sines of random frequency and phase, so that any time can be asked for by itself.
    """
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(*band_hz, (_WAVES, 2))
    phase = rng.uniform(0, 2 * np.pi, (_WAVES, 2))
    angle = 2 * np.pi * np.multiply.outer(np.asarray(time_s, np.float64), frequency) + phase
    return np.asarray(np.sin(angle).sum(axis=1) * np.sqrt(2 / _WAVES))


def _check_not_negative(name: str, value: float) -> None:
    if not value >= 0:
        raise DatasetError(f"{name}: expected >= 0, got {value}; correct it")
