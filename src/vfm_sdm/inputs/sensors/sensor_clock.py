"""The even clock behind a sensor's time stamps: rounded, in bursts, out of order, written twice, with samples missing.

A clock is even or it is refused. What may be put right without knowing more is put right and said: the rounding of
stamps, rows that are there twice or out of order, and stamps that arrive in bursts while no sample is lost. Samples
that are missing leave NaN on the even clock, a tenth of them at most.
"""

import math
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, clock_departure
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.dialect import Table
from vfm_sdm.signals.resampling import interpolate_runs

__all__ = ["MOST_MISSING", "EvenClock", "find_even_clock"]

MOST_MISSING = 0.1
"""Share of samples that may be missing: beyond, what is left says little about what was."""
_UNEVEN = 0.2
"""Share of the sampling interval by which an interval between time stamps may be off: what rounding to milliseconds
does at 200 Hz, and far from a lost sample."""
_IN_PHASE = 0.3
"""Share of an interval by which a sample after a gap may be off the clock before it and still count as on it."""
_RATES_AGREE, _BURSTS_AGREE = 1e-3, 2e-2
_BURSTS_OFF = 0.75
"""Samples by which the first stamp of a burst may be off a straight line: a lost burst puts it off by one at least."""
_FEWEST_BURSTS = 5
_BURSTS_FROM = 3.0
"""Places on the clock for each sample from which on the stamps are rather those of bursts."""


@dataclass(frozen=True, eq=False)
class EvenClock:
    """The even clock of a file's samples, and where on it each row belongs.

    Parameters
    ----------
    time_s
        ``t0 + i / rate_hz``, shape (T',) [s].
    rate_hz
        Samples a second [Hz].
    rows
        Rows that count, in the order of time, length T.
    place
        Place of each of them on the clock, shape (T,) [samples]; not whole where a pause changed the phase.
    notes
        What was put right, a sentence each.
    """

    time_s: FloatArray
    rate_hz: float
    rows: IntArray
    place: FloatArray
    notes: tuple[str, ...] = ()

    def put(self, values: FloatArray) -> FloatArray:
        """Values of the file's rows, shape (R, A), on the clock, shape (T', A); NaN where a sample is missing."""
        ordered, whole = values[self.rows], np.rint(self.place)
        result = np.full((len(self.time_s), values.shape[1]), np.nan)
        if np.abs(self.place - whole).max() <= _IN_PHASE:
            result[whole.astype(int)] = ordered
            return result
        finite = np.where(np.isfinite(ordered), ordered, np.nan)
        grid = np.arange(len(self.time_s), dtype=float)
        for axis in range(values.shape[1]):
            result[:, axis] = interpolate_runs(self.place, finite[:, axis : axis + 1], grid, longest_step_s=1.5)[:, 0]
        return result


def find_even_clock(
    table: Table, stamps: FloatArray | None, values: FloatArray, *, sampling_rate_hz: float | None = None
) -> EvenClock:
    """The even clock of a file.

    Parameters
    ----------
    table
        The file.
    stamps
        Time stamps of its rows, shape (R,) [s]; ``None`` where it has none.
    values
        Values of its rows in any unit, shape (R, A), to tell a row written twice from two samples with one stamp.
    sampling_rate_hz
        Samples a second, where they are known [Hz].

    Raises
    ------
    DatasetError
        There are neither stamps nor a rate; the stamps fall, are uneven or contradict the rate; too many samples are
        missing.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = [["0"]] * 29
    >>> table = Table(Path("a.csv"), ("time",), ("s",), rows, list(range(2, 31)), ".")
    >>> stamps = np.delete(np.arange(30) / 100, 7)
    >>> clock = find_even_clock(table, stamps, np.arange(29.0)[:, None])
    >>> int(np.flatnonzero(np.isnan(clock.put(np.ones((29, 1)))[:, 0]))[0]), len(clock.time_s)
    (7, 30)
    """
    if sampling_rate_hz is not None and not (sampling_rate_hz > 0 and math.isfinite(sampling_rate_hz)):
        raise DatasetError(f"sampling_rate_hz: expected a number > 0, got {sampling_rate_hz}; correct it")
    rows: IntArray = np.arange(len(values))
    if stamps is None:
        if sampling_rate_hz is None:
            raise DatasetError(
                f"{table.path}: expected a time column or sampling_rate_hz, got neither in {list(table.names)}; state "
                "one of them: --column time=NAME, or --rate"
            )
        return EvenClock(rows / sampling_rate_hz, sampling_rate_hz, rows, rows.astype(float))
    notes: list[str] = []
    rows = _in_order(table, stamps, notes)
    rows = _without_twins(stamps, values, rows, notes)
    if len(rows) < 2:
        raise DatasetError(f"{table.path}: expected two time stamps or more, got {len(rows)}; check the time column")
    clock = None
    if sampling_rate_hz is None or not _only_on_average(stamps[rows], sampling_rate_hz):
        clock = _from_steps(table, stamps, rows, notes)
    if clock is None:
        clock = _from_bursts(table, stamps, rows, sampling_rate_hz, notes)
    if sampling_rate_hz is not None and abs(clock.rate_hz / sampling_rate_hz - 1) > _RATES_AGREE:
        raise DatasetError(
            f"{table.path}: expected a time column of {sampling_rate_hz:g} Hz, got {clock.rate_hz:g} Hz; correct "
            "sampling_rate_hz"
        )
    return clock


