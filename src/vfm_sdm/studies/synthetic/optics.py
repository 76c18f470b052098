"""What moves places in a picture beyond a lens's distortion: lateral colour, and wind that turns the camera.

Frames are float32, shape (H, W), linear in light, black is 16, as in `vfm_sdm.studies.synthetic.defects`.
"""

from dataclasses import dataclass, replace

import numba as nb
import numpy as np
import numpy.typing as npt
from scipy.ndimage import spline_filter

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.defects import Frame, compute_wandering, warp

__all__ = ["LateralColour", "Shake", "compute_turn_fields", "resample", "spread_colours"]

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of red, green and blue in luma (Recommendation ITU-R BT.709-6, item 3.2)."""
_SMALL_RAD = 1e-4


@dataclass(frozen=True)
class LateralColour:
    """Lateral chromatic aberration: red and blue are imaged at other sizes than green.

    Parameters
    ----------
    red, blue
        Their magnification about the principal point relative to that of green, minus 1 [1].

    Raises
    ------
    DatasetError
        A magnification differs by more than a hundredth.
    """

    red: float
    blue: float

    def __post_init__(self) -> None:
        if not max(abs(self.red), abs(self.blue)) <= 0.01:
            raise DatasetError(f"lateral colour: expected at most 0.01, got {self.red} and {self.blue}; correct them")


@dataclass(frozen=True)
class Shake:
    """Wind that turns a camera on its tripod.

    Parameters
    ----------
    std_urad
        Standard deviations of the rotation about the camera's axes: pitch, yaw, roll [urad].
    band_hz
        Lowest and highest frequency of gusts and tripod [Hz].

    Raises
    ------
    DatasetError
        A standard deviation is negative, or the band is none.
    """

    std_urad: tuple[float, float, float]
    band_hz: tuple[float, float] = (0.2, 5.0)

    def __post_init__(self) -> None:
        if not (min(self.std_urad) >= 0 and 0 < self.band_hz[0] < self.band_hz[1]):
            raise DatasetError(f"shake: expected rotations >= 0 and a band of frequencies > 0, got {self}; correct it")

    def turns(self, time_s: npt.ArrayLike, *, seed: tuple[int, ...]) -> FloatArray:
        """Rotation vectors of the camera in its own axes, shape (T, 3) [rad].

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].
        seed
            Seed of the movement.

        Examples
        --------
        >>> turns = Shake((40.0, 0.0, 0.0)).turns(np.arange(2000) / 30, seed=(1,))
        >>> bool(30e-6 < turns[:, 0].std() < 50e-6), float(abs(turns[:, 1:]).max())
        (True, 0.0)
        """
        both = [compute_wandering(time_s, self.band_hz, seed=(*seed, pair)) for pair in range(2)]
        return np.asarray(1e-6 * np.asarray(self.std_urad) * np.column_stack(both)[:, :3])


def spread_colours(luma: Frame, colour: LateralColour, principal_px: tuple[float, float]) -> Frame:
    """The frame as the luma of three colours of one size each.

    Parameters
    ----------
    luma
        The frame, shape (H, W), linear in light; grey, so that it is that of each colour.
    colour
        Sizes of red and blue.
    principal_px
        Place that stays [px].

    Notes
    -----
    Places are rounded to 1/32 px, the same ones in every frame.

    Examples
    --------
    >>> edge = np.where(np.arange(400) < 300, 20.0, 100.0) * np.ones((8, 1))
    >>> edge = edge.astype(np.float32)
    >>> moved = spread_colours(edge, LateralColour(red=0.01, blue=0.0), (0.0, 4.0)) - edge
    >>> round(float(-moved[4].sum() / (80 * 0.2126)), 1)  # 1 % of 300 px
    3.0
    """
    u, v = principal_px
    mixed = np.float32(LUMINANCE[1]) * luma
    for share, size in ((LUMINANCE[0], colour.red), (LUMINANCE[2], colour.blue)):
        mixed += np.float32(share) * warp(luma, [[1 + size, 0, -size * u], [0, 1 + size, -size * v]])
    return mixed


def compute_turn_fields(camera: Camera, rays: FloatArray) -> npt.NDArray[np.float32]:
    """How places in a picture move when the camera turns, shape (3, 2, H, W) [px/rad].

    Parameters
    ----------
    camera
        The camera.
    rays
        Undistorted rays (x/z, y/z) of its pixels, shape (H, W, 2) [1].

    Notes
    -----
    Of a camera turned by the vector w in its axes, a ray r becomes ``r - w x r``; differences through the camera's
    own projection, so that distortion and the distance from the axis are in them. What is left out is of second
    order: 0.004 px for a focal length of 7500 px turned by 1 mrad.
    """
    alone = replace(camera, cam_from_world=np.eye(3, 4))
    ahead = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    fields = np.empty((3, 2, *rays.shape[:2]), np.float32)
    for axis in range(3):
        step = -_SMALL_RAD * np.cross(np.eye(3)[axis], ahead)
        moved = alone.project(ahead + step) - alone.project(ahead - step)
        fields[axis] = np.moveaxis(moved, -1, 0) / (2 * _SMALL_RAD)
    return fields


def resample(luma: Frame, u: npt.NDArray[np.float32], v: npt.NDArray[np.float32]) -> Frame:
    """Values of a frame at other places, by cubic B-splines that pass through its pixels, shape (H, W).

    Parameters
    ----------
    luma
        The frame, shape (H, W).
    u, v
        Places for each pixel of the new frame, shape (H, W) [px]; beyond the border it is mirrored.

    Raises
    ------
    DatasetError
        The places are not as many as the pixels.

    Notes
    -----
    Where OpenCV rounds places to 1/32 px, these are exact: a camera that shakes moves by less than that.

    Examples
    --------
    >>> rows, columns = np.indices((8, 64), dtype=np.float32)
    >>> wave = (100 + 50 * np.sin(columns / 2)).astype(np.float32)
    >>> moved = resample(wave, columns + np.float32(0.3), rows)
    >>> float(abs(moved - 100 - 50 * np.sin((columns + 0.3) / 2))[:, 8:56].max().round(1))
    0.0
    """
    for name, places in (("u", u), ("v", v)):
        as_float_array(places, name, luma.shape)
    coefficients = np.asarray(spline_filter(luma, order=3, output=np.float32, mode="mirror"))
    moved = np.empty_like(luma)
    _evaluate(coefficients, u, v, moved)
    return moved


@nb.njit(cache=True, error_model="numpy", parallel=True)
@cached_by_code
def _evaluate(coefficients: Frame, u: Frame, v: Frame, moved: Frame) -> None:
    """Fills ``moved`` with the spline's values at the places, shapes (H, W)."""
    height, width = moved.shape
    for row in nb.prange(height):
        for column in range(width):
            x, y = u[row, column], v[row, column]
            first_u, first_v = int(np.floor(x)) - 1, int(np.floor(y)) - 1
            along, down = _weights(x - np.floor(x)), _weights(y - np.floor(y))
            total = 0.0
            for j in range(4):
                at_v = _mirrored(first_v + j, height)
                for i in range(4):
                    total += down[j] * along[i] * coefficients[at_v, _mirrored(first_u + i, width)]
            moved[row, column] = total


@nb.njit(error_model="numpy", forceinline=True)
def _weights(t: float) -> tuple[float, float, float, float]:
    """Cubic B-spline at the four knots about a place."""
    s = 1 - t
    return s**3 / 6, 2 / 3 - t * t * (1 - t / 2), 2 / 3 - s * s * (1 - s / 2), t**3 / 6


@nb.njit(error_model="numpy", forceinline=True)
def _mirrored(index: int, count: int) -> int:
    """Index within an axis that is mirrored at its first and last value."""
    period = 2 * (count - 1)
    index = abs(index) % period
    return period - index if index >= count else index
