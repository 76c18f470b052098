"""Motion of the virtual structure: what every motion offers, and the simplest one, modes that ring down."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.errors import DatasetError

__all__ = ["ModalMotion", "Mode", "Motion", "compute_station", "modal_displacement"]


class Motion(Protocol):
    """Displacement of a structure between two supports at any time, at rest until ``still_s``."""

    @property
    def support_m(self) -> float:
        """Longitudinal coordinate of the first support [m]."""

    @property
    def span_m(self) -> float:
        """Distance from the first support to the second [m]."""

    @property
    def still_s(self) -> float:
        """Time until which the structure is exactly at rest [s]."""

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
        """

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
        """


def compute_station(positions: npt.ArrayLike, *, support_m: float, span_m: float) -> FloatArray:
    """Share of the span at which points lie.

    Parameters
    ----------
    positions
        Points at rest in the world frame, shape (P, 3) [m].
    support_m, span_m
        Longitudinal coordinate of the first support, and distance to the second [m].

    Returns
    -------
    station
        Shape (P,) [1]; 0 and 1 also beyond the supports.

    Raises
    ------
    DatasetError
        The shape is wrong.

    Examples
    --------
    >>> compute_station([[7.0, 0.0, 5.0], [7.0, 0.0, 40.0]], support_m=2.0, span_m=12.0).tolist()
    [0.25, 1.0]
    """
    points = as_float_array(positions, "positions", (None, 3))
    return np.asarray(np.clip((points[:, 2] - support_m) / span_m, 0, 1))


@dataclass(frozen=True)
class Mode:
    """One mode of vibration.

    Parameters
    ----------
    axis
        ``lateral``, ``vertical`` or ``longitudinal``.
    frequency_hz
        Natural frequency [Hz].
    amplitude_mm
        Amplitude without damping where the shape is 1 [mm].
    damping_ratio
        Share of critical damping [1].
    half_waves
        Number n of half waves in the span: shape ``sin(n pi s)`` across the span, ``cos(n pi s)`` along it (n = 0:
        the whole structure slides), with s from 0 to 1 between the supports.

    Raises
    ------
    DatasetError
        The axis is unknown, or a number is out of its range.
    """

    axis: str
    frequency_hz: float
    amplitude_mm: float
    damping_ratio: float = 0.01
    half_waves: int = 1

    def __post_init__(self) -> None:
        if self.axis not in STRUCTURE_AXES:
            raise DatasetError(f"mode: expected an axis of {STRUCTURE_AXES}, got {self.axis!r}; use one of them")
        if not (self.frequency_hz > 0 and 0 <= self.damping_ratio < 1 and self.half_waves >= 0):
            raise DatasetError(
                f"mode: expected frequency > 0, damping in [0, 1) and half waves >= 0, got {self.frequency_hz}, "
                f"{self.damping_ratio} and {self.half_waves}; correct them"
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
        >>> Mode("vertical", 2.0, 5.0).shape(np.array([0.0, 0.5])).tolist()
        [0.0, 1.0]
        """
        angle = self.half_waves * np.pi * station
        return np.cos(angle) if self.axis == "longitudinal" else np.sin(angle)

    def coordinate(self, elapsed_s: FloatArray) -> FloatArray:
        """Modal coordinate, shape (...) [m].

        Parameters
        ----------
        elapsed_s
            Times since the excitation, shape (...) [s].

        Examples
        --------
        >>> Mode("vertical", 2.0, 5.0, damping_ratio=0.0).coordinate(np.array([0.125])).round(6).tolist()
        [0.005]
        """
        omega = 2 * np.pi * self.frequency_hz
        swing = np.sin(omega * np.sqrt(1 - self.damping_ratio**2) * elapsed_s)
        return np.asarray(1e-3 * self.amplitude_mm * np.exp(-self.damping_ratio * omega * elapsed_s) * swing)

    def coordinate_derivative(self, elapsed_s: FloatArray, order: int) -> FloatArray:
        """Derivative of the modal coordinate by time, shape (...) [m/s**order].

        Parameters
        ----------
        elapsed_s
            Times since the excitation, shape (...) [s].
        order
            Order of the derivative.

        Examples
        --------
        >>> mode = Mode("vertical", 2.0, 5.0, damping_ratio=0.0)
        >>> mode.coordinate_derivative(np.array([0.0]), 1).round(4).tolist()
        [0.0628]
        """
        root = 2 * np.pi * self.frequency_hz * complex(-self.damping_ratio, np.sqrt(1 - self.damping_ratio**2))
        return np.asarray(1e-3 * self.amplitude_mm * (root**order * np.exp(root * elapsed_s)).imag)


