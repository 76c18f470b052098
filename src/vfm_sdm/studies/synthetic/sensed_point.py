"""A point as a video and an accelerometer record it, without pictures: for studies of their fusion."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.signal import lfilter

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement
from vfm_sdm.core.sensor_datasets import make_acceleration

__all__ = ["STATIC", "SensedPoint", "record_point"]

STATIC = ("s0", "s1", "s2")
"""Points of the video that do not move."""
_MODES = ((1.7, 0.6), (4.3, 0.25), (11.0, 0.08), (23.0, 0.03), (38.0, 0.015))
"""Frequencies [Hz] and amplitudes [mm] along vertical; along lateral half of these."""
_PASSAGE_MM = 1.0
_LEAD_S = 1.0
"""How much longer than the video the sensor records, on either side [s]."""
_STEP_S = 1e-4
_GRAVITY = 9.80665


@dataclass(frozen=True)
class SensedPoint:
    """What is recorded, and how well.

    Parameters
    ----------
    duration_s, fps, rate_hz
        Length and frames a second of the video, and samples a second of the sensor [s, Hz].
    video_std_mm
        What differs from frame to frame [mm].
    slow_share, slow_s
        Standard deviation of the video's slow error over that [1], and its correlation time [s].
    exposure_s
        Exposure [s].
    sensor_noise
        Density of the sensor's noise [m/s2/sqrt(Hz)], two-sided.
    gain, misalignment
        Of the sensor: its sensitivity over the true one, and the share of lateral acceleration in vertical [1].
    lag_s, clock_rate
        How much later the sensor's clock shows an event at time zero [s], and its seconds in a true one [1].
    gap_s
        Interval without values of the video [s].
    """

    duration_s: float = 60.0
    fps: float = 30.0
    rate_hz: float = 200.0
    video_std_mm: float = 0.05
    slow_share: float = 0.3
    slow_s: float = 2.0
    exposure_s: float = 1 / 60
    sensor_noise: float = 3e-4
    gain: float = 1.02
    misalignment: float = 0.02
    lag_s: float = 0.7
    clock_rate: float = 1.00002
    gap_s: tuple[float, float] | None = None


def record_point(what: SensedPoint, seed: int) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """The records of a point ``mid`` that five modes and a passage move, and the truth.

    Parameters
    ----------
    what
        What is recorded.
    seed
        Of motion and noise.

    Returns
    -------
    displacement, acceleration, truth
        Displacement dataset of ``mid`` and `STATIC`, shape (T, 4, 3) [mm]; acceleration of sensor ``phone`` along
        lateral and vertical [m/s2]; and ``displacement`` (time, axis) [mm] at the true times of the sensor's samples.
    """
    rng = np.random.default_rng(seed)
    frequency, amplitude = np.array(_MODES).T
    amplitude = amplitude * rng.uniform(0.5, 1.5, (2, len(frequency)))
    phase, drift, drift_phase = (
        rng.uniform(low, high, (2, len(frequency))) for low, high in ((0, 6.3), (0.05, 0.2), (0, 6.3))
    )

    def motion(time_s: FloatArray) -> FloatArray:
        """Along lateral and vertical, shape (T, 2) [mm]."""
        t = np.asarray(time_s, np.float64)[:, None, None]
        wander = 2.5 * np.sin(2 * np.pi * drift * t + drift_phase)
        waves = np.sum(amplitude * np.sin(2 * np.pi * frequency * t + phase + wander), axis=-1)
        passage = _PASSAGE_MM * np.exp(-0.5 * ((t[..., 0] - what.duration_s / 2) / 3) ** 2)
        return np.asarray((waves + passage) * [0.5, 1.0])

    frames = np.arange(round(what.duration_s * what.fps)) / what.fps
    node, weight = np.polynomial.legendre.leggauss(12)
    shown = sum(w / 2 * motion(frames + n * what.exposure_s / 2) for n, w in zip(node, weight, strict=True))
    values = np.zeros((len(frames), 1 + len(STATIC), 3))
    values[:, 0, :2] = shown
    values += what.video_std_mm * (
        rng.standard_normal(values.shape) + what.slow_share * _wander(what, values.shape, rng)
    )
    status = np.zeros(values.shape[:2], np.int8)
    if what.gap_s is not None:
        status[(frames > what.gap_s[0]) & (frames < what.gap_s[1]), 0] = Status.LOST
        values[status == Status.LOST] = np.nan
    stamps = np.arange(round((what.duration_s + 2 * _LEAD_S) * what.rate_hz)) / what.rate_hz
    times = -_LEAD_S + stamps / what.clock_rate
    bent = (motion(times + _STEP_S) - 2 * motion(times) + motion(times - _STEP_S)) / _STEP_S**2 / 1e3
    felt = what.gain * bent
    felt[:, 1] += what.misalignment * bent[:, 0] - _GRAVITY
    felt += what.sensor_noise * np.sqrt(what.rate_hz) * rng.standard_normal(felt.shape)
    acceleration = make_acceleration(
        stamps - _LEAD_S + what.lag_s, ["phone"], STRUCTURE_AXES[:2], felt[:, None], sampling_rate_hz=what.rate_hz
    )
    truth = xr.Dataset(
        {"displacement": (("time", "axis"), motion(times), {"units": "mm"})},
        coords={"time": times, "axis": list(STRUCTURE_AXES[:2])},
    )
    return _make_video(frames, values, status, what), acceleration, truth


def _wander(what: SensedPoint, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Slow errors of unit variance, shape (T, P, 3)."""
    keep = np.exp(-1 / (what.slow_s * what.fps))
    driven = np.sqrt(1 - keep**2) * rng.standard_normal(shape)
    driven[0] = rng.standard_normal(shape[1:])
    return np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0))


def _make_video(frames: FloatArray, values: FloatArray, status: np.ndarray, what: SensedPoint) -> xr.Dataset:
    arrays = DisplacementArrays(
        displacement_mm=values,
        displacement_std_mm=np.full(values.shape, what.video_std_mm),
        scale_std=np.full(values.shape[1:], 0.01),
        position_m=np.zeros(values.shape),
        reprojection_error_px=np.zeros(values.shape[:2]),
        status=status,
    )
    return make_displacement(frames, ["mid", *STATIC], STRUCTURE_AXES, arrays, attrs={"frame": "structure"})
