"""Displacement of a beam that vibrates in known modes, driven by white noise, without films."""

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement

__all__ = ["DAMPING", "FREQUENCY_HZ", "NOISE_MM", "oscillate", "true_shapes", "vibrate"]

FREQUENCY_HZ = np.array([1.6, 2.4, 6.1])
DAMPING = np.array([0.012, 0.015, 0.02])
NOISE_MM = 0.02
RATE_HZ = 30.0
POINTS = 6


def oscillate(frequency_hz: float, damping: float, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """Response of a mode to white noise, exactly, of standard deviation 1, shape (T,)."""
    angular = 2 * np.pi * frequency_hz
    pole = angular * (-damping + 1j * np.sqrt(1 - damping**2))
    step = expm(np.array([[0, 1], [-(angular**2), -2 * damping * angular]]) / rate_hz)
    still = np.diag([1, angular**2])
    force = np.linalg.cholesky(still - step @ still @ step.T + 1e-14 * still) @ rng.normal(size=(2, count))
    force[:, 0] = [1, angular] * rng.normal(size=2)
    driven = (force[1] - np.conj(pole) * force[0]) / (pole - np.conj(pole))
    return 2 * lfilter([1], [1, -np.exp(pole / rate_hz)], driven).real


def true_shapes():
    """Lateral first, vertical first and second, shape (3, P, 3)."""
    station = np.linspace(0.1, 0.9, POINTS)
    shapes = np.zeros((3, POINTS, 3))
    shapes[0, :, 0] = np.sin(np.pi * station)
    shapes[1, :, 1] = np.sin(np.pi * station)
    shapes[2, :, 1] = np.sin(2 * np.pi * station)
    return shapes


def vibrate(duration_s=60.0, *, seed=0, moves=True, static=0, frequency_hz=FREQUENCY_HZ, shapes=None):
    """A displacement dataset; the last ``static`` points stand still."""
    rng = np.random.default_rng(seed)
    count = round(RATE_HZ * duration_s)
    values = NOISE_MM * rng.normal(size=(count, POINTS + static, 3))
    for hertz, damping, shape in zip(frequency_hz, DAMPING, true_shapes() if shapes is None else shapes, strict=True):
        modal = oscillate(hertz, damping, count, RATE_HZ, rng) / hertz
        if moves:
            values[:, :POINTS] += modal[:, None, None] * shape
    place = np.zeros((count, POINTS + static, 3))
    place[:, :, 2] = np.linspace(2.0, 28.0, POINTS + static)
    names = [f"p{index}" for index in range(POINTS)] + [f"rest {index}" for index in range(static)]
    return make_displacement(
        np.arange(count) / RATE_HZ,
        names,
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.full(values.shape, NOISE_MM),
            scale_std=np.full(values.shape[1:], 0.01),
            position_m=place,
            reprojection_error_px=np.zeros(values.shape[:2]),
            status=np.zeros(values.shape[:2]),
        ),
        attrs={"frame": "structure"},
    )
