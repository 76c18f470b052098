"""The image sensor, which turns light into 8-bit luma with noise."""

import math
from typing import Any

import numba as nb
import numpy as np
import numpy.typing as npt

from vfm_sdm.errors import DatasetError

__all__ = ["LUMA_RANGE", "Imager"]

LUMA_RANGE = (16, 235)
"""Black and white of 8-bit video."""
_SPARE = 2
"""Number of noise values that are kept, in multiples of a frame's pixels."""


class Imager:
    """Makes 8-bit frames of luma: with sensor noise, rounded, limited to `LUMA_RANGE`.

    Parameters
    ----------
    image_size
        Width and height [px].
    noise_std
        Standard deviation of Gaussian noise, independent from pixel to pixel and frame to frame, in luma units.
    seed
        Seed of the noise; the same seed gives the same frames.

    Raises
    ------
    DatasetError
        The noise is negative or not finite.

    Notes
    -----
    Drawing eight million normal numbers takes longer than drawing a frame. They are drawn once, twice as many as a
    frame has pixels, and every frame begins at another place among them: two frames share numbers, but hardly ever
    at the same pixel.
    """

    def __init__(self, image_size: tuple[int, int], *, noise_std: float, seed: tuple[int, ...] = (0,)) -> None:
        if not (np.isfinite(noise_std) and noise_std >= 0):
            raise DatasetError(f"noise_std: expected luma units >= 0, got {noise_std}; correct it")
        self._shape = image_size[::-1]
        self._seed = seed
        count = math.prod(image_size) if noise_std > 0 else 0
        rng = np.random.default_rng(seed)
        self._noise = np.float32(noise_std) * rng.standard_normal(_SPARE * count, dtype=np.float32)

    def expose(self, luma: npt.NDArray[np.float32], number: int) -> npt.NDArray[np.uint8]:
        """A frame as the sensor gives it.

        Parameters
        ----------
        luma
            Luma that falls on the sensor, shape (H, W), in units of 8-bit video.
        number
            Number of the frame, which decides its noise.

        Returns
        -------
        frame
            Shape (H, W), uint8.

        Raises
        ------
        DatasetError
            The luma has another shape than the image.

        Examples
        --------
        >>> imager = Imager((64, 48), noise_std=1.0)
        >>> frame = imager.expose(np.full((48, 64), 100.0, np.float32), 0)
        >>> frame.dtype, round(float(frame.std()))
        (dtype('uint8'), 1)
        """
        if luma.shape != self._shape:
            raise DatasetError(f"luma: expected shape {self._shape}, got {luma.shape}; render with the same camera")
        start = 0
        if len(self._noise):
            start = int(np.random.default_rng([*self._seed, number]).integers(len(self._noise) - luma.size))
        frame = np.empty(luma.size, np.uint8)
        _quantize(np.ascontiguousarray(luma, np.float32).ravel(), self._noise[start:], frame, *LUMA_RANGE)
        return frame.reshape(luma.shape)


@nb.njit(cache=True, parallel=True)
def _quantize(
    luma: npt.NDArray[np.float32], noise: npt.NDArray[np.float32], frame: Any, black: int, white: int
) -> None:
    noisy = noise.size > 0
    for n in nb.prange(luma.size):
        value = luma[n] + noise[n] if noisy else luma[n]
        frame[n] = np.uint8(min(max(np.rint(value), black), white))
