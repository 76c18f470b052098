"""Forces of people who walk, run or jump on a footbridge."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError

__all__ = ["Gait", "Pedestrian"]

Gait = Literal["walking", "running", "jumping"]

_GAITS = ("walking", "running", "jumping")
GRAVITY = 9.81
"""Acceleration of a falling body [m/s2]."""
_LATERAL_WALKING = (0.039, 0.010, 0.043, 0.012, 0.015)
"""Amplitudes of the first harmonics of half the pacing rate, as shares of the weight."""
_LATERAL_PULSE = {"running": 0.06, "jumping": 0.03}
"""Lateral pulse as a share of the vertical one."""
_ONSET_S = 0.5


@dataclass(frozen=True)
class Pedestrian:
    """One person on the deck, who stands still first.

    Parameters
    ----------
    gait
        ``walking``, ``running`` or ``jumping``.
    mass_kg
        Body mass [kg].
    rate_hz
        Mean pacing or jumping rate, steps of either foot a second [Hz].
    start_s
        Time until which the person stands [s].
    station
        Place where the person stands first, as a share of the span [1].
    speed_m_s
        Speed along the bridge, negative towards the first support; the person turns round at the ends [m/s].
    contact_ratio
        Share of a step's duration for which the feet are on the deck; of no meaning when walking [1].
    rate_variation, force_variation
        Standard deviations of a step's duration and of its force, as shares of their means [1].
    seed
        Seed of phases and variations.

    Raises
    ------
    DatasetError
        The gait is unknown, or a number is out of its range.

    Notes
    -----
    Walking is a Fourier series in the phase of the steps; vertical amplitudes are the mean values of [1]_, lateral ones
    those of H. Schulze, at half the pacing rate, both as listed in [2]_.

    Running and jumping are a half sine while there is contact, of height ``weight pi / (2 contact_ratio)``, so that the
    mean force is the weight [3]_. The lateral pulse is an assumption: a small share of the vertical one, to the other
    side with every step of a runner and to a random side with every jump.

    Variations are independent from step to step.

    References
    ----------
    .. [1] Young, P. (2001). Improved floor vibration prediction methodologies. ARUP Vibration Seminar.
    .. [2] Zivanovic, S., Pavic, A., Reynolds, P. (2005). Vibration serviceability of footbridges under human-induced
       excitation: a literature review. Journal of Sound and Vibration 279(1-2), 1-74.
    .. [3] Bachmann, H., Ammann, W. (1987). Vibrations in Structures. IABSE Structural Engineering Documents 3e.
    """

    gait: Gait
    mass_kg: float
    rate_hz: float
    start_s: float
    station: float
    speed_m_s: float = 0.0
    contact_ratio: float = 0.5
    rate_variation: float = 0.03
    force_variation: float = 0.08
    seed: int = 0

    def __post_init__(self) -> None:
        if self.gait not in _GAITS:
            raise DatasetError(f"pedestrian: expected a gait of {_GAITS}, got {self.gait!r}; use one of them")
        positive = self.mass_kg > 0 and self.rate_hz > 0 and 0 < self.contact_ratio <= 1
        if not (positive and self.start_s >= 0 and 0 <= self.station <= 1):
            raise DatasetError(
                "pedestrian: expected mass and rate > 0, a contact ratio in (0, 1], a start >= 0 s and a station in "
                f"[0, 1], got {self.mass_kg}, {self.rate_hz}, {self.contact_ratio}, {self.start_s} and {self.station}; "
                "correct them"
            )
        # Beyond a third of the mean a step could take no time at all.
        if not (0 <= self.rate_variation <= 0.3 and 0 <= self.force_variation <= 0.3):
            raise DatasetError(
                f"pedestrian: expected variations in [0, 0.3], got {self.rate_variation} and {self.force_variation}; "
                "correct them"
            )

    @property
    def weight_n(self) -> float:
        """Body weight [N]."""
        return self.mass_kg * GRAVITY

    def stations(self, time_s: FloatArray, *, span_m: float) -> FloatArray:
        """Places of the person, as shares of the span, shape (T,) [1].

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].
        span_m
            Distance between the supports [m].

        Examples
        --------
        >>> person = Pedestrian("walking", 75, 1.9, start_s=1.0, station=0.5, speed_m_s=1.4)
        >>> person.stations(np.array([0.0, 11.0]), span_m=28.0).round(6).tolist()
        [0.5, 1.0]
        """
        walked = self.station + self.speed_m_s * np.maximum(time_s - self.start_s, 0) / span_m
        # A triangle wave: up to 1, back to 0.
        return np.asarray(1 - np.abs(walked % 2 - 1))

    def force(self, time_s: FloatArray) -> FloatArray:
        """Lateral and vertical (down) force of the person on the deck.

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].

        Returns
        -------
        force
            Shape (T, 2) [N].

        Notes
        -----
        The force of standing, which is the weight, changes into that of the steps within half a second.

        Examples
        --------
        >>> person = Pedestrian("walking", 75, 1.9, start_s=1.0, station=0.5, speed_m_s=1.4)
        >>> person.force(np.array([0.5])).round(2).tolist()
        [[0.0, 735.75]]
        """
        elapsed = np.maximum(time_s - self.start_s, 0)
        # One stream for each, so that a later time, which needs more steps, leaves the earlier steps as they are.
        lengths, strengths, rest = (np.random.default_rng([self.seed, stream]) for stream in range(3))
        steps = 2 + int(np.ceil(1.5 * self.rate_hz * float(elapsed.max(initial=0))))
        duration = (1 + self.rate_variation * np.clip(lengths.standard_normal(steps), -3, 3)) / self.rate_hz
        begin = np.concatenate([[0.0], np.cumsum(duration)])
        strength = 1 + self.force_variation * np.clip(strengths.standard_normal(steps + 1), -3, 3)
        number = np.clip(np.searchsorted(begin, elapsed, side="right") - 1, 0, steps - 1)
        share = (elapsed - begin[number]) / duration[number]
        if self.gait == "walking":
            # From step to step the strength goes over gradually, for the feet overlap.
            gradual = (1 - share) * strength[number] + share * strength[number + 1]
            moving = _walking(number + share, self.rate_hz, rest) * gradual[:, None]
        else:
            side = np.where(np.arange(steps) % 2 == 0, 1.0, -1.0)
            if self.gait == "jumping":
                side = np.where(rest.random(steps) < 0.5, 1.0, -1.0)
            pulse = _pulse(share, self.contact_ratio) * strength[number]
            moving = np.column_stack([_LATERAL_PULSE[self.gait] * side[number] * pulse, pulse - 1])
        x = np.minimum(elapsed / _ONSET_S, 1)
        ramp = x**2 * (3 - 2 * x)
        return np.asarray(self.weight_n * (ramp[:, None] * moving + np.array([0.0, 1.0])))


def _walking(steps: FloatArray, rate_hz: float, rng: np.random.Generator) -> FloatArray:
    """Lateral force, and vertical force beyond the weight, as shares of the weight, shape (T, 2) [1].

    Parameters
    ----------
    steps
        Phase: number of steps since the start, with fractions, shape (T,) [1].
    """
    first = float(np.clip(0.37 * (rate_hz - 0.95), 0, 0.5))
    # Young's higher harmonics are linear in the harmonic's own frequency.
    higher = (0.054 + 0.0044 * 2 * rate_hz, 0.026 + 0.0050 * 3 * rate_hz, 0.010 + 0.0051 * 4 * rate_hz)
    vertical = _harmonics(2 * np.pi * steps, (first, *higher), rng)
    return np.column_stack([_harmonics(np.pi * steps, _LATERAL_WALKING, rng), vertical])


def _harmonics(phase: FloatArray, amplitudes: tuple[float, ...], rng: np.random.Generator) -> npt.NDArray[np.float64]:
    orders = np.arange(1, len(amplitudes) + 1)
    shifts = rng.uniform(0, 2 * np.pi, len(amplitudes))
    return np.asarray(np.sin(np.outer(phase, orders) + shifts) @ np.asarray(amplitudes))


def _pulse(share: FloatArray, contact_ratio: float) -> FloatArray:
    """Half sine over the first part of a step, with mean 1 over the whole, shape (T,) [1]."""
    contact = np.sin(np.pi * np.minimum(share / contact_ratio, 1))
    return np.asarray(np.pi / (2 * contact_ratio) * contact)
