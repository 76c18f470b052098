"""Analytic textures: grey values known at every real-valued position, so that a shift of them is exact."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray


class WaveTexture:
    """Many cosine waves of random direction with amplitudes that fall with frequency, as in natural surfaces."""

    def __init__(self, seed: int, waves: int = 150, shortest_px: float = 4.0, longest_px: float = 60.0) -> None:
        rng = np.random.default_rng(seed)
        length = np.exp(rng.uniform(np.log(shortest_px), np.log(longest_px), waves))
        angle = rng.uniform(0, 2 * np.pi, waves)
        self._k = 2 * np.pi / length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self._phase = rng.uniform(0, 2 * np.pi, waves)
        self._amplitude = np.sqrt(length) / np.sqrt(np.sum(length) / 2)

    def __call__(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Values with mean 128 and standard deviation 35, shape of ``u``."""
        total = np.zeros(np.broadcast(u, v).shape)
        for (ku, kv), phase, amplitude in zip(self._k, self._phase, self._amplitude, strict=True):
            total += amplitude * np.cos(ku * u + kv * v + phase)
        return 128 + 35 * total

    def image(self, shape: tuple[int, int], shift: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """The texture moved by ``shift`` (u, v) [px] on a grid of pixels."""
        # The cosine of a sum, by column and by row: two matrix products instead of a cosine a pixel and wave.
        ku, kv = self._k.T
        along_u = np.outer(np.arange(shape[1]) - shift[0], ku) + self._phase
        along_v = np.outer(np.arange(shape[0]) - shift[1], kv)
        by_row = self._amplitude * np.cos(along_v), self._amplitude * np.sin(along_v)
        return 128 + 35 * (by_row[0] @ np.cos(along_u).T - by_row[1] @ np.sin(along_u).T)
