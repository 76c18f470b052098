"""From a sensor's acceleration to its displacement, as in the paper (section Implementation details).

Every step is a function of its own. Acceleration arrives in m/s2
(`vfm_sdm.inputs.sensors.sensor_csv.read_acceleration` converts it from g). The order of the steps and the defaults are
the paper's; what it leaves open (how an onset is told from noise, what happens at the ends) is decided here and said
where it is done.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from vfm_sdm.core.arrays import BoolArray, FloatArray, unbroken_runs
from vfm_sdm.core.sensor_datasets import ReferenceFacts, check_acceleration, make_reference
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.outliers import HampelUse, OutlierRules, Outliers, find_worth, treat_outliers
from vfm_sdm.inputs.sensors.readings import find_readings, name_defects, name_outliers, name_units
from vfm_sdm.signals.filters import band_pass, shortest_band_pass_s

__all__ = [
    "Integration",
    "RecipeSettings",
    "amplitude_response",
    "compute_reference",
    "detect_onset",
    "integrate",
    "resample",
]

Integration = Literal["trapezoid", "spline"]

_SAMPLES_OF_FASTEST = 4.0
"""Samples in a period of the band's upper edge below which the spline of `resample` loses amplitude."""
_FILLED = 0.25
"""Periods of the band's upper edge that a gap may have to be filled by a spline: all that counts is smooth over it."""
_FEWEST_KEPT = 4
_KEPT = ("start_utc", "first_stamp")
_MM_PER_M = 1e3


@dataclass(frozen=True)
class RecipeSettings:
    """Constants of the recipe; the defaults are the paper's where it states them.

    Parameters
    ----------
    onset_window_s
        Window of the rolling standard deviation [s].
    onset_threshold
        How many times its level in the quiet start the standard deviation must exceed [1].
    onset_floor_m_s2
        Least standard deviation that counts as motion [m/s2], lest rounding counts as motion after a start without
        any noise.
    quiet_s
        Length of the start in which the quietest window gives that level [s].
    onset_s
        Where the motion begins on the sensor's clock [s], to be used instead of detecting it.
    hampel_window_s, hampel_threshold
        Window [s], and threshold in scaled median absolute deviations (x 1.4826) [1].
    hampel
        ``on``, ``off``, or ``auto``: on, but where it would take away parts of impacts, lone samples alone are
        replaced (`vfm_sdm.inputs.sensors.outliers.treat_outliers`).
    band_hz, filter_order
        Edges [Hz] and order of the Butterworth band-pass, which runs forwards and backwards
        (`vfm_sdm.signals.filters.band_pass`).
    integration
        ``trapezoid`` as in the paper, or ``spline``, which keeps the amplitude where the trapezoid does not
        (`amplitude_response`).
    rate_hz
        Sampling rate of the displacement [Hz].

    Raises
    ------
    DatasetError
        A value is out of its range.
    """

    onset_window_s: float = 0.5
    onset_threshold: float = 3.0
    onset_floor_m_s2: float = 1e-3
    quiet_s: float = 2.0
    onset_s: float | None = None
    hampel_window_s: float = 0.75
    hampel_threshold: float = 3.5
    hampel: HampelUse = "auto"
    band_hz: tuple[float, float] = (1.0, 10.0)
    filter_order: int = 4
    integration: Integration = "trapezoid"
    rate_hz: float = 30.0

    def __post_init__(self) -> None:
        positive = ("onset_window_s", "onset_threshold", "quiet_s", "hampel_window_s", "hampel_threshold", "rate_hz")
        wrong = {name: getattr(self, name) for name in positive if not getattr(self, name) > 0}
        if wrong:
            raise DatasetError(f"recipe: expected values > 0, got {wrong}; correct them")
        if not self.onset_floor_m_s2 >= 0:
            raise DatasetError(f"onset_floor_m_s2: expected a value >= 0, got {self.onset_floor_m_s2}; correct it")
        if self.quiet_s < self.onset_window_s:
            raise DatasetError(
                f"quiet_s: expected at least onset_window_s = {self.onset_window_s} s, got {self.quiet_s}; lengthen it"
            )
        if self.integration not in ("trapezoid", "spline"):
            raise DatasetError(f"integration: expected 'trapezoid' or 'spline', got {self.integration!r}; use one")
        if self.hampel not in get_args(HampelUse):
            raise DatasetError(f"hampel: expected one of {get_args(HampelUse)}, got {self.hampel!r}; use one")
        if not 2 * self.band_hz[1] < self.rate_hz:
            raise DatasetError(
                f"rate_hz: expected more than twice the upper edge of the band, {self.band_hz[1]:g} Hz, got "
                f"{self.rate_hz:g}; lower the band or raise the rate"
            )


