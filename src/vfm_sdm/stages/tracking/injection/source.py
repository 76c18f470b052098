"""What was before the camera's encoder: a clean picture and its noise, from a compressed recording of it."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy.ndimage import gaussian_filter, uniform_filter

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray

_Spectrum = npt.NDArray[np.complex64]

__all__ = ["Looks", "Source", "measure_looks"]

_EDGES = np.array([0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.36, 0.75])
"""Bands of spatial frequency in which contrast is compared [cycles a pixel]."""
_BOOST = (0.5, 4.0)
"""Bounds of the factor by which a band's contrast may differ from that of the recording's mean picture."""
_NOISE = (0.1, 20.0)
_STEP = 0.8
"""Part of a correction of contrast that is made: encoders take more from the weak, and a full one overshoots."""
_TAPER_PX = 8
_EVERY = 4
"""Frames of which one is looked at to tell what moves from what stands still."""
_VOTE_PX = 9
_SOFT_PX = 1.5
_HALF = 0.5
"""Share of the variance that motion would make there, from which on a place counts as still."""


@dataclass(frozen=True, eq=False)
class Looks:
    """What a clip of a moving surface shows of it: contrast of its mean picture, and noise of its intra frames.

    Parameters
    ----------
    contrast
        Root mean square amplitude of the mean picture in each band of spatial frequency, shape (B,) [grey levels].
    noise
        Standard deviation of intra frames about the mean picture [grey levels].
    """

    contrast: FloatArray
    noise: float


def measure_looks(clip: LumaArray, center: FloatArray, shifts: FloatArray, intra: BoolArray, side: int) -> Looks:
    """Looks of the square around a point that moves in a clip.

    Parameters
    ----------
    clip
        Pictures, shape (T, H, W).
    center
        Place of the point in the first of them, shape (2,) [px].
    shifts
        Motion of the point since then, shape (T, 2) [px]; frames where it is NaN are left out.
    intra
        Which frames are coded by themselves, shape (T,).
    side
        Side of the square [px].
    """
    known = np.isfinite(shifts).all(axis=1)
    half = side // 2
    u, v = (round(float(x)) for x in center)
    window = np.outer(np.hanning(2 * half + 2)[1:-1], np.hanning(2 * half + 2)[1:-1]).astype(np.float32)
    part = clip[known, v - half : v + half, u - half : u + half].astype(np.float32)
    spectra = scipy.fft.rfft2((part - part.mean(axis=(1, 2), keepdims=True)) * window)
    fv, fu = np.fft.fftfreq(2 * half)[:, None], np.fft.rfftfreq(2 * half)[None]
    shifts = shifts[known].astype(np.float32)
    phase = 2 * np.pi * (fu * shifts[:, 0, None, None] + fv * shifts[:, 1, None, None])
    spectra *= np.exp(1j * phase.astype(np.float32))
    mean = spectra.mean(axis=0)
    radius = np.hypot(fu, fv)
    power = np.abs(mean) ** 2
    contrast = [np.sqrt(power[(radius >= low) & (radius < high)].mean()) for low, high in pairwise(_EDGES)]
    chosen = intra[known] if intra[known].any() else np.ones(int(known.sum()), np.bool_)
    apart = np.abs(spectra[chosen] - mean) ** 2
    # Columns of a real transform but the first and the last stand for two.
    weight = np.full(apart.shape[2], 2.0)
    weight[[0, -1]] = 1.0
    energy = float((apart * weight).sum(axis=(1, 2)).mean()) / (2 * half) ** 2
    return Looks(np.array(contrast) / (2 * half), float(np.sqrt(energy / float((window**2).sum()))))


@dataclass(frozen=True, eq=False)
class Source:
    """A surface that can be moved by any part of a pixel, and the noise of the pictures of it.

    Parameters
    ----------
    spectrum
        Transform of the mean picture, with `margin_px` around what is drawn.
    mask
        Transform of the share of each pixel that moves.
    still
        Picture of what stands still, with its margin.
    shape
        Height and width of the picture with its margin [px].
    level
        Mean of the picture [grey levels].
    factors
        Contrast of each band over that of the mean picture, shape (B,).
    noise
        Standard deviation [grey levels].
    margin_px
        Pixels around what is drawn.
    """

    spectrum: _Spectrum
    mask: _Spectrum
    still: FloatArray
    shape: tuple[int, int]
    level: float
    factors: FloatArray
    noise: float
    margin_px: int

    @classmethod
    def estimate(cls, clip: LumaArray, shifts: FloatArray, *, noise: float, margin_px: int) -> "Source":
        """The surface as the mean of all pictures, each moved back.

        Parameters
        ----------
        clip
            Pictures, shape (T, H, W), with a margin.
        shifts
            Motion since the first, shape (T, 2) [px]; frames where it is NaN are left out.
        noise
            Standard deviation to begin with [grey levels].
        margin_px
            Width of the margin [px].
        """
        known = np.isfinite(shifts).all(axis=1)
        shape = cast("tuple[int, int]", clip.shape[1:])
        level = float(clip[known].mean())
        taper = np.outer(*(_taper(n) for n in shape))
        total = np.zeros((shape[0], shape[1] // 2 + 1), np.complex64)
        seen, seen_moving = _Scatter(), _Scatter()
        for number, (picture, shift) in enumerate(zip(clip[known], shifts[known], strict=True)):
            centred = (picture.astype(np.float32) - level) * taper
            moved = scipy.fft.rfft2(centred) * _phase(shape, -shift)
            total += moved
            if number % _EVERY == 0:
                seen.add(centred)
                seen_moving.add(np.asarray(scipy.fft.irfft2(moved, s=shape)))
        stays = _find_still(seen, seen_moving, shifts[known])
        mask = scipy.fft.rfft2(gaussian_filter((~stays).astype(np.float32), _SOFT_PX)).astype(np.complex64)
        one = np.ones(len(_EDGES) - 1)
        return cls(total / known.sum(), mask, seen.mean(), shape, level, one, noise, margin_px)

    def render(self, shifts: FloatArray, bit_depth: int, rng: np.random.Generator) -> LumaArray:
        """Pictures of the surface in motion, with noise, rounded, shape (T, H, W) without the margin.

        Parameters
        ----------
        shifts
            Motion of each picture, shape (T, 2) [px].
        bit_depth
            Significant bits of the pictures.
        rng
            Source of the noise.
        """
        spectrum = self.spectrum * self._gain()
        inner = slice(self.margin_px, -self.margin_px)
        highest = (1 << bit_depth) - 1
        pictures = []
        all_moves = self._all_moves
        for shift in shifts:
            phase = _phase(self.shape, shift)
            moved = scipy.fft.irfft2(spectrum * phase, s=self.shape)[inner, inner]
            if not all_moves:
                share = scipy.fft.irfft2(self.mask * phase, s=self.shape)[inner, inner]
                moved = self.still[inner, inner] + np.clip(share, 0, 1) * (moved - self.still[inner, inner])
            noisy = moved + np.float32(self.noise) * rng.standard_normal(moved.shape, dtype=np.float32) + self.level
            pictures.append(np.clip(np.rint(noisy), 0, highest).astype(np.uint8 if bit_depth == 8 else np.uint16))
        return cast("LumaArray", np.array(pictures))

    def corrected(self, wanted: Looks, got: Looks) -> "Source":
        """The source whose pictures should come nearer to what a recording shows.

        Parameters
        ----------
        wanted, got
            Looks of the recording, and of this source's pictures after the encoder.
        """
        step = wanted.contrast / np.maximum(got.contrast, 1e-6)
        noise = self.noise * (wanted.noise / max(got.noise, 1e-3))
        return replace(self, factors=np.clip(self.factors * step**_STEP, *_BOOST), noise=float(np.clip(noise, *_NOISE)))

    def share_still(self, center: FloatArray, believed: BoolArray) -> float:
        """Share of the believed pixels of a subset that stand still beside what moves [1].

        Parameters
        ----------
        center
            Place of the subset's centre, with the margin, shape (2,) [px].
        believed
            Which of its pixels are compared, shape (S, S).
        """
        half = len(believed) // 2
        u, v = (round(float(x)) for x in center)
        share = scipy.fft.irfft2(self.mask, s=self.shape)[v - half : v + half + 1, u - half : u + half + 1]
        return float(1 - share[believed].mean())

    @property
    def _all_moves(self) -> bool:
        """Whether nothing in the picture stands still: of the mask's transform only the mean is left, and it is 1."""
        return bool(abs(self.mask[0, 0] - self.shape[0] * self.shape[1]) < 1.0)

    def _gain(self) -> FloatArray:
        fv, fu = np.fft.fftfreq(self.shape[0])[:, None], np.fft.rfftfreq(self.shape[1])[None]
        centers = (_EDGES[:-1] + _EDGES[1:]) / 2
        return np.asarray(np.interp(np.hypot(fu, fv), centers, self.factors).astype(np.float32))


