"""``summary.json``: the main values of a measurement, with null where nothing is known."""

import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import STATUS_MEANINGS, Status, check_displacement
from vfm_sdm.core.files import write_json
from vfm_sdm.core.grids import grid_points, without_grids
from vfm_sdm.errors import ResultsError
from vfm_sdm.outputs.results.notes import (
    describe_camera_motion,
    describe_clocks,
    describe_recording,
    describe_refinement,
    describe_subsets,
    displacement_notes,
    recording_notes,
    subset_notes,
)
from vfm_sdm.signals.spectrum import detection_limit, dominant_frequency
from vfm_sdm.stages.audit import Audit
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = [
    "describe_measurement",
    "difference_variance",
    "read_summary",
    "summarize_displacement",
    "summarize_series",
    "write_summary",
]

_PROPORTIONAL = ("cameras", "compression", "subset")
"""Components of the budget that are proportional to the motion."""
_SHARED = ("origin",)
"""Components that all samples share: no distance between two samples holds them."""


def write_summary(folder: Path | str, summary: Mapping[str, Any]) -> Path:
    """Writes ``summary.json``; numbers that are not finite become null.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    summary
        Tables and lists of text, numbers, truth values, NumPy scalars and arrays, paths and ``None``.

    Raises
    ------
    ResultsError
        The file cannot be written, or a value is of another type.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     print(read_summary(write_summary(folder, {"status": "ok", "epipolar_rms_px": float("nan")})))
    {'status': 'ok', 'epipolar_rms_px': None}
    """
    return write_json(Path(folder) / "summary.json", summary, label="summary")


def read_summary(path: Path | str) -> dict[str, Any]:
    """The summary of a run folder.

    Parameters
    ----------
    path
        The run folder, or the file itself.

    Raises
    ------
    ResultsError
        The file is missing or damaged.
    """
    source = Path(path) / "summary.json" if Path(path).is_dir() else Path(path)
    try:
        found = json.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ResultsError(f"{source}: expected a summary, got no such file; run `vfm-sdm measure`") from error
    except (OSError, ValueError) as error:
        raise ResultsError(f"{source}: expected a summary, got: {error}; run `vfm-sdm measure` again") from error
    if not isinstance(found, dict):
        raise ResultsError(f"{source}: expected a table, got {type(found).__name__}; run `vfm-sdm measure` again")
    return found


def describe_measurement(
    cameras: CameraSolution, tracks: Mapping[str, xr.Dataset], displacement: xr.Dataset | None, audit: Audit | None
) -> dict[str, Any]:
    """Main values of the products of a measurement, ready for `write_summary`.

    Parameters
    ----------
    cameras
        Cameras, axes and points.
    tracks
        Tracks by view, shape (T, P, 2) [px], each on its own clock.
    displacement
        Displacement dataset, shape (T, P, 3) [mm]; ``None`` where there is none.
    audit
        Checks and verdict; ``None`` where there are none.
    """
    named = {view: without_grids(of_view) for view, of_view in tracks.items()}
    return {
        "status": cameras.status,
        "system": {"platform": platform.platform(), "processor": platform.machine(), "processors": os.cpu_count()},
        "audit": None if audit is None else audit.as_table(),
        "scale": None if audit is None or audit.scale is None else audit.scale.as_table(),
        "grids": {} if displacement is None else summarize_grids(displacement),
        "notes": [*subset_notes(named), *cameras.notes, *recording_notes(tracks), *displacement_notes(displacement)],
        "points": {} if displacement is None else summarize_displacement(without_grids(displacement)),
        "frame": None if displacement is None else displacement.attrs["frame"],
        "cameras": {
            "epipolar_rms_px": cameras.epipolar_rms_px,
            "quantities": [{**asdict(q), "determined": q.determined} for q in cameras.quantities],
            "point_status": {
                str(view): cameras.points["status"].sel(view=view).to_series().to_dict()
                for view in cameras.points["view"].values
            },
        },
        "subsets": {view: describe_subsets(t) for view, t in named.items()},
        "recordings": {view: describe_recording(t) for view, t in tracks.items()},
        "clocks": {} if displacement is None else describe_clocks(displacement),
        "camera_motion": {} if displacement is None else describe_camera_motion(displacement),
        "refinement": {} if displacement is None else describe_refinement(displacement),
    }


def summarize_grids(displacement: xr.Dataset) -> dict[str, dict[str, Any]]:
    """By grid: how many ``points`` it has, and ``coverage_valid``, the share of samples that are ok, by name [1].

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    """
    names = grid_points(displacement)
    if not names:
        return {}
    chosen = displacement[["grid", "status"]].sel(point=names)
    share = (chosen["status"].values == Status.OK).mean(axis=0)
    summary: dict[str, dict[str, Any]] = {}
    for name, grid, valid in zip(names, chosen["grid"].values.tolist(), share.tolist(), strict=True):
        one = summary.setdefault(str(grid), {"points": 0, "coverage_valid": {}})
        one["points"] += 1
        one["coverage_valid"][name] = valid
    return summary


