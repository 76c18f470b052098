"""Forces that are scaled so that the virtual structure swings as far as a measured one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.filters import band_pass
from vfm_sdm.studies.synthetic.excitation import BendingMode, ForcedMotion

__all__ = ["PeakToPeak", "compute_peak_to_peak", "scale_to_amplitudes"]

_BAND_HZ = (1.0, 10.0)
"""Band that an accelerometer's double integration leaves [Hz]."""
_RATE_HZ = 240
_SETTLING_S = 3.0
_LARGEST_RATIO = 30.0
_RATIOS = 1201


@dataclass(frozen=True)
class PeakToPeak:
    """How far a cross-section of the structure swings, between 1 and 10 Hz.

    Parameters
    ----------
    axis
        ``lateral`` or ``vertical``.
    station
        Share of the span [1].
    amplitude_mm
        Largest less smallest displacement over the recording [mm].
    """

    axis: str
    station: float
    amplitude_mm: float


def compute_peak_to_peak(motion: ForcedMotion, *, axis: str, station: float, duration_s: float) -> float:
    """Peak-to-peak displacement between 1 and 10 Hz of a cross-section [mm].

    Parameters
    ----------
    motion
        Motion of the structure.
    axis
        ``lateral`` or ``vertical``.
    station
        Share of the span [1].
    duration_s
        End of the interval, which begins at 0 s [s].
    """
    modes, shapes, swing = _swing(motion, axis, [station], duration_s)
    gains = np.array([mode.gain for mode in modes])
    return float(1e3 * np.ptp(swing @ (gains * shapes[0])))


def scale_to_amplitudes(
    motion: ForcedMotion, targets: tuple[PeakToPeak, PeakToPeak], *, duration_s: float
) -> ForcedMotion:
    """The motion with gains of one axis's modes such that two cross-sections swing as far as asked.

    Parameters
    ----------
    motion
        Motion of the structure. Its modes of the targets' axis get new gains: modes with an odd number of half waves a
        common one, those with an even number another.
    targets
        Peak-to-peak amplitudes [mm] at two stations along the same axis.
    duration_s
        Duration of the recording, which starts at 0 s [s].

    Raises
    ------
    DatasetError
        The targets are of different axes, or no gains reach both.

    Notes
    -----
    Displacement is linear in the gains, so that the ratio of both amplitudes depends on the ratio of the gains only.
    The smallest ratio that fits is taken.

    Examples
    --------
    >>> from vfm_sdm.studies.synthetic.pedestrians import Pedestrian
    >>> modes = BendingMode("vertical", 2.3, 19e3), BendingMode("vertical", 6.9, 19e3, half_waves=2)
    >>> people = (Pedestrian("jumping", 75, 2.2, 0.5, 0.4),)
    >>> motion = ForcedMotion(modes, people, support_m=0, span_m=28, duration_s=9)
    >>> targets = PeakToPeak("vertical", 0.25, 9.0), PeakToPeak("vertical", 0.5, 11.0)
    >>> scaled = scale_to_amplitudes(motion, targets, duration_s=6)
    >>> round(compute_peak_to_peak(scaled, axis="vertical", station=0.25, duration_s=6), 3)
    9.0
    """
    first, second = targets
    if first.axis != second.axis:
        raise DatasetError(f"targets: expected one axis, got {first.axis} and {second.axis}; scale one after the other")
    modes, shapes, swing = _swing(motion, first.axis, [first.station, second.station], duration_s)
    even = np.array([mode.half_waves % 2 == 0 for mode in modes])

    def amplitudes(ratio: float) -> FloatArray:
        return np.asarray(1e3 * np.ptp(swing @ (np.where(even, ratio, 1.0) * shapes).T, axis=0))

    def mismatch(ratio: float) -> float:
        found = amplitudes(ratio)
        return float(found[1] * first.amplitude_mm - found[0] * second.amplitude_mm)

    bracket = next(
        (
            pair
            for pair in pairwise(np.linspace(0, _LARGEST_RATIO, _RATIOS))
            if mismatch(pair[0]) * mismatch(pair[1]) <= 0
        ),
        None,
    )
    if bracket is None:
        raise DatasetError(
            f"targets: expected amplitudes that the modes can have, got {first.amplitude_mm} and "
            f"{second.amplitude_mm} mm {first.axis}; change the people, their places or the end restraint"
        )
    ratio = float(brentq(mismatch, *bracket, xtol=1e-12))
    odd_gain = first.amplitude_mm / float(amplitudes(ratio)[0])
    return replace(motion, modes=tuple(_regain(mode, first.axis, odd_gain, ratio) for mode in motion.modes))


def _regain(mode: BendingMode, axis: str, odd_gain: float, ratio: float) -> BendingMode:
    if mode.axis != axis:
        return mode
    return replace(mode, gain=odd_gain * (ratio if mode.half_waves % 2 == 0 else 1.0))


def _swing(
    motion: ForcedMotion, axis: str, stations: Sequence[float], duration_s: float
) -> tuple[tuple[BendingMode, ...], FloatArray, FloatArray]:
    """The axis's M modes, their shapes (S, M) at stations, and coordinates (T, M) between 1 and 10 Hz at gain 1."""
    number = [i for i, mode in enumerate(motion.modes) if mode.axis == axis]
    modes = tuple(motion.modes[i] for i in number)
    plain = replace(motion, modes=tuple(replace(mode, gain=1.0) for mode in modes))
    # The filter rings at both ends of a series: they are put outside the recording where the motion is known there.
    last_s = min(motion.duration_s, duration_s + _SETTLING_S)
    time_s = np.arange(round(-_SETTLING_S * _RATE_HZ), int(last_s * _RATE_HZ)) / _RATE_HZ
    swing = band_pass(plain.modal_coordinates(time_s), _RATE_HZ, _BAND_HZ)
    swing = swing[(time_s >= 0) & (time_s < duration_s)]
    return modes, np.array([[float(mode.shape(np.asarray(s))) for mode in modes] for s in stations]), swing
