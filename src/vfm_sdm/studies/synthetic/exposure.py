"""How much light a frame gets: steps of an automatic exposure, and lamps that flicker with the mains."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError

__all__ = ["ExposureStep", "Flicker", "compute_step_gain"]


@dataclass(frozen=True)
class ExposureStep:
    """A step of a camera's automatic exposure.

    Parameters
    ----------
    time_s
        True time of the first frame after it [s].
    gain
        Light from then on, relative to that of the plan [1].

    Raises
    ------
    DatasetError
        The gain is not positive.
    """

    time_s: float
    gain: float

    def __post_init__(self) -> None:
        if not self.gain > 0:
            raise DatasetError(f"exposure step: expected a gain > 0, got {self.gain}; correct it")


@dataclass(frozen=True)
class Flicker:
    """Light of lamps on the mains.

    Parameters
    ----------
    depth
        Amplitude of the light as a share of its mean [1].
    frequency_hz
        Of the light: twice that of the mains [Hz].

    Raises
    ------
    DatasetError
        The depth is outside 0 to 1, or the frequency is not positive.
    """

    depth: float
    frequency_hz: float = 100.0

    def __post_init__(self) -> None:
        if not (0 <= self.depth <= 1 and self.frequency_hz > 0):
            raise DatasetError(f"flicker: expected a depth in [0, 1] and a frequency > 0 Hz, got {self}; correct them")

    def gain(self, time_s: npt.ArrayLike, exposure_s: float) -> FloatArray:
        """Light of exposures relative to the mean, shape (...) [1].

        Parameters
        ----------
        time_s
            Middles of the exposures, shape (...) [s].
        exposure_s
            Their duration [s].

        Notes
        -----
        The mean of ``1 + depth sin(2 pi f t)`` over the exposure: the amplitude falls by ``sinc(f exposure)``.

        Examples
        --------
        >>> lamp = Flicker(0.2, frequency_hz=100.0)
        >>> lamp.gain([0.0025, 0.0075], 0.0).round(6).tolist(), lamp.gain([0.0025], 0.01).round(6).tolist()
        ([1.2, 0.8], [1.0])
        """
        left = self.depth * np.sinc(self.frequency_hz * exposure_s)
        return np.asarray(1 + left * np.sin(2 * np.pi * self.frequency_hz * np.asarray(time_s, np.float64)))


def compute_step_gain(steps: tuple[ExposureStep, ...], time_s: float) -> float:
    """Gain of the last step before a time [1]; 1 before the first.

    Examples
    --------
    >>> steps = (ExposureStep(2.0, 1.3), ExposureStep(4.0, 0.9))
    >>> [compute_step_gain(steps, time) for time in (1.9, 2.0, 5.0)]
    [1.0, 1.3, 0.9]
    """
    past = [step for step in steps if step.time_s <= time_s]
    return max(past, key=lambda step: step.time_s).gain if past else 1.0