def compute_reference(acceleration: xr.Dataset, settings: RecipeSettings | None = None) -> xr.Dataset:
    """Displacement of reference sensors [mm] from their acceleration [m/s2].

    Parameters
    ----------
    acceleration
        Acceleration dataset (`vfm_sdm.core.sensor_datasets.make_acceleration`), shape (T, S, A) for S sensors and any
        number A of axes [m/s2], gravity and bias included.
    settings
        Constants of the recipe; those of the paper when left out.

    Returns
    -------
    reference
        Reference dataset, shape (T', S, A) [mm], at ``t0 + i / settings.rate_hz`` over the whole recording, with t0 its
        first sample; NaN before the onset and where samples are missing, clipped or stuck. ``outliers`` counts the
        samples that the Hampel filter replaced, by sensor and axis, and ``outlier_energy`` is the share of the energy
        in the band that it took away with them [1]. Attributes ``onset_s``; ``onset_status``: ``detected``, ``given``,
        or ``not detected: whole recording used``; and ``notes``, sentences that a reader must know.

    Raises
    ------
    DatasetError
        The clock is not even, a value is missing without a ``status`` that says so, the sampling rate is too low for
        the band (less than four samples in a period of its upper edge), the given onset lies outside, what follows the
        onset is too short to filter or nowhere whole for as long, or the sensor reads more than any does at rest.

    Notes
    -----
    All sensors of the dataset share one onset, the earliest of any. The filter rings for about a period of the lower
    edge at both ends of the segment, and the displacement is zero at its beginning, not on average. What rings is
    integrated twice and the recipe filters no more after that, so a slow curve remains when the recording does not
    end at rest: compare with other displacement inside ``band_hz`` only.

    Gaps of up to a quarter of a period of the upper edge are filled by splines. Longer ones, and clipped and stuck
    samples (`vfm_sdm.inputs.sensors.defects.find_defects`), divide an axis into pieces, each of which goes through the
    recipe by itself: what was not felt cannot be integrated over. Beside such a gap the piece is left out for a period
    of the lower edge.

    When no onset is found the whole recording counts, because a structure that moves from the first sample on has
    none; whether it moved at all is for the reader of ``onset_status`` to judge.

    Examples
    --------
    >>> from vfm_sdm.core.sensor_datasets import make_acceleration
    >>> time_s = np.arange(2000) / 100
    >>> vibration = -4e-3 * (2 * np.pi * 2) ** 2 * np.sin(2 * np.pi * 2 * time_s)
    >>> recorded = make_acceleration(time_s, ["midspan"], ["vertical"], vibration[:, None, None], sampling_rate_hz=100)
    >>> displacement = compute_reference(recorded)["displacement"].values[:, 0, 0]
    >>> print(f"{np.ptp(displacement[270:330]) / 2:.1f} mm")
    4.1 mm
    """
    settings = RecipeSettings() if settings is None else settings
    values, known, time_s, rate_hz, notes = _check_recording(acceleration, settings)
    first, status = _segment_start(values, time_s, rate_hz, settings)
    shortest_s = _shortest_piece_s(rate_hz, settings)
    if (len(time_s) - first) / rate_hz < shortest_s:
        raise DatasetError(
            f"acceleration: expected at least {shortest_s:.2f} s from the onset on, got "
            f"{(len(time_s) - first) / rate_hz:.2f} s after {time_s[first]:.2f} s; record longer or set onset_s"
        )
    count = int(np.floor((time_s[-1] - time_s[0]) * settings.rate_hz + 1e-6)) + 1
    grid = time_s[0] + np.arange(count) / settings.rate_hz
    sensors, axes = ([str(name) for name in acceleration[dim].values] for dim in ("sensor", "axis"))
    displacement = np.full((count, len(sensors), len(axes)), np.nan)
    replaced, taken = np.zeros((len(sensors), len(axes)), int), np.zeros((len(sensors), len(axes)))
    worth = [find_worth(values[first:, s], rate_hz, settings.band_hz) for s in range(len(sensors))]
    for s, a in np.ndindex(len(sensors), len(axes)):
        rules = OutlierRules(
            _round_to_odd(settings.hampel_window_s * rate_hz),
            settings.hampel_threshold,
            rate_hz,
            settings.band_hz,
            settings.hampel,
            float(worth[s][a]),
        )
        displacement[:, s, a], outliers = _displace(
            values[:, s, a], known[:, s, a], first, (time_s, grid), rules, settings
        )
        replaced[s, a] = sum(int(treated.replaced.sum()) for treated in outliers)
        taken[s, a] = max((treated.energy_taken for treated in outliers), default=0.0)
        notes += name_outliers(outliers, f"{sensors[s]!r}, {axes[a]}", rules)
        if not outliers:
            notes.append(f"{sensors[s]!r}, {axes[a]}: no {shortest_s:.2f} s in one piece, so no displacement")
    if not np.isfinite(displacement).any():
        raise DatasetError(
            f"acceleration: expected {shortest_s:.2f} s in one piece, got less in every axis; record again: "
            + "; ".join(notes)
        )
    reference = make_reference(
        grid,
        sensors,
        axes,
        displacement * _MM_PER_M,
        facts=ReferenceFacts(settings.rate_hz, float(time_s[first]), settings.band_hz),
        attrs={
            "onset_status": status,
            "integration": settings.integration,
            "hampel": settings.hampel,
            "recorded_at_hz": rate_hz,
            **{name: acceleration.attrs[name] for name in _KEPT if name in acceleration.attrs},
            "notes": notes,
        },
    )
    reference["outliers"] = (("sensor", "axis"), replaced, {"units": "1"})
    reference["outlier_energy"] = (("sensor", "axis"), taken, {"units": "1"})
    return reference


