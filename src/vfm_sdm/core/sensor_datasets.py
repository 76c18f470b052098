"""The labelled datasets of sensors: acceleration, and the reference displacement that is made of it.

A sensor's own clock, even: dims ``time, sensor, axis``; ``acceleration`` [m/s2] or ``displacement`` [mm]; attribute
``sampling_rate_hz``, and of a reference ``onset_s`` (NaN before it) and ``band_hz`` (what it can show).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import clock_departure
from vfm_sdm.core.dataset_checks import check_clock, check_variable
from vfm_sdm.errors import DatasetError

__all__ = [
    "ACCELERATION_UNITS",
    "SENSOR_UNITS",
    "ReferenceFacts",
    "SensorUnits",
    "check_acceleration",
    "check_reference",
    "make_acceleration",
    "make_reference",
]

SensorUnits = Literal["g", "mg", "m/s2", "cm/s2", "mm/s2", "mm", "m", "cm", "um"]
"""Units that a recording of a sensor may have: accelerations, then displacements."""
SENSOR_UNITS: tuple[str, ...] = get_args(SensorUnits)
ACCELERATION_UNITS = SENSOR_UNITS[: SENSOR_UNITS.index("mm")]
_SENSOR_DIMS = ("time", "sensor", "axis")
_UNEVEN = 0.01
"""Share of the sampling interval by which a time stamp of a sensor's clock may be off: its stamps are computed from the
rate, so that only the digits of a stated rate can part them."""


def make_acceleration(
    time_s: npt.ArrayLike,
    sensors: Sequence[str],
    axes: Sequence[str],
    acceleration: npt.ArrayLike,
    *,
    sampling_rate_hz: float,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Acceleration of sensors that share a clock.

    Parameters
    ----------
    time_s
        The sensors' clock, ``t0 + i / sampling_rate_hz``, shape (T,) [s].
    sensors, axes
        Names, lengths S and A.
    acceleration
        Acceleration with gravity and bias, shape (T, S, A) [m/s2].
    sampling_rate_hz
        Samples a second of that clock [Hz].
    attrs
        Other facts about the values.

    Raises
    ------
    DatasetError
        Shapes disagree, or the clock is not even.

    Examples
    --------
    >>> acceleration = make_acceleration([0.0, 0.01], ["a"], ["vertical"], np.zeros((2, 1, 1)), sampling_rate_hz=100)
    >>> acceleration["acceleration"].shape
    (2, 1, 1)
    """
    coords = _sensor_coords(time_s, sensors, axes)
    signal = {"acceleration": (_SENSOR_DIMS, np.asarray(acceleration, np.float64), {"units": "m/s2"})}
    try:
        dataset = xr.Dataset(signal, coords, {"sampling_rate_hz": float(sampling_rate_hz), **(attrs or {})})
    except ValueError as error:
        raise DatasetError(f"acceleration: expected shape (time, sensor, axis); {error}") from error
    return check_acceleration(dataset)


@dataclass(frozen=True)
class ReferenceFacts:
    """What must be known of a reference displacement.

    Parameters
    ----------
    sampling_rate_hz
        Samples a second of the sensors' clock [Hz].
    onset_s
        Time on the clock at which the evaluated motion begins [s].
    band_hz
        Frequencies that the sensors' displacement can show [Hz].
    """

    sampling_rate_hz: float
    onset_s: float
    band_hz: tuple[float, float]


def make_reference(
    time_s: npt.ArrayLike,
    sensors: Sequence[str],
    axes: Sequence[str],
    displacement_mm: npt.ArrayLike,
    *,
    facts: ReferenceFacts,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Displacement of reference sensors that share a clock.

    Parameters
    ----------
    time_s
        The sensors' clock, ``t0 + i / sampling_rate_hz``, shape (T,) [s].
    sensors, axes
        Names, lengths S and A.
    displacement_mm
        Displacement, shape (T, S, A) [mm]; NaN before the onset.
    facts
        Sampling rate [Hz], onset [s] and band [Hz].
    attrs
        Other facts about the values.

    Raises
    ------
    DatasetError
        Shapes disagree, or the clock is not even.

    Examples
    --------
    >>> facts = ReferenceFacts(sampling_rate_hz=10, onset_s=0, band_hz=(1, 5))
    >>> reference = make_reference([0.0, 0.1], ["a"], ["vertical"], np.zeros((2, 1, 1)), facts=facts)
    >>> reference.attrs["band_hz"]
    [1, 5]
    """
    coords = _sensor_coords(time_s, sensors, axes)
    signal = {"displacement": (_SENSOR_DIMS, np.asarray(displacement_mm, np.float64), {"units": "mm"})}
    known = {
        "sampling_rate_hz": float(facts.sampling_rate_hz),
        "onset_s": float(facts.onset_s),
        "band_hz": list(facts.band_hz),
    }
    try:
        dataset = xr.Dataset(signal, coords, {**known, **(attrs or {})})
    except ValueError as error:
        raise DatasetError(f"reference: expected shape (time, sensor, axis); {error}") from error
    return check_reference(dataset)


def check_acceleration(acceleration: xr.Dataset) -> xr.Dataset:
    """The acceleration as given, after checking dims, units and clock.

    Parameters
    ----------
    acceleration
        Acceleration dataset, shape (T, S, A) [m/s2].

    Raises
    ------
    DatasetError
        The variable is missing, or has other dims or units; the clock is not even.
    """
    check_variable(acceleration, "acceleration", _SENSOR_DIMS, "m/s2")
    _check_even_clock(acceleration)
    return acceleration


def check_reference(reference: xr.Dataset) -> xr.Dataset:
    """The reference displacement as given, after checking dims, units, clock and attributes.

    Parameters
    ----------
    reference
        Reference dataset, shape (T, S, A) [mm].

    Raises
    ------
    DatasetError
        The variable or an attribute is missing, or has other dims or units; the clock is not even.
    """
    check_variable(reference, "displacement", _SENSOR_DIMS, "mm")
    _check_even_clock(reference)
    missing = [name for name in ("onset_s", "band_hz") if name not in reference.attrs]
    if missing:
        raise DatasetError(f"reference: expected attributes onset_s and band_hz, missing {missing}; set them")
    return reference


def _check_even_clock(dataset: xr.Dataset) -> None:
    check_clock(dataset)
    rate = float(dataset.attrs.get("sampling_rate_hz", np.nan))
    if not (rate > 0 and np.isfinite(rate)):
        raise DatasetError(f"sampling_rate_hz: expected an attribute > 0 Hz, got {rate}; set it")
    time_s = dataset["time"].values
    off = np.abs(clock_departure(time_s, 1 / rate))
    if np.any(off > _UNEVEN):
        raise DatasetError(
            f"time: expected t0 + i / {rate:g} s, got {time_s[off > _UNEVEN][0]:.6f} s as sample "
            f"{np.flatnonzero(off > _UNEVEN)[0]}; cut the recording at the gap, or resample it"
        )


def _sensor_coords(time_s: npt.ArrayLike, sensors: Sequence[str], axes: Sequence[str]) -> dict[str, Any]:
    time = ("time", np.asarray(time_s, np.float64), {"units": "s"})
    return {"time": time, "sensor": list(sensors), "axis": list(axes)}
