"""The demonstration: make a synthetic recording with known motion, measure it, compare."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.pipeline import Progress
from vfm_sdm.studies.synthetic.field_test import make_demo

__all__ = ["DemoResult", "TruthRow", "compare_with_truth", "run_demo"]


@dataclass(frozen=True)
class TruthRow:
    """One point and axis of a measurement beside the truth."""

    point: str
    axis: str
    true_peak_to_peak_mm: float
    peak_to_peak_mm: float
    rms_error_mm: float
    gain: float
    """Regression slope of measured on true; NaN where the truth hardly moves."""


@dataclass(frozen=True, eq=False)
class DemoResult:
    """What the demonstration yields."""

    measurement: Measurement
    rows: tuple[TruthRow, ...]
    run_folder: Path


def run_demo(folder: Path | str, *, seed: int = 1, progress: Progress | None = None) -> DemoResult:
    """Makes a field test in ``folder/recording``, measures it into ``folder/run``, and compares it with the truth.

    Parameters
    ----------
    folder
        Where to write.
    seed
        Of everything random.
    progress
        See `vfm_sdm.pipeline.Progress`.
    """
    recording, run_folder = Path(folder) / "recording", Path(folder) / "run"
    step = None if progress is None else lambda done, total: progress("making the recording", done, total)
    session = make_demo(recording, seed=seed, progress=step)
    measurement = measure(read_session(session), run_folder, progress=progress)
    rows: tuple[TruthRow, ...] = ()
    if measurement.displacement is not None:
        rows = compare_with_truth(measurement.displacement, read_displacement(session.parent / "truth.nc"))
    return DemoResult(measurement, rows, run_folder)


def compare_with_truth(measured: xr.Dataset, truth: xr.Dataset) -> tuple[TruthRow, ...]:
    """Rows of measured beside true displacement, for every point and axis of the measurement.

    Raises
    ------
    DatasetError
        The two have other clocks or axes.
    """
    same_axes = list(measured["axis"].values) == list(truth["axis"].values)
    same_clock = measured.sizes["time"] == truth.sizes["time"] and np.allclose(
        measured["time"], truth["time"], atol=1e-4
    )
    if not (same_axes and same_clock):
        raise DatasetError("truth: expected the axes and the clock of the measurement; compare like with like")
    rows = []
    for point in measured["point"].values:
        for axis in measured["axis"].values:
            seen = measured["displacement"].sel(point=point, axis=axis).values
            true = truth["displacement"].sel(point=point, axis=axis).values
            both = np.isfinite(seen)
            moving = np.ptp(true) > 0.1
            gain = float(np.polyfit(true[both], seen[both], 1)[0]) if moving and both.sum() > 2 else float("nan")
            rows.append(
                TruthRow(
                    str(point),
                    str(axis),
                    float(np.ptp(true)),
                    float(np.ptp(seen[both])) if both.any() else float("nan"),
                    float(np.sqrt(np.mean((seen - true)[both] ** 2))) if both.any() else float("nan"),
                    gain,
                )
            )
    return tuple(rows)