def _shortest_piece_s(rate_hz: float, settings: RecipeSettings) -> float:
    """How long a piece without a gap must be for the filters of the recipe [s]."""
    shortest = shortest_band_pass_s(rate_hz, settings.band_hz, order=settings.filter_order)
    return max(shortest, _round_to_odd(settings.hampel_window_s * rate_hz) / rate_hz)


def _displace(
    values: FloatArray,
    known: BoolArray,
    begin: int,
    clocks: tuple[FloatArray, FloatArray],
    rules: OutlierRules,
    settings: RecipeSettings,
) -> tuple[FloatArray, list[Outliers]]:
    """Displacement [m] of one axis at the second clock, from acceleration at the first [m/s2], a piece at a time.

    Ends that a gap made are left out as far as the filter rings there; a recording's own ends are the paper's.
    """
    time_s, grid = clocks
    displacement, outliers = np.full(len(grid), np.nan), []
    known, ringing = known & (np.arange(len(known)) >= begin), round(rules.rate_hz / settings.band_hz[0])
    shortest = _shortest_piece_s(rules.rate_hz, settings) * rules.rate_hz
    for run in unbroken_runs(known):
        start = run.start + (ringing if run.start > begin else 0)
        stop = run.stop - (ringing if run.stop < len(known) else 0)
        if run.stop - run.start < shortest - 0.5 or stop - start < _FEWEST_KEPT:
            continue
        treated = treat_outliers(values[run], rules)
        centred = treated.treated - treated.treated.mean()
        filtered = band_pass(centred, rules.rate_hz, settings.band_hz, order=settings.filter_order)
        velocity = signal.detrend(integrate(filtered, rules.rate_hz, rule=settings.integration), type="linear")
        moved = integrate(velocity, rules.rate_hz, rule=settings.integration)[start - run.start : stop - run.start]
        found = resample(moved, time_s[start:stop], grid)
        displacement = np.where(np.isfinite(found), found, displacement)
        outliers.append(treated)
    return displacement, outliers


