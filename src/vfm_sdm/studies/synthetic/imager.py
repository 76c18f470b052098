"""The image sensor, which turns light into 8-bit luma with noise."""

import math
from typing import Any

import numba as nb
import numpy as np
import numpy.typing as npt

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.photometry import Photometry

__all__ = ["LUMA_RANGE", "Imager"]

LUMA_RANGE = (16, 235)
"""Black and white of 8-bit video."""
_SPARE = 2
"""Number of noise values that are kept, in multiples of a frame's pixels."""
_TABLE_STEPS = 1 << 13
"""Steps of the tone curve's table, whose error is then below a thousandth of a luma unit."""


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
    photometry
        Photon noise and tone curve of a sensor that gets linear light; then
        ``noise_std`` must be 0.

    Raises
    ------
    DatasetError
        The noise is negative or not finite, or there is noise of both kinds.

    Notes
    -----
    Drawing eight million normal numbers takes longer than drawing a frame. They are drawn once, twice as many as a
    frame has pixels, and every frame begins at another place among them: two frames share numbers, but hardly ever
    at the same pixel.
    """

    def __init__(
        self,
        image_size: tuple[int, int],
        *,
        noise_std: float,
        seed: tuple[int, ...] = (0,),
        photometry: Photometry | None = None,
    ) -> None:
        if not (np.isfinite(noise_std) and noise_std >= 0):
            raise DatasetError(f"noise_std: expected luma units >= 0, got {noise_std}; correct it")
        photons = photometry is not None and photometry.full_well_e > 0
        if noise_std > 0 and photons:
            raise DatasetError(f"noise_std: expected 0 beside photon noise, got {noise_std}; leave one of them out")
        self._shape = image_size[::-1]
        self._seed = seed
        count = math.prod(image_size) if noise_std > 0 or photons else 0
        rng = np.random.default_rng(seed)
        scale = 1.0 if photons else noise_std
        self._noise = np.float32(scale) * rng.standard_normal(_SPARE * count, dtype=np.float32)
        self._tone = None if photometry is None else _Tone(photometry)

    def expose(self, luma: npt.NDArray[np.float32], number: int) -> npt.NDArray[np.uint8]:
        """A frame as the sensor gives it.

        Parameters
        ----------
        luma
            Luma that falls on the sensor, shape (H, W), in units of 8-bit video; linear light for a sensor with a tone
            curve.
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
        light = np.ascontiguousarray(luma, np.float32).ravel()
        if self._tone is None:
            _quantize(light, self._noise[start:], frame, *LUMA_RANGE)
        else:
            _develop(light, self._noise[start:], frame, self._tone.table, self._tone.noise)
        return frame.reshape(luma.shape)


class _Tone:
    """A tone curve as a table over linear light from black to white, and what the noise is made of."""

    def __init__(self, photometry: Photometry) -> None:
        black, white = LUMA_RANGE
        self.table = photometry.tone(np.linspace(black, white, _TABLE_STEPS + 1)).astype(np.float32)
        # Variance at black [luma2], and its growth with luma [luma].
        at_black = float(photometry.noise_std(np.array(float(black)))) ** 2
        growth = float(photometry.noise_std(np.array(float(white)))) ** 2 - at_black
        self.noise = np.array([at_black, growth / (white - black)], np.float32)


@nb.njit(cache=True, parallel=True)
def _develop(
    light: npt.NDArray[np.float32],
    noise: npt.NDArray[np.float32],
    frame: Any,
    table: npt.NDArray[np.float32],
    growth: npt.NDArray[np.float32],
) -> None:
    """Fills a frame with noise that follows the light, through the tone curve of the table."""
    black, white = LUMA_RANGE
    scale = np.float32((len(table) - 1) / (white - black))
    noisy = noise.size > 0
    for n in nb.prange(light.size):
        above = light[n] - np.float32(black)
        if noisy:
            above += noise[n] * np.sqrt(growth[0] + growth[1] * max(above, np.float32(0)))
        place = min(max(above * scale, np.float32(0)), np.float32(len(table) - 1))
        index = min(int(place), len(table) - 2)
        frame[n] = np.uint8(np.rint(table[index] + (place - index) * (table[index + 1] - table[index])))


@nb.njit(cache=True, parallel=True)
def _quantize(
    luma: npt.NDArray[np.float32], noise: npt.NDArray[np.float32], frame: Any, black: int, white: int
) -> None:
    noisy = noise.size > 0
    for n in nb.prange(luma.size):
        value = luma[n] + noise[n] if noisy else luma[n]
        frame[n] = np.uint8(min(max(np.rint(value), black), white))
