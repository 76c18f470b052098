"""Recordings of a plate in motion before a wall at rest, compressed, with known motion."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SIZE = (192, 256)
POINT = np.array([128.0, 96.0])
HALF_PLATE_PX = 52
FPS = 30
STILL = 8


@dataclass(frozen=True)
class Film:
    """A recording, and the motion in it, shape (T, 2) [px]."""

    path: Path
    motion: np.ndarray


def motion(frames, amplitudes_px):
    """Motion of two modes from rest, of these root mean squares along u and v, shape (T, 2) [px]."""
    t = np.arange(frames) / FPS
    found = np.column_stack(
        [
            np.sin(2 * np.pi * 1.37 * t + 0.4) + 0.6 * np.sin(2 * np.pi * 2.1 * t + 2),
            np.sin(2 * np.pi * 1.37 * t) + 0.6 * np.sin(2 * np.pi * 2.83 * t + 1),
        ]
    )
    found *= np.clip((np.arange(frames) - STILL) / 10, 0, 1)[:, None]
    return found * np.array(amplitudes_px) / np.maximum(found[STILL:].std(axis=0), 1e-9)


class Surface:
    """A texture whose amplitudes fall with frequency up to 0.3 cycles a pixel, moved exactly by its phases."""

    def __init__(self, seed):
        self._fu, self._fv = np.fft.rfftfreq(SIZE[1])[None], np.fft.fftfreq(SIZE[0])[:, None]
        radius = np.hypot(self._fu, self._fv)
        amplitude = np.where((radius > 0) & (radius < 0.3), 1 / np.maximum(radius, 0.03), 0)
        self._spectrum = np.fft.rfft2(np.random.default_rng(seed).standard_normal(SIZE)) * amplitude
        self._spectrum /= np.fft.irfft2(self._spectrum, s=SIZE).std()

    def image(self, shift=(0.0, 0.0)):
        """Grey values of mean 0 and standard deviation 1, moved by ``shift`` (u, v) [px]."""
        phase = np.exp(-2j * np.pi * (self._fu * shift[0] + self._fv * shift[1]))
        return np.fft.irfft2(self._spectrum * phase, s=SIZE)


def pictures(frames, contrast, amplitudes_px, *, noise=1.5, seed=0):
    """Frames of a plate of this contrast [grey levels], shape (T, H, W), and its motion."""
    plate, wall = Surface(100 + seed), Surface(200 + seed)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    behind = 118 + 18 * wall.image()
    rng, moved, luma = np.random.default_rng(seed), motion(frames, amplitudes_px), []
    for shift in moved:
        share = np.ones(SIZE)
        for axis, at in ((columns, POINT[0] + shift[0]), (rows, POINT[1] + shift[1])):
            share = share * np.clip(HALF_PLATE_PX - np.abs(axis - at) + 0.5, 0, 1)
        surface = 128 + contrast * plate.image(shift)
        picture = share * surface + (1 - share) * behind + rng.normal(0, noise, SIZE)
        luma.append(np.clip(np.rint(picture), 16, 235).astype(np.uint8))
    return np.array(luma), moved


def film(path, luma, moved, *, codec="libx264", **options):
    """The frames as a compressed recording."""
    height, width = luma.shape[1:]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(FPS), options={k: str(v) for k, v in options.items()})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        grey = np.full((height // 2, width), 128, np.uint8)
        for number, picture in enumerate(luma):
            frame = av.VideoFrame.from_ndarray(np.concatenate([picture, grey]), format="yuv420p")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return Film(Path(path), moved)