@dataclass(frozen=True)
class ModalMotion:
    """Motion of a simple span that is at rest first.

    Parameters
    ----------
    modes
        Modes whose motions are added up.
    support_m, span_m
        Longitudinal coordinate of the first support, and distance to the second [m].
    still_s
        Time until which the span is exactly at rest [s].
    onset_s
        Duration of the growth to the full motion [s].

    Raises
    ------
    DatasetError
        The span or the onset is not positive, or the still interval is negative.
    """

    modes: tuple[Mode, ...]
    support_m: float
    span_m: float
    still_s: float = 0.4
    onset_s: float = 0.5

    def __post_init__(self) -> None:
        if not (self.span_m > 0 and self.onset_s > 0 and self.still_s >= 0):
            raise DatasetError(
                f"motion: expected span > 0 m, onset > 0 s and still interval >= 0 s, got {self.span_m}, "
                f"{self.onset_s} and {self.still_s}; correct them"
            )

    def displacement(self, time_s: npt.ArrayLike, positions: npt.ArrayLike) -> FloatArray:
        """Displacement of points of the structure, see `modal_displacement`.

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
        """
        return modal_displacement(time_s, positions, motion=self)

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
            A shape is wrong.

        Notes
        -----
        ``sum_i e_i shape_i (r'' q_i + 2 r' q_i' + r q_i'')``, with the symbols of `modal_displacement`.
        """
        time = as_float_array(time_s, "time_s", (None,))
        station = compute_station(positions, support_m=self.support_m, span_m=self.span_m)
        elapsed = np.maximum(time - self.still_s, 0)
        x = np.minimum(elapsed / self.onset_s, 1)
        ramp = x**3 * (10 + x * (6 * x - 15))
        slope = 30 * x**2 * (1 - x) ** 2 / self.onset_s
        curvature = 60 * x * (1 - x) * (1 - 2 * x) / self.onset_s**2
        acceleration = np.zeros((len(time), len(station), 3))
        for mode in self.modes:
            value, rate, change = (mode.coordinate_derivative(elapsed, order) for order in range(3))
            total = curvature * value + 2 * slope * rate + ramp * change
            acceleration[:, :, STRUCTURE_AXES.index(mode.axis)] += np.outer(total, mode.shape(station))
        return acceleration


def modal_displacement(time_s: npt.ArrayLike, positions: npt.ArrayLike, *, motion: ModalMotion) -> FloatArray:
    """Displacement of points of the structure along the structural axes, shape (T, P, 3) [m].

    Parameters
    ----------
    time_s
        Times, shape (T,) [s].
    positions
        Points at rest in the world frame, shape (P, 3) [m]; only the longitudinal coordinate matters.
    motion
        Modes, supports, and the times of rest and onset.

    Raises
    ------
    DatasetError
        A shape is wrong.

    Notes
    -----
    ``d(t, Z) = sum_i e_i shape_i(Z) r(t) q_i(t)`` with the damped sine q and the ramp
    ``r(x) = 10 x^3 - 15 x^4 + 6 x^5`` over the onset, whose velocity and acceleration begin and end at zero.
    Beyond the supports the shape keeps its end value.

    Examples
    --------
    >>> motion = ModalMotion((Mode("vertical", 2.0, 5.0, damping_ratio=0.0),), support_m=0.0, span_m=12.0)
    >>> (1e3 * modal_displacement([0.0, 1.025], [[7.0, 0.0, 6.0]], motion=motion)[:, 0, 1]).round(3).tolist()
    [0.0, 5.0]
    """
    time = as_float_array(time_s, "time_s", (None,))
    station = compute_station(positions, support_m=motion.support_m, span_m=motion.span_m)
    elapsed = np.maximum(time - motion.still_s, 0)
    x = np.minimum(elapsed / motion.onset_s, 1)
    ramp = x**3 * (10 + x * (6 * x - 15))
    displacement = np.zeros((len(time), len(station), 3))
    for mode in motion.modes:
        axis = STRUCTURE_AXES.index(mode.axis)
        displacement[:, :, axis] += np.outer(ramp * mode.coordinate(elapsed), mode.shape(station))
    return displacement
