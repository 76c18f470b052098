"""A relief on a flat face under light that turns: its texture changes until dark and bright have changed places."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["Relief"]


class Relief:
    """Heights of random waves, moved by parts of a pixel without error, and lit from any side.

    Parameters
    ----------
    seed
        Of the heights.
    size
        Width and height of the picture, which is periodic [px].
    finest_px, coarsest_px
        Shortest wavelength, and the one beyond which slopes do not grow [px].
    slope
        Standard deviation of the slopes along u and v [1].
    elevation_deg
        Angle of the light above the face [deg].

    Notes
    -----
    Brightness is that of a matt surface without cast shadows: the cosine between normal and light, zero where that is
    negative. Slopes are moved in the Fourier domain, so that a shift is exact.

    Examples
    --------
    >>> relief = Relief(0, (64, 48))
    >>> left, right = relief.picture((0.0, 0.0), 0.0), relief.picture((0.0, 0.0), 180.0)
    >>> bool(np.corrcoef(left.ravel(), right.ravel())[0, 1] < -0.9)
    True
    """

    def __init__(
        self,
        seed: int,
        size: tuple[int, int],
        *,
        finest_px: float = 4.0,
        coarsest_px: float = 20.0,
        slope: float = 0.15,
        elevation_deg: float = 35.0,
    ) -> None:
        width, height = size
        self._fu, self._fv = np.meshgrid(np.fft.fftfreq(width), np.fft.rfftfreq(height), indexing="ij")
        radius = np.hypot(self._fu, self._fv)
        with np.errstate(divide="ignore"):
            amplitude = np.where(
                (radius > 0) & (radius < 1 / finest_px), np.maximum(radius, 1 / coarsest_px) ** -2.0, 0
            )
        noise = np.random.default_rng(seed).standard_normal((width, height))
        heights = np.fft.rfft2(noise) * amplitude
        self._slopes = [2j * np.pi * f * heights for f in (self._fu, self._fv)]
        found = [np.fft.irfft2(one, s=size) for one in self._slopes]
        scale = slope / np.sqrt(np.mean([one.var() for one in found]))
        self._slopes, self._size = [scale * one for one in self._slopes], size
        self._elevation = np.deg2rad(elevation_deg)

    def picture(self, shift: tuple[float, float], azimuth_deg: float) -> FloatArray:
        """Brightness, shape (H, W) [1].

        Parameters
        ----------
        shift
            How far the relief has moved (u, v) [px].
        azimuth_deg
            Side from which light comes, from u towards v [deg].
        """
        phase = np.exp(-2j * np.pi * (self._fu * shift[0] + self._fv * shift[1]))
        along_u, along_v = (np.fft.irfft2(one * phase, s=self._size) for one in self._slopes)
        azimuth = np.deg2rad(azimuth_deg)
        flat, up = np.cos(self._elevation), np.sin(self._elevation)
        lit = up - flat * (along_u * np.cos(azimuth) + along_v * np.sin(azimuth))
        return np.asarray((np.maximum(lit, 0.0) / np.sqrt(1 + along_u**2 + along_v**2)).T)
