"""Frames with exactly known motion: band-limited textures shifted in the Fourier domain, and a video in memory."""

import numpy as np

from vfm_sdm.inputs.video import Frame, Video, VideoInfo

GRAY_RANGE = 255.0
NOISE = 0.01 * GRAY_RANGE


class NaturalTexture:
    """A periodic texture with amplitudes that fall as 1 / frequency, nothing above ``cutoff`` (cycles a pixel).

    Shifts are exact, and so are its derivatives.
    """

    def __init__(self, seed, size=256, cutoff=0.3, contrast=45.0, exponent=1.0, mean=127.0):
        frequency = np.fft.fftfreq(size)
        self.fu, self.fv = np.meshgrid(frequency, frequency)
        radius = np.hypot(self.fu, self.fv)
        amplitude = np.where((radius > 0) & (radius < cutoff), np.maximum(radius, 4 / size) ** -exponent, 0)
        spectrum = np.fft.fft2(np.random.default_rng(seed).standard_normal((size, size))) * amplitude
        self.spectrum = contrast * spectrum / np.fft.ifft2(spectrum).real.std()
        self.mean = mean

    def image(self, shift=(0.0, 0.0)):
        """Moved by ``shift`` (u, v) [px]; real values."""
        phase = np.exp(-2j * np.pi * (self.fu * shift[0] + self.fv * shift[1]))
        return self.mean + np.fft.ifft2(self.spectrum * phase).real

    def gradients(self):
        """Exact derivatives along u and v [1/px]."""
        return tuple(np.fft.ifft2(2j * np.pi * f * self.spectrum).real for f in (self.fu, self.fv))

    def cramer_rao_std(self, points, subset_px, noise):
        """Smallest standard deviation (P, 2) that any unbiased estimate of an affine warp's position can have [px].

        Gain and bias are estimated as well, both frames carry white noise of standard deviation ``noise``.
        """
        half = subset_px // 2
        steps = np.arange(-half, half + 1.0)
        x, y = np.meshgrid(steps, steps)
        gray = self.image()
        grad_u, grad_v = self.gradients()
        bound = []
        for u, v in np.rint(points).astype(int):
            part = np.s_[v - half : v + half + 1, u - half : u + half + 1]
            columns = [g[part] * weight for g in (grad_u, grad_v) for weight in (1.0, x, y)]
            J = np.stack([*columns, gray[part], np.ones_like(x)]).reshape(8, -1)
            bound.append(np.sqrt(2 * noise**2 * np.diag(np.linalg.inv(J @ J.T))[[0, 3]]))
        return np.array(bound)


class MemorySource:
    """Frames in memory as a source for `Video`."""

    def __init__(self, frames, fps=100.0):
        self.frames = list(frames)
        height, width = self.frames[0].shape
        bits = 8 if self.frames[0].dtype == np.uint8 else 16
        count = len(self.frames)
        self.info = VideoInfo("memory", width, height, fps, count, count / fps, "raw", "gray", bits, 0)

    def stream(self):
        for index, luma in enumerate(self.frames):
            yield Frame(index, index / self.info.fps, luma, lambda region, luma=luma: gray_colors(region.crop(luma)))


def gray_colors(luma):
    """The same brightness in all three channels, 8 bits, shape (height, width, 3)."""
    eight = luma if luma.dtype == np.uint8 else (luma >> 8).astype(np.uint8)
    return np.repeat(eight[:, :, None], 3, axis=2)


def memory_video(frames, fps=100.0):
    """A `Video` over frames that lie in memory."""
    return Video(MemorySource(frames, fps))


def digitize(image, rng=None, noise=0.0, dtype=np.uint8, scale=1.0):
    """Grey values as a camera would give them: noise added, scaled, rounded and clipped."""
    noisy = image if rng is None else image + rng.normal(0, noise, image.shape)
    return np.clip(np.rint(scale * noisy), 0, np.iinfo(dtype).max).astype(dtype)


def grid_points(size, step, margin):
    """Points on a regular grid inside a square image, shape (P, 2) [px]."""
    steps = np.arange(margin, size - margin + 1, step, dtype=float)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