def _in_order(table: Table, stamps: FloatArray, notes: list[str]) -> IntArray:
    """Rows by time; stamps that start anew are refused."""
    rows = np.arange(len(stamps))
    steps = np.diff(stamps)
    falls = np.flatnonzero(steps < 0)
    if not falls.size:
        return rows
    if len(falls) > len(steps) / 2:
        raise DatasetError(
            f"{table.path}: expected rising time stamps, got {np.median(steps):g} s between samples; sort the rows"
        )
    ordered = np.argsort(stamps, kind="stable")
    sorted_steps = np.diff(stamps[ordered])
    middle = float(np.median(sorted_steps))
    if middle > 0 and sorted_steps.min() > (1 - _UNEVEN) * middle:
        notes.append(f"{len(falls)} times rows are out of order, first row {table.lines[falls[0] + 1]}: sorted by time")
        return ordered
    at = int(falls[0])
    raise DatasetError(
        f"{table.path}: expected rising time stamps, got {stamps[at]:g} s and then {stamps[at + 1]:g} s in row "
        f"{table.lines[at + 1]}: the clock starts again there, or two recordings are in one file; cut the file there"
    )


def _without_twins(stamps: FloatArray, values: FloatArray, rows: IntArray, notes: list[str]) -> IntArray:
    """Rows without those that repeat stamp and values of the row before."""
    same = (np.diff(stamps[rows]) == 0) & _equal_rows(values[rows])
    if not same.any() or same.all():
        return rows
    kept = rows[np.concatenate([[True], ~same])]
    if np.any(np.diff(stamps[kept]) == 0):
        return rows
    notes.append(f"{int(same.sum())} rows are there twice, stamp and values alike: left out")
    return np.asarray(kept)


def _equal_rows(values: FloatArray) -> BoolArray:
    return np.asarray(((values[1:] == values[:-1]) | ~np.isfinite(values[1:])).all(axis=1))


def _from_steps(table: Table, stamps: FloatArray, rows: IntArray, notes: list[str]) -> EvenClock | None:
    """The clock where each stamp is that of its sample; ``None`` where it is not."""
    found = stamps[rows]
    intervals = np.diff(found)
    interval = float(np.median(intervals))
    if not interval > 0:
        return None
    count = len(found)
    if np.all(np.abs(np.diff(clock_departure(found, interval))) <= _UNEVEN):
        rate_hz = (count - 1) / float(found[-1] - found[0])
        return EvenClock(found[0] + np.arange(count) / rate_hz, rate_hz, rows, np.arange(float(count)), tuple(notes))
    near = np.abs(intervals / interval - 1) <= _UNEVEN
    interval = float(intervals[near].mean())
    steps = intervals / interval
    whole = np.rint(steps)
    # A step of some intervals is as uneven as its two ends are; after a pause the phase may be any.
    odd = (whole < 1) | ((np.abs(steps - whole) > _UNEVEN) & (steps < 3))
    if odd.any():
        return None
    place = np.concatenate([[0.0], np.cumsum(np.where(np.abs(steps - whole) <= _IN_PHASE, whole, steps))])
    total = int(np.floor(place[-1] + _IN_PHASE)) + 1
    missing = np.flatnonzero(whole > 1)
    if total > _BURSTS_FROM * count:
        return None
    if total - count > MOST_MISSING * total:
        raise DatasetError(
            f"{table.path}: expected samples {_plain(interval)} s apart, got {_plain(intervals[missing[0]])} s before "
            f"row {table.lines[rows[missing[0] + 1]]}; cut the recording at the gap, or resample it: "
            f"{total - count} of {total} samples are missing, and a tenth may be"
        )
    return EvenClock(found[0] + np.arange(total) * interval, 1 / interval, rows, place, tuple(notes))