def detect_onset(acceleration: FloatArray, rate_hz: float, settings: RecipeSettings) -> int | None:
    """Index of the sample from which on the structure moves; ``None`` when nothing stands out from the start.

    Parameters
    ----------
    acceleration
        Acceleration of one sensor in A axes, shape (T, A) [m/s2].
    rate_hz
        Samples a second [Hz].
    settings
        Their window, threshold, floor and quiet start are used.

    Raises
    ------
    DatasetError
        The recording is shorter than the window.

    Notes
    -----
    The combined magnitude is ``|a - median(a)|``: with gravity left in, the magnitude hardly shows horizontal motion.
    The level of noise is that of the quietest window in the start, which an impulse there does not raise. The motion
    begins with the first window whose standard deviation exceeds the threshold times that level, if it stays above for
    more than two windows: an impulse, which the next step of the recipe removes, lifts it for one. The index is where
    that window begins, so that the segment starts at rest, at most a window before the motion.

    Examples
    --------
    >>> time_s = np.arange(1000) / 100
    >>> motion = np.where(time_s > 5, np.sin(2 * np.pi * 3 * time_s), 1e-4 * np.cos(60 * time_s))
    >>> onset = detect_onset(motion[:, None], 100.0, RecipeSettings())
    >>> bool(4.5 <= time_s[onset] <= 5)
    True
    """
    window = max(round(settings.onset_window_s * rate_hz), 2)
    if len(acceleration) < window:
        raise DatasetError(
            f"acceleration: expected at least onset_window_s = {settings.onset_window_s} s, got "
            f"{len(acceleration) / rate_hz:.2f} s; record longer or set onset_s"
        )
    quiet = max(round(settings.quiet_s * rate_hz), window)
    magnitude = np.linalg.norm(acceleration - np.median(acceleration, axis=0), axis=-1)
    rolling = sliding_window_view(magnitude, window).std(axis=-1)
    level = float(rolling[: quiet - window + 1].min())
    moving = rolling > max(settings.onset_threshold * level, settings.onset_floor_m_s2)
    return next((run.start for run in unbroken_runs(moving) if run.stop - run.start > 2 * window), None)


def integrate(values: FloatArray, rate_hz: float, *, rule: Integration = "trapezoid") -> FloatArray:
    """Integral over time from the first sample on, where it is zero.

    Parameters
    ----------
    values
        Series [u], shape (T, ...).
    rate_hz
        Samples a second [Hz].
    rule
        ``trapezoid``: straight lines between the samples; ``spline``: a cubic spline through them.

    Returns
    -------
    integral
        Shape (T, ...) [u s].

    Examples
    --------
    >>> velocity_mm_s = np.array([0.0, 2.0, 4.0])
    >>> integrate(velocity_mm_s, 2.0).tolist()
    [0.0, 0.5, 2.0]
    """
    if rule == "trapezoid":
        return np.asarray(cumulative_trapezoid(values, dx=1 / rate_hz, axis=0, initial=0))
    time_s = np.arange(len(values)) / rate_hz
    return np.asarray(CubicSpline(time_s, values).antiderivative()(time_s))


def resample(values: FloatArray, time_s: FloatArray, grid_s: FloatArray) -> FloatArray:
    """The signal at other times, by a cubic spline; NaN outside the recording.

    Parameters
    ----------
    values
        Series of any unit, shape (T, ...), band-limited to a quarter of its sampling rate at most.
    time_s, grid_s
        Times of the values and wanted times, shapes (T,) and (N,) [s].

    Returns
    -------
    resampled
        Shape (N, ...), in the unit of the values.

    Examples
    --------
    >>> time_s = np.arange(5) / 10
    >>> resample(time_s**2, time_s, np.array([0.15, 0.9])).round(4).tolist()
    [0.0225, nan]
    """
    slack = 1e-6 * float(time_s[1] - time_s[0])  # a time of the grid may miss the first or last sample by rounding
    inside = (grid_s >= time_s[0] - slack) & (grid_s <= time_s[-1] + slack)
    result = np.full((len(grid_s), *values.shape[1:]), np.nan)
    result[inside] = CubicSpline(time_s, values)(grid_s[inside])
    return result


