"""The first question to a network with real weights: does it follow a motion of half a pixel to three?

A textured patch moves as a whole, or a textured plate moves in front of a textured wall that stands still, as a bridge
does in a picture. The gain is the slope of what was found over what was moved: 1 is right, 0 is blind.
"""

from dataclasses import dataclass

import numpy as np

from textures import WaveTexture

SHAPE = (420, 420)
POINT = np.array([205.25, 212.5])
AMPLITUDES_PX = (0.5, 1.0, 3.0)
KINDS = ("whole patch", "object in a still patch")
_PLATE = (150, 90)
"""Half sides of the plate, (u, v) [px]."""


@dataclass(frozen=True)
class Gain:
    """What a tracker makes of a motion.

    Parameters
    ----------
    gain
        By axis (u, v) [1].
    noise_px
        Root mean square of what is left, by axis [px].
    found
        Share of the frames in which the point was seen.
    """

    gain: tuple[float, float]
    noise_px: tuple[float, float]
    found: float


def motion(amplitude_px, frames):
    """Displacement (frames, 2) [px] from the first frame, of this amplitude along both axes, of different periods."""
    k = np.arange(frames)
    across = np.sin(2 * np.pi * k / max(frames / 3, 5))
    down = np.sin(2 * np.pi * k / max(frames / 5, 3.5) + 0.6) - np.sin(0.6)
    return amplitude_px * np.stack([across, down], axis=1)


def pictures(kind, amplitude_px, frames):
    """Frames of this kind, uint8 (420, 420)."""
    wall, plate = WaveTexture(21), WaveTexture(22)
    still = wall.image(SHAPE)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    found = []
    for shift in motion(amplitude_px, frames):
        if kind == KINDS[0]:
            image = plate.image(SHAPE, shift)
        else:
            # Covered share of each pixel: an edge that moves by fractions of a pixel must not jump.
            inside = [
                np.clip(half - np.abs(axis - centre) + 0.5, 0, 1)
                for axis, half, centre in zip((columns, rows), _PLATE, POINT + shift, strict=True)
            ]
            share = inside[0] * inside[1]
            image = share * plate.image(SHAPE, shift) + (1 - share) * still
        found.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return found


def measure_gain(positions, amplitude_px):
    """Gain of found positions (frames, 2) [px], NaN where nothing was found."""
    true = motion(amplitude_px, len(positions))
    seen = np.isfinite(positions).all(axis=1)
    gains, noises = [], []
    for axis in range(2):
        A = np.stack([true[seen, axis], np.ones(seen.sum())], axis=1)
        solution = np.linalg.lstsq(A, positions[seen, axis], rcond=None)[0] if seen.sum() > 2 else [np.nan, np.nan]
        gains.append(float(solution[0]))
        noises.append(float(np.sqrt(np.mean((positions[seen, axis] - A @ solution) ** 2))) if seen.any() else np.nan)
    return Gain(tuple(gains), tuple(noises), float(seen.mean()))