def _fit_bursts(stamps: FloatArray, starts: IntArray, count: int) -> tuple[float, float, FloatArray]:
    """Rate and offset of the line from stamps to samples, and what is off it: a stamp is of a burst's first or last."""
    fits = []
    for samples in (starts, np.append(starts[1:], count) - 1):
        # The last burst may be cut short.
        rate, offset = np.polyfit(stamps[:-1], samples[:-1], 1)
        fits.append((float(rate), float(offset), np.abs(samples - (rate * stamps + offset))[:-1]))
    return min(fits, key=lambda fit: round(float(fit[2].max()), 2))  # the first where both fit


def _only_on_average(stamps: FloatArray, rate_hz: float) -> bool:
    """Whether the stamps have the stated rate on average and another between most samples."""
    whole, between = (len(stamps) - 1) / max(float(stamps[-1] - stamps[0]), 1e-12), np.median(np.diff(stamps))
    return bool(abs(whole / rate_hz - 1) <= _BURSTS_AGREE and abs(between * rate_hz - 1) > _UNEVEN)


def _plain(interval_s: float) -> str:
    return f"{interval_s:.6g}"


def _from_bursts(
    table: Table, stamps: FloatArray, rows: IntArray, rate_hz: float | None, notes: list[str]
) -> EvenClock:
    """The clock where stamps are those of packets of samples: the line through the first stamp of each."""
    found = stamps[rows]
    count = len(found)
    intervals = np.diff(found)
    place = np.arange(float(count))
    mean_hz = (count - 1) / float(found[-1] - found[0]) if found[-1] > found[0] else math.nan
    if rate_hz is not None and abs(mean_hz / rate_hz - 1) <= _BURSTS_AGREE:
        notes.append(
            f"time stamps are uneven, {mean_hz:.6g} Hz on average: the stated {rate_hz:g} Hz are believed instead, so "
            "that a lost sample would not be seen"
        )
        return EvenClock(found[0] + place / rate_hz, rate_hz, rows, place, tuple(notes))
    starts = np.flatnonzero(intervals > 0) + 1
    size = count / (len(starts) + 1)
    if len(starts) > _FEWEST_BURSTS and np.any(intervals == 0):
        rate, offset, off = _fit_bursts(found[starts], starts, count)
        if off.max() <= _BURSTS_OFF:
            notes.append(
                f"time stamps come in bursts, {count - len(starts) - 1} of {count} repeat the one before: even stamps "
                f"at {rate:.6g} Hz are used, and the clock may be off by up to {size / rate:.2g} s"
            )
            return EvenClock((place - offset) / rate, float(rate), rows, place, tuple(notes))
        worst = int(starts[np.argmax(off)])
        raise DatasetError(
            f"{table.path}: expected even time stamps, got bursts of about {size:.3g} samples with one stamp, uneven "
            f"by {off.max():.3g} samples around row {table.lines[rows[worst]]}, as where samples are lost; cut the "
            "file there, or state the sensor's rate with --rate where none is"
        )
    middle = float(np.median(intervals))
    if not middle > 0:
        raise DatasetError(
            f"{table.path}: expected rising time stamps, got {middle:g} s between samples, most stamps repeated; give "
            "finer stamps, or state the rate with --rate"
        )
    odd = np.flatnonzero(np.abs(intervals / middle - 1) > _UNEVEN)
    raise DatasetError(
        f"{table.path}: expected samples {_plain(middle)} s apart, got {_plain(intervals[odd[0]])} s before row "
        f"{table.lines[rows[odd[0] + 1]]}, and uneven steps in {odd.size / intervals.size:.0%} of all rows: "
        "stamps of arrival are not those of the samples; state the sensor's rate with --rate where no sample is lost, "
        "else resample the recording"
    )
