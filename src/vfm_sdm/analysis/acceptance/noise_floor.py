"""Noise floor: what a recording of a structure at rest shows as displacement."""

from typing import Any

import numpy as np
import xarray as xr
from scipy.signal import welch
from scipy.stats import chi2

from vfm_sdm.analysis.acceptance.records import Acceptance, AcceptanceRow, check_limit
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status, check_displacement
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.clocks import even_clock

__all__ = ["check_noise_floor"]

_FEWEST_SAMPLES = 10
_SEGMENT = 256
"""Samples of the longest segment of a spectrum."""
_CHANCE = 0.05
"""Probability with which scatter of the stated size exceeds its limit by chance."""


def check_noise_floor(
    displacement: xr.Dataset, *, limit_mm: float | None = None, interval_s: tuple[float, float] | None = None
) -> Acceptance:
    """Mean, standard deviation, drift and spectrum of each point and axis while the structure rests.

    Parameters
    ----------
    displacement
        Displacement dataset of a recording at rest, shape (T, P, 3) [mm].
    limit_mm
        Largest mean, standard deviation and drift that are accepted [mm]; without one, what the run states itself.
    interval_s
        Beginning and end of the part that counts [s]; all of it by default.

    Returns
    -------
    acceptance
        Three rows for each point and axis; ``details["spectra"]`` holds, by point and axis, ``frequency_hz`` and the
        root mean square of each line ``rms_mm``.

    Raises
    ------
    DatasetError
        This is no displacement, the limit is not positive, or nothing lies in the interval.

    Notes
    -----
    Only samples with status ok count. The drift is the slope of the least-squares line times the length of the
    recording. The spectrum is the mean of periodograms [1]_ with a Hann window, the root of power times width of a
    line, so that the squares of a spectrum add up to the variance.

    The run's own limit of mean and drift is the median expanded uncertainty (k = 2) of a sample. Scatter has the
    combined standard uncertainty as its limit, times what n independent samples exceed by chance in 5 % of all cases,
    ``sqrt(chi2(0.95, n) / n)``; of T samples with a correlation r from one to the next ``n = T (1 - r) / (1 + r)``
    count.

    References
    ----------
    .. [1] Welch, P. D. (1967). The use of fast Fourier transform for the estimation of power spectra. IEEE Transactions
       on Audio and Electroacoustics 15(2), 70-73.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> noise = np.random.default_rng(0).normal(0, 0.02, (300, 1, 3))
    >>> still = make_displacement(
    ...     np.arange(300) / 30,
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=noise,
    ...         displacement_std_mm=np.full((300, 1, 3), 0.02),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((300, 1, 3)),
    ...         reprojection_error_px=np.zeros((300, 1)),
    ...         status=np.zeros((300, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> result = check_noise_floor(still, limit_mm=0.03)
    >>> str(result.outcome), [round(row.value, 2) for row in result.rows[:3]]
    ('pass', [-0.0, 0.02, -0.0])
    """
    data = check_displacement(displacement)
    check_limit(limit_mm, "limit")
    if interval_s is not None:
        data = data.sel(time=slice(*interval_s))
    if data.sizes["time"] < _FEWEST_SAMPLES:
        raise DatasetError(
            f"noise floor: expected {_FEWEST_SAMPLES} frames or more, got {data.sizes['time']}; film longer, or "
            "correct the interval"
        )
    rows: list[AcceptanceRow] = []
    spectra: dict[str, dict[str, Any]] = {}
    for point in data["point"].values:
        for axis in data["axis"].values:
            series = data.sel(point=point, axis=axis)
            ok = (series["status"].values == Status.OK) & np.isfinite(series["displacement"].values)
            subject = f"{point} {axis}"
            rows += _judge(subject, series.isel(time=np.flatnonzero(ok)), limit_mm)
            spectra.setdefault(str(point), {})[str(axis)] = _compute_spectrum(data["time"].values, series, ok)
    limits = "stated by the run itself (k = 2)" if limit_mm is None else f"{limit_mm:g} mm"
    return Acceptance("noise-floor", limits, tuple(rows), details={"spectra": spectra})


def _judge(subject: str, series: xr.Dataset, limit_mm: float | None) -> list[AcceptanceRow]:
    """Mean, standard deviation and drift of one series, shape (T,) [mm]."""
    values, time_s = series["displacement"].values, series["time"].values
    names = ("mean", "std", "drift")
    if len(values) < _FEWEST_SAMPLES:
        return [AcceptanceRow(subject, name, float("nan"), float("nan"), "mm") for name in names]
    centred = values - values.mean()
    since = time_s - time_s.mean()
    drift = float(since @ centred / (since @ since) * (time_s[-1] - time_s[0]))
    found = (float(values.mean()), float(centred.std(ddof=1)), drift)
    limits = (limit_mm,) * 3 if limit_mm is not None else _state_limits(series, centred)
    return [AcceptanceRow(subject, *row, "mm") for row in zip(names, found, limits, strict=True)]


def _state_limits(series: xr.Dataset, centred: FloatArray) -> tuple[float, float, float]:
    """Limits of mean, standard deviation and drift that follow from the stated uncertainty [mm]."""
    stated = series["expanded_uncertainty"].values / 2 if "expanded_uncertainty" in series else np.full(1, np.nan)
    std = float(np.median(stated))
    correlation = float(centred[1:] @ centred[:-1] / max(float(centred @ centred), np.finfo(float).tiny))
    count = max(len(centred) * (1 - max(correlation, 0.0)) / (1 + max(correlation, 0.0)), 1.0)
    return 2 * std, std * float(np.sqrt(chi2.ppf(1 - _CHANCE, count) / count)), 2 * std


def _compute_spectrum(time_s: FloatArray, series: xr.Dataset, ok: np.ndarray[Any, np.dtype[np.bool_]]) -> Any:
    """Frequencies [Hz] and root mean square of each line [mm]; ``None`` of too few samples."""
    if ok.sum() < _FEWEST_SAMPLES:
        return None
    clock, rate_hz = even_clock(time_s)
    even = np.interp(clock, time_s[ok], series["displacement"].values[ok])
    frequency, density = welch(even, rate_hz, nperseg=min(_SEGMENT, len(even)), detrend="constant")
    return {"frequency_hz": frequency[1:], "rms_mm": np.sqrt(density * frequency[1])[1:]}
