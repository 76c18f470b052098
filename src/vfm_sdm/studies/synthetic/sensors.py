"""A virtual tri-axial accelerometer on the virtual structure, with the faults of a real one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import constants
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.core.files import write_file
from vfm_sdm.errors import DatasetError

__all__ = ["Accelerometer", "write_acceleration"]

_REST_G = (0.0, -1.0, 0.0)
"""Reading of a sensor at rest along lateral, vertical (down) and longitudinal: its support pushes it upwards."""


@dataclass(frozen=True)
class Accelerometer:
    """A MEMS accelerometer with its own clock, fixed to the structure.

    Parameters
    ----------
    name
        Name of the sensor in the session.
    rate_hz
        Samples a second of the sensor's own clock [Hz].
    noise_g_per_sqrt_hz
        Spectral density of its white noise [g/sqrt(Hz)]; a sample's standard deviation is that times
        ``sqrt(rate_hz / 2)``. 25e-6 is typical of a low-noise MEMS.
    bias_g
        Constant error along each of its axes [g].
    misalignment_deg
        Small rotation of its housing about lateral, vertical and longitudinal, as a rotation vector [deg].
    clock_offset_s
        True time at which the sensor's clock reads zero [s].
    clock_rate
        Seconds of the sensor's clock in a true second [1].
    spikes_per_minute, spike_g
        Mean number of single wrong samples on each axis, and their size with either sign [g].

    Raises
    ------
    DatasetError
        A number is out of its range.

    Notes
    -----
    An accelerometer measures acceleration less gravity: at rest the vertical axis, positive down, reads -1 g, and a
    downward acceleration counts positive.

    Sample i has the stamp ``i / rate_hz`` and is taken at the true time ``clock_offset_s + stamp / clock_rate``. An
    event thus has a stamp ``clock_offset_s`` smaller than its true time: to the views, the sensor lags by
    ``-clock_offset_s``.
    """

    name: str
    rate_hz: float = 64.0
    noise_g_per_sqrt_hz: float = 25e-6
    bias_g: tuple[float, float, float] = (0.0, 0.0, 0.0)
    misalignment_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clock_offset_s: float = 0.0
    clock_rate: float = 1.0
    spikes_per_minute: float = 0.0
    spike_g: float = 0.5

    def __post_init__(self) -> None:
        if not (self.rate_hz > 0 and self.clock_rate > 0):
            raise DatasetError(
                f"accelerometer: expected rate_hz and clock_rate > 0, got {self.rate_hz} and {self.clock_rate}"
            )
        if not (self.noise_g_per_sqrt_hz >= 0 and self.spikes_per_minute >= 0 and self.spike_g >= 0):
            raise DatasetError(
                f"accelerometer: expected noise, spike rate and spike size >= 0, got {self.noise_g_per_sqrt_hz}, "
                f"{self.spikes_per_minute} and {self.spike_g}"
            )

    def true_time(self, stamp_s: FloatArray) -> FloatArray:
        """True time of stamps of the sensor's clock, shape (...) [s].

        Parameters
        ----------
        stamp_s
            Stamps on the sensor's clock, shape (...) [s].

        Examples
        --------
        >>> Accelerometer("midspan", clock_offset_s=-2.0).true_time(np.array([0.0, 1.0])).tolist()
        [-2.0, -1.0]
        """
        return np.asarray(self.clock_offset_s + stamp_s / self.clock_rate)


def write_acceleration(
    path: Path | str,
    accelerometer: Accelerometer,
    acceleration_of: Callable[[FloatArray], FloatArray],
    *,
    duration_s: float,
    seed: int,
) -> Path:
    """Writes the recording of an accelerometer as CSV and returns the path.

    Parameters
    ----------
    path
        File with the columns ``time`` [s], ``lateral``, ``vertical``, ``longitudinal`` [g]; whole or not at all.
    accelerometer
        The sensor.
    acceleration_of
        Acceleration of the structure where it sits: true times (T,) [s] to (T, 3) [m/s2] along the structural axes.
    duration_s
        Duration of the recording on the sensor's clock [s].
    seed
        Seed of noise and spikes; the same seed gives the same bytes.

    Raises
    ------
    DatasetError
        The duration holds less than two samples, or the acceleration has another shape or is not finite.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> def at_rest(time_s):
    ...     return np.zeros((len(time_s), 3))
    >>> with TemporaryDirectory() as folder:
    ...     file = write_acceleration(f"{folder}/acc.csv", Accelerometer("acc"), at_rest, duration_s=1.0, seed=0)
    ...     print(file.read_text().splitlines()[0])
    time,lateral,vertical,longitudinal
    """
    samples = round(duration_s * accelerometer.rate_hz) if np.isfinite(duration_s) else 0
    if samples < 2:
        raise DatasetError(
            f"duration_s: expected two samples at {accelerometer.rate_hz:g} Hz or more, got {duration_s} s; lengthen it"
        )
    stamps = np.arange(samples) / accelerometer.rate_hz
    motion = as_float_array(
        acceleration_of(accelerometer.true_time(stamps)), "acceleration_of", (samples, len(STRUCTURE_AXES))
    )
    if not np.isfinite(motion).all():
        raise DatasetError("acceleration_of: expected finite m/s2, got NaN or infinity; correct the motion")
    reading = _reading(accelerometer, motion / constants.g, np.random.default_rng(seed))
    lines = [",".join(["time", *STRUCTURE_AXES])]
    lines += [
        f"{stamp:.9f}," + ",".join(f"{value:.9f}" for value in row) for stamp, row in zip(stamps, reading, strict=True)
    ]
    return write_file(path, "\n".join(lines) + "\n")


def _reading(accelerometer: Accelerometer, motion_g: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Reading of the sensor along its own axes, shape (T, 3) [g]."""
    structure_from_sensor = Rotation.from_rotvec(accelerometer.misalignment_deg, degrees=True).as_matrix()
    force = (motion_g + np.array(_REST_G)) @ structure_from_sensor
    noise_std = accelerometer.noise_g_per_sqrt_hz * np.sqrt(accelerometer.rate_hz / 2)
    noise = noise_std * rng.standard_normal(force.shape)
    hit = rng.random(force.shape) < accelerometer.spikes_per_minute / (60 * accelerometer.rate_hz)
    spikes = hit * accelerometer.spike_g * np.where(rng.random(force.shape) < 0.5, -1.0, 1.0)
    return np.asarray(force + np.array(accelerometer.bias_g) + noise + spikes)