def amplitude_response(frequency_hz: FloatArray, sampling_rate_hz: float, settings: RecipeSettings) -> FloatArray:
    """Amplitude that the recipe gives for a steady vibration over the true one, in closed form [1].

    Parameters
    ----------
    frequency_hz
        Frequencies above 0 and below half the sampling rate, shape (...) [Hz].
    sampling_rate_hz
        Sampling rate of the accelerometer [Hz].
    settings
        Their band, filter order and rule of integration are used.

    Returns
    -------
    response
        Shape (...) [1]; 1 where the recipe keeps the amplitude.

    Notes
    -----
    The squared Butterworth response times the square of one integration's. That is ``(w/2) cot(w/2)`` for the
    trapezoid, with w the phase between two samples: at 64 Hz the displacement comes out 1.4 % too small at 3 Hz, 4.0 %
    at 5 Hz and 16 % at 10 Hz. For the spline it is the integral of a cubic B-spline from sample to sample over its
    values at the samples. Resampling is not included.

    Examples
    --------
    >>> amplitude_response(np.array([3.0, 5.0]), 64.0, RecipeSettings()).round(3).tolist()
    [0.986, 0.96]
    """
    frequency = np.asarray(frequency_hz, np.float64)
    sections = signal.butter(settings.filter_order, settings.band_hz, "bandpass", fs=sampling_rate_hz, output="sos")
    _, response = signal.sosfreqz(sections, frequency.ravel(), fs=sampling_rate_hz)
    w = 2 * np.pi * frequency / sampling_rate_hz
    once = np.cos(w / 2)
    if settings.integration == "spline":
        once = (11 * np.cos(w / 2) + np.cos(3 * w / 2)) / (4 + 2 * np.cos(w)) / 2
    return np.asarray(np.abs(response).reshape(w.shape) ** 2 * (once * (w / 2) / np.sin(w / 2)) ** 2)


def _check_recording(
    acceleration: xr.Dataset, settings: RecipeSettings
) -> tuple[FloatArray, BoolArray, FloatArray, float, list[str]]:
    """Values without NaN and which of them count, clock and sampling rate, fit for the recipe; and what to know."""
    check_acceleration(acceleration)
    values, time_s = acceleration["acceleration"].values, acceleration["time"].values
    rate_hz = float(acceleration.attrs["sampling_rate_hz"])
    bad = ~np.isfinite(values).all(axis=(1, 2))
    if bad.any() and "status" not in acceleration:
        raise DatasetError(
            f"acceleration: expected a number in every sample, got {bad.sum()} without, the first at "
            f"{time_s[bad][0]:.3f} s; cut the recording there"
        )
    if rate_hz < _SAMPLES_OF_FASTEST * settings.band_hz[1]:
        raise DatasetError(
            f"sampling_rate_hz: expected at least {_SAMPLES_OF_FASTEST * settings.band_hz[1]:g} Hz for a band up to "
            f"{settings.band_hz[1]:g} Hz, got {rate_hz:g}; lower the band, or correct the unit of time"
        )
    codes, filled, known = find_readings(acceleration, longest_gap_s=_FILLED / settings.band_hz[1])
    sensors, axes = ([str(name) for name in acceleration[dim].values] for dim in ("sensor", "axis"))
    notes = [
        *acceleration.attrs.get("notes", ()),
        *name_units(filled, sensors),
        *name_defects(codes, time_s, sensors, axes),
    ]
    return filled, known, time_s, rate_hz, notes


def _segment_start(values: FloatArray, time_s: FloatArray, rate_hz: float, settings: RecipeSettings) -> tuple[int, str]:
    """First sample of the motion, and how it is known."""
    if settings.onset_s is not None:
        if not time_s[0] <= settings.onset_s <= time_s[-1]:
            raise DatasetError(
                f"onset_s: expected a time from {time_s[0]:.3f} to {time_s[-1]:.3f} s, got {settings.onset_s}; "
                "state it on the sensor's own clock"
            )
        return int(np.searchsorted(time_s, settings.onset_s - 1e-6 / rate_hz)), "given"
    onsets = [detect_onset(values[:, sensor], rate_hz, settings) for sensor in range(values.shape[1])]
    found = [onset for onset in onsets if onset is not None]
    return (min(found), "detected") if found else (0, "not detected: whole recording used")


def _round_to_odd(samples: float) -> int:
    """The odd number of samples that is centred on one and nearest to the wanted length."""
    return 2 * round((samples - 1) / 2) + 1
