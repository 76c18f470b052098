"""Samples of a sensor's recording that are no readings: how datasets hold them, and the sentences about them."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, unbroken_runs
from vfm_sdm.core.statuses import ReadingStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.defects import Reading, find_defects, find_held_samples
from vfm_sdm.inputs.sensors.outliers import OutlierRules, Outliers
from vfm_sdm.signals.resampling import interpolate_runs

__all__ = ["find_readings", "name_defects", "name_outliers", "name_units", "reading_status"]

_MEANINGS = tuple(map(str, ReadingStatus))
_ADVICE = {
    ReadingStatus.MISSING: "missing, not recorded or a value that stands for none; short gaps are filled by a spline, "
    "long ones left out: check the logger",
    ReadingStatus.CLIPPED: "clipped at the end of the sensor's range, beyond which the structure went; what hangs on "
    "them is left out: use a sensor of a wider range, or turn its gain down",
    ReadingStatus.STUCK: "stuck, one value repeated while the structure moved; they are left out: check the sensor and "
    "its cable",
}

_FEWEST, _BESIDE = 4, 8
"""Samples that a series, and each side of a gap, have for the spline over it."""
_G = 9.80665
_MOST_AT_REST_G = 1.5
"""More than gravity and a generous bias: no sensor on a structure reads more on average."""
_MOST_SCATTER_G = 10.0
"""Nothing that people walk on shakes like that half of the time."""
_LIKE_G = 0.07
_COARSE = 0.35
"""Steps of rounding, as a share of the standard deviation, whose own one, step / sqrt(12), is a tenth of it."""
_AXES_THAT_HOLD_GRAVITY = 3


def reading_status(codes: npt.ArrayLike) -> xr.Variable:
    """Status of every sample of a recording, with its meanings as CF flags.

    Parameters
    ----------
    codes
        Codes of `vfm_sdm.inputs.sensors.defects.Reading`, shape (T, S, A).

    Examples
    --------
    >>> reading_status(np.zeros((2, 1, 1))).attrs["flag_meanings"]
    'ok missing clipped stuck'
    """
    flags = np.arange(len(_MEANINGS), dtype=np.int8)
    return xr.Variable(
        ("time", "sensor", "axis"),
        np.asarray(codes, np.int8),
        {"flag_values": flags, "flag_meanings": " ".join(_MEANINGS)},
    )


def name_defects(
    codes: npt.NDArray[np.int8], time_s: FloatArray, sensors: Sequence[str], axes: Sequence[str]
) -> list[str]:
    """A sentence for each sensor and defect: in which axes, how many samples, from when to when, and what to do.

    Parameters
    ----------
    codes
        Codes of `vfm_sdm.inputs.sensors.defects.Reading`, shape (T, S, A).
    time_s
        The sensors' clock, shape (T,) [s].
    sensors, axes
        Names, lengths S and A.

    Examples
    --------
    >>> codes = np.zeros((9, 1, 1), np.int8)
    >>> codes[3:6] = 3
    >>> name_defects(codes, np.arange(9.0), ["deck"], ["vertical"])[0][:64]
    "'deck', vertical: 3 samples, from 3 to 5 s, are stuck, one value"
    """
    sentences = []
    for s, sensor in enumerate(sensors):
        for status, advice in _ADVICE.items():
            alike: dict[bytes, list[str]] = {}
            for a, axis in enumerate(axes):
                alike.setdefault((codes[:, s, a] == _MEANINGS.index(status)).tobytes(), []).append(axis)
            for mask, together in alike.items():
                runs = unbroken_runs(np.frombuffer(mask, bool))
                if not runs:
                    continue
                count, last = sum(run.stop - run.start for run in runs), time_s[runs[-1].stop - 1]
                where = f"from {time_s[runs[0].start]:.6g} to {last:.6g} s"
                where += f" in {len(runs)} places" if len(runs) > 1 else ""
                sentences.append(f"{sensor!r}, {', '.join(together)}: {count} samples, {where}, are {advice}")
    return sentences


def find_readings(
    acceleration: xr.Dataset, *, longest_gap_s: float
) -> tuple[npt.NDArray[np.int8], FloatArray, BoolArray]:
    """Which samples of a recording are readings, and values without gaps where there are none.

    Parameters
    ----------
    acceleration
        Acceleration dataset, shape (T, S, A) [m/s2], with or without ``status``.
    longest_gap_s
        Longest gap of missing samples that is filled by a spline and then counts [s].

    Returns
    -------
    codes
        Codes of `vfm_sdm.inputs.sensors.defects.Reading`, shape (T, S, A).
    filled
        Values [m/s2], shape (T, S, A), interpolated where nothing was recorded.
    known
        Samples that count, shape (T, S, A).
    """
    values, time_s = acceleration["acceleration"].values, acceleration["time"].values
    codes = np.stack([find_defects(values[:, sensor]) for sensor in range(values.shape[1])], axis=1)
    if "status" in acceleration:
        stated = acceleration["status"].values
        codes = np.where(stated != Reading.OK, stated, codes).astype(np.int8)
    filled, known = values.copy(), codes == Reading.OK
    most = longest_gap_s * float(acceleration.attrs["sampling_rate_hz"])
    for s, a in np.ndindex(values.shape[1:]):
        good = known[:, s, a].copy()
        absent = ~np.isfinite(values[:, s, a]) | (codes[:, s, a] == Reading.MISSING)
        if not absent.any() or good.sum() < _FEWEST:
            continue
        filled[absent, s, a] = np.interp(time_s[absent], time_s[~absent], values[~absent, s, a])
        gaps = [run for run in unbroken_runs(codes[:, s, a] == Reading.MISSING) if run.stop - run.start <= most]
        inner = [run for run in gaps if run.start > 0 and run.stop < len(good) and good[run.start - 1] & good[run.stop]]
        for run in inner:
            near = np.flatnonzero(good[max(run.start - _BESIDE, 0) : run.stop + _BESIDE]) + max(run.start - _BESIDE, 0)
            spline = interpolate_runs(time_s[near], values[near, s, a][:, None], time_s[run], degree=3)
            filled[run, s, a] = spline[:, 0]
            known[run, s, a] = True
    return codes, filled, known


def name_units(values: FloatArray, sensors: Sequence[str]) -> list[str]:
    """What the sensors' readings at rest, and how often they change, say about units and rate.

    Parameters
    ----------
    values
        Acceleration, gravity included where the sensor feels it, shape (T, S, A) [m/s2].
    sensors
        Names, length S.

    Raises
    ------
    DatasetError
        A sensor reads more on average than gravity and any bias.

    Examples
    --------
    >>> name_units(np.full((9, 1, 3), [0.0, 1.0, 0.0]), ["deck"])[0][:60]
    "'deck' reads 1.00 m/s2 on average, which would be gravity in"
    """
    sentences = []
    for number, sensor in enumerate(sensors):
        rest = float(np.linalg.norm(np.median(values[:, number], axis=0)))
        if rest > _MOST_AT_REST_G * _G:
            meant = " m/s2" if abs(rest / _G**2 - 1) < _LIKE_G else " another unit"
            raise DatasetError(
                f"sensor {sensor!r}: expected at most {_MOST_AT_REST_G:g} g on average, gravity included, got "
                f"{rest / _G:.4g} g, which no sensor at rest reads: the file seems to be in{meant}; state it with "
                "--units, and calibrate raw counts first"
            )
        scatter = float(np.median(np.abs(values[:, number] - np.median(values[:, number], axis=0)), axis=0).max())
        if scatter > _MOST_SCATTER_G * _G:
            raise DatasetError(
                f"sensor {sensor!r}: expected a structure's vibration, got {scatter / _G:.4g} g half of the time: the "
                "file seems to be in another unit; state it with --units, and calibrate raw counts first"
            )
        if abs(rest - 1) < _LIKE_G and values.shape[2] >= _AXES_THAT_HOLD_GRAVITY:
            sentences.append(
                f"{sensor!r} reads {rest:.2f} m/s2 on average, which would be gravity in g: if the file is in g, "
                "displacement is 9.8 times too small; check --units"
            )
        sentences += _name_resolution(values[:, number], sensor)
        held = find_held_samples(values[:, number])
        if held > 1:
            sentences.append(
                f"{sensor!r}: every value is repeated {held} times: the sensor gives fewer samples than the file has "
                f"rows, and displacement lags by up to {held - 1} of them; record at the sensor's own rate"
            )
    return sentences


def _name_resolution(values: FloatArray, sensor: str) -> list[str]:
    """Axes in which the steps of a sensor's values are coarse beside their scatter."""
    coarse = []
    for axis in range(values.shape[1]):
        series = values[:, axis]
        steps = np.diff(np.unique(series))
        if steps.size and steps.min() > _COARSE * float(series.std()):
            coarse.append(f"{steps.min():.3g}")
    if not coarse:
        return []
    return [
        f"{sensor!r}: resolution is coarse, steps of {' and '.join(coarse)} m/s2 beside motion hardly larger in "
        f"{len(coarse)} of {values.shape[1]} axes; use a finer range"
    ]


