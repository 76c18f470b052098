"""Response of a footbridge to the people on it: modal equations of motion under moving forces."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PPoly
from scipy.signal import lfilter

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.motion import compute_station
from vfm_sdm.studies.synthetic.pedestrians import Pedestrian

__all__ = ["BendingMode", "ForcedMotion", "integrate_modes"]

_RATE_HZ = 1000
"""Steps of the integration a second."""
_FORCE_AXES = ("lateral", "vertical")


@dataclass(frozen=True)
class BendingMode:
    """One bending mode of a single span.

    Parameters
    ----------
    axis
        ``lateral`` or ``vertical``.
    frequency_hz
        Natural frequency without damping [Hz].
    modal_mass_kg
        Modal mass for a shape whose largest value is about 1; half the mass of the span for pinned ends [kg].
    damping_ratio
        Share of critical damping [1].
    half_waves
        Number n of half waves in the span.
    end_restraint
        0: both ends pinned. 1: both ends held, so that the shape leaves them without a slope [1].
    gain
        Factor on the modal force: how much stronger than by the people alone the mode is driven [1].

    Raises
    ------
    DatasetError
        The axis is unknown, or a number is out of its range.

    Notes
    -----
    ``shape(s) = sin(n pi s) (1 - c + c sin(pi s))`` with s from 0 to 1 between the supports and the restraint c: exact
    for pinned ends, an approximation between pinned and held.
    """

    axis: Literal["lateral", "vertical"]
    frequency_hz: float
    modal_mass_kg: float
    damping_ratio: float = 0.01
    half_waves: int = 1
    end_restraint: float = 0.0
    gain: float = 1.0

    def __post_init__(self) -> None:
        if self.axis not in _FORCE_AXES:
            raise DatasetError(f"mode: expected an axis of {_FORCE_AXES}, got {self.axis!r}; use one of them")
        positive = self.frequency_hz > 0 and self.modal_mass_kg > 0 and self.half_waves >= 1
        if not (positive and 0 <= self.damping_ratio < 1 and 0 <= self.end_restraint <= 1):
            raise DatasetError(
                "mode: expected frequency and mass > 0, half waves >= 1, damping in [0, 1) and restraint in [0, 1], "
                f"got {self.frequency_hz}, {self.modal_mass_kg}, {self.half_waves}, {self.damping_ratio} and "
                f"{self.end_restraint}; correct them"
            )

    def shape(self, station: FloatArray) -> FloatArray:
        """Relative amplitude at places between the supports.

        Parameters
        ----------
        station
            Share of the span, from 0 at the first support to 1 at the second, shape (...) [1].

        Returns
        -------
        amplitude
            Shape (...) [1].

        Examples
        --------
        >>> BendingMode("vertical", 2.3, 19e3).shape(np.array([0.0, 0.5, 1.0])).round(6).tolist()
        [0.0, 1.0, 0.0]
        """
        ends = 1 - self.end_restraint * (1 - np.sin(np.pi * station))
        return np.asarray(np.sin(self.half_waves * np.pi * station) * ends)

    @property
    def end_slope(self) -> float:
        """Derivative of the shape by the share of the span at the first support [1]."""
        return self.half_waves * np.pi * (1 - self.end_restraint)


def integrate_modes(force: FloatArray, modes: tuple[BendingMode, ...], *, step_s: float) -> FloatArray:
    """Modal coordinates with their first two derivatives, starting from rest.

    Parameters
    ----------
    force
        Modal forces at times ``k step_s``, linear in between, shape (T, M) [N].
    modes
        M modes.
    step_s
        Length of a step [s].

    Returns
    -------
    coordinates
        Values, velocities and accelerations, shape (3, T, M) [m, m/s, m/s2].

    Notes
    -----
    ``q'' + 2 zeta omega q' + omega^2 q = gain f / m = u`` is one complex equation of first order: with
    ``lambda = omega (-zeta + i sqrt(1 - zeta^2))`` and ``y = q' - conj(lambda) q`` it reads ``y' = lambda y + u``. For
    a force that is linear within a step h its solution is exactly ``y[k+1] = e^z y[k] + h (phi1 - phi2) u[k] +
    h phi2 u[k+1]`` with ``z = lambda h``, ``phi1 = (e^z - 1) / z`` and ``phi2 = (phi1 - 1) / z``.

    Examples
    --------
    >>> mode = BendingMode("vertical", 1.0, 1000.0, damping_ratio=0.7)
    >>> q = integrate_modes(np.full((5000, 1), 100.0), (mode,), step_s=0.002)
    >>> static_m = 100.0 / (1000.0 * (2 * np.pi) ** 2)
    >>> round(float(q[0, -1, 0] / static_m), 4)
    1.0
    """
    result = np.zeros((3, *force.shape))
    for number, mode in enumerate(modes):
        omega, zeta = 2 * np.pi * mode.frequency_hz, mode.damping_ratio
        load = mode.gain * force[:, number] / mode.modal_mass_kg
        root = omega * complex(-zeta, np.sqrt(1 - zeta**2))
        z = root * step_s
        phi1 = np.expm1(z) / z
        phi2 = (phi1 - 1) / z
        # The initial state makes y[0] = 0 whatever the first force is.
        y, _ = lfilter([step_s * phi2, step_s * (phi1 - phi2)], [1, -np.exp(z)], load, zi=[-step_s * phi2 * load[0]])
        value = y.imag / root.imag
        rate = y.real + root.real * value
        result[:, :, number] = value, rate, load - 2 * zeta * omega * rate - omega**2 * value
    return result


@dataclass(frozen=True)
class ForcedMotion:
    """Motion of a single span under people who first stand, then walk, run or jump.

    Parameters
    ----------
    modes
        Bending modes, lateral and vertical.
    people
        People on the deck, each of whom stands at a place until an own start.
    support_m, span_m
        Longitudinal coordinate of the first support, and distance to the second [m].
    duration_s
        Time until which the motion is known [s].
    neutral_axis_m
        Height of the neutral axis of bending above the bearings, which makes the structure slide on them [m].

    Raises
    ------
    DatasetError
        The span or the duration is not positive, or there is no mode or nobody on the bridge.

    Notes
    -----
    Displacement is from the state of rest under the people's weight, so that somebody who moves along the bridge
    changes the deflection slowly too. Longitudinally the first bearing is fixed: where vertical bending turns the end
    by ``sum_n shape_n'(0) q_n / span``, the whole structure slides by the rotation times ``neutral_axis_m``.

    Within an integration step each modal coordinate is the polynomial of fifth order that has the exact value,
    velocity and acceleration at both of its ends.
    """

    modes: tuple[BendingMode, ...]
    people: tuple[Pedestrian, ...]
    support_m: float
    span_m: float
    duration_s: float
    neutral_axis_m: float = 0.3

    def __post_init__(self) -> None:
        if not (self.span_m > 0 and self.duration_s > 0 and self.modes and self.people):
            raise DatasetError(
                f"motion: expected span > 0 m, duration > 0 s, modes and people, got {self.span_m}, {self.duration_s}, "
                f"{len(self.modes)} modes and {len(self.people)} people; correct them"
            )

    @property
    def still_s(self) -> float:
        """Time until which the structure is exactly at rest [s]."""
        return min(person.start_s for person in self.people)

    def displacement(self, time_s: npt.ArrayLike, positions: npt.ArrayLike) -> FloatArray:
        """Displacement of points of the structure.

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].
        positions
            Points at rest in the world frame, shape (P, 3) [m].

        Returns
        -------
        displacement
            Displacement along the structural axes, shape (T, P, 3) [m].

        Raises
        ------
        DatasetError
            A shape is wrong, or a time is after ``duration_s``.
        """
        return self._evaluate(time_s, positions, 0)

    def velocity(self, time_s: npt.ArrayLike, positions: npt.ArrayLike) -> FloatArray:
        """First derivative of the displacement by time.

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].
        positions
            Points at rest in the world frame, shape (P, 3) [m].

        Returns
        -------
        velocity
            Velocity along the structural axes, shape (T, P, 3) [m/s].

        Raises
        ------
        DatasetError
            A shape is wrong, or a time is after ``duration_s``.
        """
        return self._evaluate(time_s, positions, 1)

    def acceleration(self, time_s: npt.ArrayLike, positions: npt.ArrayLike) -> FloatArray:
        """Second derivative of the displacement by time.

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].
        positions
            Points at rest in the world frame, shape (P, 3) [m].

        Returns
        -------
        acceleration
            Acceleration along the structural axes, shape (T, P, 3) [m/s2].

        Raises
        ------
        DatasetError
            A shape is wrong, or a time is after ``duration_s``.
        """
        return self._evaluate(time_s, positions, 2)

    def modal_coordinates(self, time_s: npt.ArrayLike, *, derivative: int = 0) -> FloatArray:
        """Modal coordinates, or their derivatives by time.

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].
        derivative
            Order of the derivative.

        Returns
        -------
        coordinates
            Shape (T, M) [m/s**derivative], for M modes.

        Raises
        ------
        DatasetError
            A shape is wrong, or a time is after ``duration_s``.

        Examples
        --------
        >>> mode = BendingMode("vertical", 2.3, 19e3)
        >>> people = (Pedestrian("jumping", 75, 2.2, 0.5, 0.4),)
        >>> motion = ForcedMotion((mode,), people, support_m=0, span_m=28, duration_s=2)
        >>> motion.modal_coordinates([0.0, 0.5]).tolist()
        [[0.0], [0.0]]
        """
        time = as_float_array(time_s, "time_s", (None,))
        if not np.all(time <= self.duration_s):
            raise DatasetError(
                f"time_s: expected times up to {self.duration_s} s, got {time.max(initial=-np.inf)}; "
                "make the motion longer"
            )
        values = self._response(np.maximum(time, 0), nu=derivative)
        return np.asarray(np.where(time[:, None] > self.still_s, values, 0.0))

    def _evaluate(self, time_s: npt.ArrayLike, positions: npt.ArrayLike, derivative: int) -> FloatArray:
        station = compute_station(positions, support_m=self.support_m, span_m=self.span_m)
        values = self.modal_coordinates(time_s, derivative=derivative)
        result = np.zeros((len(values), len(station), 3))
        for number, mode in enumerate(self.modes):
            result[:, :, STRUCTURE_AXES.index(mode.axis)] += np.outer(values[:, number], mode.shape(station))
            if mode.axis == "vertical":
                slide = self.neutral_axis_m * mode.end_slope / self.span_m
                result[:, :, STRUCTURE_AXES.index("longitudinal")] += slide * values[:, number, None]
        return result

    @cached_property
    def _response(self) -> PPoly:
        """Modal coordinates as functions of time, from 0 s to a step beyond the end."""
        step = 1 / _RATE_HZ
        time = np.arange(int(np.ceil(self.duration_s * _RATE_HZ)) + 2, dtype=np.float64) * step
        force = np.zeros((len(time), len(self.modes)))
        for person in self.people:
            acting = person.force(time)
            station = person.stations(time, span_m=self.span_m)
            for number, mode in enumerate(self.modes):
                # Less the force of the person's weight at rest.
                modal = acting[:, _FORCE_AXES.index(mode.axis)] * mode.shape(station)
                force[:, number] += modal - modal[0]
        return _hermite(time, integrate_modes(force, self.modes, step_s=step))


def _hermite(time: FloatArray, values: FloatArray) -> PPoly:
    """Piecewise quintic through values and their first two derivatives, shape (3, T, M), at equal steps."""
    h = time[1] - time[0]
    q, v, a = values[0], values[1] * h, values[2] * h**2 / 2
    # What the parabola at the left end misses at the right end, in value, slope and half curvature.
    d0 = q[1:] - (q + v + a)[:-1]
    d1 = v[1:] - (v + 2 * a)[:-1]
    d2 = a[1:] - a[:-1]
    coefficients = np.stack(
        [6 * d0 - 3 * d1 + d2, 7 * d1 - 15 * d0 - 2 * d2, 10 * d0 - 4 * d1 + d2, a[:-1], v[:-1], q[:-1]]
    )
    powers = h ** np.arange(5, -1, -1.0)
    return PPoly(coefficients / powers[:, None, None], time)
