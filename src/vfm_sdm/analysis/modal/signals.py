"""Displacement as modal analysis takes it: channels of one rate, without drift, each in units of its own noise."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import signal

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.clocks import even_clock
from vfm_sdm.signals.filters import band_pass

__all__ = ["DETRENDING", "Channels", "make_channels"]

DETRENDING = "linear trend and everything below the band removed"
_LOWEST_PERIODS = 8.0
"""Periods of the lowest frequency in a record that it can tell from drift."""
_LOWEST_HZ = 0.2
_HIGHEST = 0.4
"""Default upper end of the band over the rate."""
_SAMPLES_OF_HIGHEST = 2.5
"""Rate that is kept, over the upper end of the band."""
_FEWEST_KNOWN = 0.9
"""Share of samples that must be ok; the others are filled by straight lines."""
_FEWEST_SAMPLES = 100


@dataclass(frozen=True, eq=False)
class Channels:
    """Series of points along axes.

    Parameters
    ----------
    values
        Displacement in the band, shape (T, C) [mm].
    noise_mm
        Standard deviation that is stated for each in the band, shape (C,) [mm]; 1 where none is.
    rate_hz
        Samples a second [Hz].
    band_hz
        Lower and upper end of the band [Hz].
    place
        Index of point and axis of every channel, shape (C, 2).
    filled
        Samples that were filled, over all.
    """

    values: FloatArray
    noise_mm: FloatArray
    rate_hz: float
    band_hz: tuple[float, float]
    place: np.ndarray
    filled: float

    @property
    def duration_s(self) -> float:
        """Length of the record [s]."""
        return len(self.values) / self.rate_hz


def make_channels(
    displacement: xr.Dataset,
    *,
    axes: tuple[str, ...] | None,
    static: frozenset[str] = frozenset(),
    band_hz: tuple[float, float] | None = None,
) -> Channels:
    """The series of all points that count, along the given axes.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    axes
        Names of the axes; all that were measured when ``None``.
    static
        Points that must not move; they are left out.
    band_hz
        Band [Hz]; by default from eight periods in the record, at least 0.2 Hz, to 0.4 of the frame rate.

    Raises
    ------
    DatasetError
        The band or an axis does not fit, or no point has enough samples.
    """
    measured = tuple(str(name) for name in displacement["axis"].values)
    axes = measured if axes is None else axes
    if not axes or not set(axes) <= set(measured):
        known = ", ".join(measured)
        raise DatasetError(f"axis: expected some of {known}, got {', '.join(axes) or 'none'}; name those that count")
    time_s = displacement["time"].values
    if len(time_s) < _FEWEST_SAMPLES:
        raise DatasetError(
            f"modes: expected {_FEWEST_SAMPLES} frames or more, got {len(time_s)}; measure a longer record"
        )
    clock_s, rate_hz = even_clock(time_s)
    low, high = _choose_band(band_hz, rate_hz, len(clock_s) / rate_hz)
    values = trusted_values(displacement, "displacement")
    std = displacement["displacement_std"].values
    columns, noise, place, filled = [], [], [], []
    for p, point in enumerate(displacement["point"].values):
        for a, axis in enumerate(displacement["axis"].values):
            ok = np.isfinite(values[:, p, a])
            if str(point) in static or str(axis) not in axes or ok.sum() < _FEWEST_KNOWN * len(clock_s):
                continue
            columns.append(np.interp(clock_s, time_s[ok], values[ok, p, a]))
            stated = std[ok, p, a]
            stated = stated[np.isfinite(stated)]
            noise.append(float(np.sqrt(np.mean(stated**2))) if stated.size else 0.0)
            place.append((p, a))
            filled.append(1 - ok.sum() / len(clock_s))
    if not columns:
        raise DatasetError(
            f"modes: expected a point with {_FEWEST_KNOWN:.0%} of its samples ok that may move, got none; look at the "
            "tracks' status"
        )
    series = band_pass(signal.detrend(np.stack(columns, axis=1), axis=0), rate_hz, (low, high))
    step = max(1, int(rate_hz / (_SAMPLES_OF_HIGHEST * high)))
    floor = np.array(noise) * np.sqrt((high - low) / (rate_hz / 2))
    return Channels(
        series[::step], np.where(floor > 0, floor, 1.0), rate_hz / step, (low, high), np.array(place),
        float(np.mean(filled)),
    )  # fmt: skip


def _choose_band(band_hz: tuple[float, float] | None, rate_hz: float, duration_s: float) -> tuple[float, float]:
    lowest = _LOWEST_PERIODS / duration_s
    low, high = (max(lowest, _LOWEST_HZ), _HIGHEST * rate_hz) if band_hz is None else band_hz
    if not lowest * (1 - 1e-9) <= low < high < rate_hz / 2:
        raise DatasetError(
            f"band: expected {lowest:.3g} Hz (eight periods in {duration_s:.3g} s) <= low < high < "
            f"{rate_hz / 2:.4g} Hz (half the frame rate), got {low:g} and {high:g}; choose another band"
        )
    return float(low), float(high)
