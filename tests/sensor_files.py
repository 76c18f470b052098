"""Recordings of a virtual accelerometer as files of instruments."""

import numpy as np

AXES = ("lateral", "vertical", "longitudinal")
HEADER = "time,lateral,vertical,longitudinal"
RATE = 200.0


def swinging(duration_s=8.0, rate=RATE, noise=2e-3, seed=2):
    """Stamps [s] and acceleration [m/s2], gravity included, of a deck that swings from 2 s on."""
    time_s = np.arange(round(duration_s * rate)) / rate
    size = np.clip(time_s - 2, 0, 1) ** 2 * np.exp(-0.1 * np.maximum(time_s - 3, 0))
    motion = np.sin(2 * np.pi * np.array([1.9, 2.7, 2.7]) * time_s[:, None]) * [0.8, 2.5, 0.1] * size[:, None]
    scatter = np.random.default_rng(seed).normal(0, noise, motion.shape)
    return time_s, motion + scatter + np.array([0, -9.80665, 0])


def rows(stamps, values, separator=",", decimal=".", digits=6):
    """A line for each sample; a stamp may be text."""
    lines = []
    for stamp, row in zip(stamps, values, strict=True):
        cells = [f"{value:.{digits}f}".replace(".", decimal) for value in row]
        lines.append(
            separator.join([stamp if isinstance(stamp, str) else f"{stamp:.6f}".replace(".", decimal), *cells])
        )
    return lines


def put(folder, lines, name="acc.csv", encoding="utf-8", newline="\n"):
    """The lines as a file; its path."""
    path = folder / name
    path.write_bytes((newline.join(lines) + newline).encode(encoding))
    return path