class _Scatter:
    """Mean of pictures, and their variance in time about each pixel."""

    def __init__(self) -> None:
        self._count = 0
        self._sum: Any = 0.0
        self._squares: Any = 0.0

    def add(self, picture: npt.NDArray[np.floating[Any]]) -> None:
        self._count += 1
        self._sum = self._sum + picture
        self._squares = self._squares + picture**2

    def mean(self) -> FloatArray:
        return np.asarray(self._sum / self._count)

    def variance(self) -> FloatArray:
        variance = self._squares / self._count - (self._sum / self._count) ** 2
        return np.asarray(uniform_filter(variance, _VOTE_PX, mode="nearest"))


def _find_still(seen: _Scatter, seen_moving: _Scatter, shifts: FloatArray) -> BoolArray:
    """Places that stand still beside what moves, shape (H, W).

    A textured place that moves changes by its gradient times the motion, and does not when the pictures are moved back;
    one that stands still does the opposite. Where that is less than the noise, nothing is lost by moving it as well.
    """
    covariance = np.cov(shifts.T)
    motion = np.zeros_like(seen.mean())
    for mean in (seen.mean(), seen_moving.mean()):
        dv, du = np.gradient(mean)
        change = covariance[0, 0] * du**2 + 2 * covariance[0, 1] * du * dv + covariance[1, 1] * dv**2
        motion = np.maximum(motion, uniform_filter(change, _VOTE_PX, mode="nearest"))
    apart = seen_moving.variance() - seen.variance()
    noise = np.median(np.minimum(seen_moving.variance(), seen.variance()))
    return np.asarray((apart > _HALF * motion) & (motion > noise))


def _taper(count: int) -> FloatArray:
    """Window that falls to zero at both ends, where a picture does not continue, shape (count,)."""
    rise = np.sin(np.pi / 2 * (np.arange(_TAPER_PX) + 0.5) / _TAPER_PX) ** 2
    return np.asarray(np.concatenate([rise, np.ones(count - 2 * _TAPER_PX), rise[::-1]]).astype(np.float32))


def _phase(shape: tuple[int, int], shift: FloatArray) -> _Spectrum:
    """Factors of a real transform that move a picture by (u, v) [px], shape (H, W // 2 + 1)."""
    along_v = np.exp(-2j * np.pi * np.fft.fftfreq(shape[0]) * shift[1]).astype(np.complex64)
    along_u = np.exp(-2j * np.pi * np.fft.rfftfreq(shape[1]) * shift[0]).astype(np.complex64)
    return np.asarray(along_v[:, None] * along_u[None])
