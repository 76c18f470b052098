"""A film of a textured plate with exact truth: it vibrates by some px and drifts slowly by tens."""

from pathlib import Path

import av
import numpy as np

from vfm_sdm.core.arrays import FloatArray

__all__ = ["FPS", "POINTS", "SIZE", "motion", "pictures", "write_film"]

SIZE = (240, 320)
FPS = 10
POINTS = {"a": (90.0, 80.0), "b": (150.3, 120.6), "c": (200.0, 90.4), "d": (120.5, 165.0)}


def motion(frames: int, *, drift_px: float = 25.0, swing_px: float = 3.0) -> FloatArray:
    """Displacement along u and v from the first frame on, shape (T, 2) [px]."""
    t = np.arange(frames) / FPS
    swing = swing_px * np.stack([np.sin(2 * np.pi * 0.83 * t), np.sin(2 * np.pi * 1.31 * t)], axis=1)
    return np.asarray(swing + drift_px * (t / t[-1])[:, None] * [1.0, -0.4])


def pictures(moved: FloatArray, *, seed: int = 5, noise: float = 1.5) -> list[np.ndarray]:
    """Pictures of a plate moved by (u, v) [px]; its texture holds no more than 0.3 cycles a pixel."""
    rows, columns = (2 * n for n in SIZE)
    fu, fv = np.fft.rfftfreq(columns)[None], np.fft.fftfreq(rows)[:, None]
    radius = np.hypot(fu, fv)
    amplitude = np.where((radius > 0) & (radius < 0.3), 1 / np.maximum(radius, 0.02), 0)
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal((rows, columns))) * amplitude
    spectrum *= 38 / np.fft.irfft2(spectrum, s=(rows, columns)).std()
    found = []
    for u, v in moved:
        plate = 128 + np.fft.irfft2(spectrum * np.exp(-2j * np.pi * (fu * u + fv * v)), s=(rows, columns))
        visible = plate[: SIZE[0], : SIZE[1]] + rng.normal(0, noise, SIZE)
        found.append(np.clip(np.rint(visible), 16, 235).astype(np.uint8))
    return found


def write_film(path: Path, lumas: list[np.ndarray], *, key_every: int = FPS, crf: int = 12) -> Path:
    """The pictures as H.264, with a key frame once a second."""
    height, width = lumas[0].shape
    options = {"crf": str(crf), "preset": "fast", "g": str(key_every), "keyint_min": str(key_every), "bf": "2"}
    options["x264-params"] = "scenecut=0:threads=1"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        grey = np.full((height // 2, width), 128, np.uint8)
        for number, luma in enumerate(lumas):
            frame = av.VideoFrame.from_ndarray(np.concatenate([luma, grey]), format="yuv420p")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path