def summarize_displacement(displacement: xr.Dataset) -> dict[str, Any]:
    """Main values of each point and axis, ready for `write_summary`.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].

    Returns
    -------
    summary
        By point name: ``coverage_valid`` (share of frames with status ok [1]), ``status_counts`` (frames by status)
        and ``axes``, by axis name: ``peak_to_peak_mm``, ``rms_mm`` (about the zero of the displacement),
        ``random_std_mm`` (median), ``detection_limit_mm`` (smallest amplitude of a sinusoid that is told from the
        random part over the recording, `vfm_sdm.signals.spectrum.detection_limit`), ``scale_std`` [1],
        ``expanded_uncertainty_mm`` (of the peak-to-peak, k = 2),
        ``budget_mm`` (root mean square over time of each component of the uncertainty of a sample, k = 1) and
        ``dominant_frequency_hz``. Only frames with status ok count; the value is None where these do not tell it.

    Notes
    -----
    The peak-to-peak is ``x_a - x_b`` with the extremes at frames a and b. Components of the uncertainty that are
    proportional to the motion add up over the two, the others are taken as independent. Where a dataset holds no
    budget, the expanded uncertainty is ``U = 2 sqrt(s_a^2 + s_b^2 + (s_scale (x_a - x_b))^2)`` from its random part and
    scale. The tendency of extremes of noise to lie apart is not in it: of motion within the noise, the peak-to-peak
    shows the noise.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> displacement = make_displacement(
    ...     [0.0, 0.1],
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=[[[0.0, 0.0, 0.0]], [[0.5, 2.0, 0.1]]],
    ...         displacement_std_mm=np.full((2, 1, 3), 0.1),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((2, 1, 3)),
    ...         reprojection_error_px=np.zeros((2, 1)),
    ...         status=np.zeros((2, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> summarize_displacement(displacement)["mid"]["axes"]["vertical"]["peak_to_peak_mm"]
    2.0
    """
    data = check_displacement(displacement)
    time_s = data["time"].values
    summary: dict[str, Any] = {}
    for point in data["point"].values:
        of_point = data.sel(point=point)
        status = of_point["status"].values
        ok = status == Status.OK
        summary[str(point)] = {
            "coverage_valid": float(ok.mean()) if ok.size else None,
            "status_counts": {name: int((status == code).sum()) for code, name in enumerate(STATUS_MEANINGS)},
            "axes": {str(axis): summarize_series(of_point.sel(axis=axis), time_s, ok) for axis in data["axis"].values},
        }
    return summary


def summarize_series(series: xr.Dataset, time_s: FloatArray, ok: BoolArray) -> dict[str, Any]:
    """Main values of one point along one axis, as `summarize_displacement` lists them.

    Parameters
    ----------
    series
        Displacement dataset of this point and axis, shape (T,) [mm].
    time_s
        Time stamps, shape (T,) [s].
    ok
        Frames that count, shape (T,).
    """
    values = np.where(ok, series["displacement"].values, np.nan)
    std = series["displacement_std"].values
    scale_std = float(series["scale_std"])
    found = np.isfinite(values)
    summary: dict[str, Any] = {
        "peak_to_peak_mm": None,
        "rms_mm": None,
        "random_std_mm": None,
        "detection_limit_mm": None,
        "scale_std": _replace_unknown(scale_std),
        "expanded_uncertainty_mm": None,
        "budget_mm": None,
        "dominant_frequency_hz": None,
    }
    if not found.any():
        return summary
    top, bottom = int(np.nanargmax(values)), int(np.nanargmin(values))
    span = float(values[top] - values[bottom])
    known_std = std[found & np.isfinite(std)]
    summary["peak_to_peak_mm"] = span
    summary["rms_mm"] = float(np.sqrt(np.mean(values[found] ** 2)))
    summary["random_std_mm"] = float(np.median(known_std)) if known_std.size else None
    if known_std.size:
        noise = float(np.sqrt(np.mean(known_std**2)))
        summary["detection_limit_mm"] = _replace_unknown(detection_limit(noise, int(found.sum())))
    variance = std[top] ** 2 + std[bottom] ** 2 + (scale_std * span) ** 2
    if "uncertainty" in series:
        budget = {str(name): series["uncertainty"].sel(component=name).values for name in series["component"].values}
        summary["budget_mm"] = {
            name: _replace_unknown(float(np.sqrt(np.mean(u[found] ** 2)))) for name, u in budget.items()
        }
        variance = difference_variance(
            {name: u[top] for name, u in budget.items()}, {name: u[bottom] for name, u in budget.items()}
        )
    summary["expanded_uncertainty_mm"] = _replace_unknown(COVERAGE_FACTOR * float(np.sqrt(variance)))
    summary["dominant_frequency_hz"] = dominant_frequency(time_s, values)
    return summary


def difference_variance(first: Mapping[str, float], second: Mapping[str, float]) -> float:
    """Variance of the distance between two samples, or means, on either side of the zero [mm2].

    Parameters
    ----------
    first, second
        Standard deviations of each by component of the budget, k = 1 [mm].

    Examples
    --------
    >>> difference_variance({"random": 3.0, "cameras": 1.0, "origin": 9.0}, {"random": 4.0, "cameras": 2.0})
    34.0
    """
    # Errors that grow with the motion have opposite signs at the extremes, and add up.
    return float(
        sum(
            (u + second[name]) ** 2 if name in _PROPORTIONAL else u**2 + second[name] ** 2
            for name, u in first.items()
            if name not in _SHARED
        )
    )


def _replace_unknown(value: float) -> float | None:
    return value if np.isfinite(value) else None