def name_outliers(outliers: Sequence[Outliers], what: str, rules: OutlierRules) -> list[str]:
    """What the Hampel filter did to a series, or would have done, where it matters.

    Parameters
    ----------
    outliers
        Those of each piece of the series.
    what
        Names of sensor and axis.
    rules
        Rules by which they were treated.
    """
    worst = max(outliers, key=lambda one: one.energy, default=None)
    if worst is None or worst.energy <= rules.worth:
        return []
    found = (
        f"{worst.found:.2%} of samples, with {worst.energy:.1%} of the energy from {rules.band_hz[0]:g} to "
        f"{rules.band_hz[1]:g} Hz"
    )
    if rules.use == "on":
        return [f"{what}: the Hampel filter replaced {found}; where these are impacts, use --hampel off"]
    if rules.use == "off":
        return [f"{what}: the Hampel filter would have replaced {found}; where these are faults, use --hampel auto"]
    if worst.energy_spread > rules.worth:
        count = sum(int(one.replaced.sum()) for one in outliers)
        return [
            f"{what}: the Hampel filter of the recipe would have replaced {found}; they are spread over neighbouring "
            f"samples as impacts are, so {count} lone samples alone were replaced (--hampel on replaces all)"
        ]
    return [f"{what}: the Hampel filter replaced {found}, lone samples as faults are; --hampel off leaves them"]
