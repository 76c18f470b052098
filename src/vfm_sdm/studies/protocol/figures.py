"""The figures of the protocol, in the paper's order."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.outputs.plots import file_stem
from vfm_sdm.outputs.plots.protocol import (
    plot_camera_poses,
    plot_comparison,
    plot_displacement3d,
    plot_parity,
    plot_refinement,
    plot_sensitivity,
    plot_trajectories,
    save_figure,
)
from vfm_sdm.signals.clocks import even_clock, interpolate
from vfm_sdm.signals.filters import band_pass
from vfm_sdm.studies.protocol.methods import WITH_SGR, WITHOUT_SGR
from vfm_sdm.studies.protocol.records import TestResult
from vfm_sdm.studies.protocol.sensitivity import SensitivityRow

__all__ = ["save_protocol_figures"]

_AXES = ("vertical", "lateral")
_BAND_HZ = (1.0, 10.0)
_LOGARITHMIC = ("amplitude [1]", "noise [grey levels]", "baseline [m]")


def save_protocol_figures(
    folder: Path, results: Mapping[str, TestResult], sensitivity: Sequence[SensitivityRow]
) -> list[Path]:
    """Writes all figures as PNG, named by field test and point, and returns their paths.

    Field tests outside the method's assumptions get trajectories and nothing that could pass for a result.

    Parameters
    ----------
    folder
        Folder of the figures; made when absent.
    results
        Results by field test.
    sensitivity
        Rows of the sensitivity study; may be empty.

    Raises
    ------
    ResultsError
        A figure cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, result in results.items():
        for label, figure in _draw_test(result):
            paths.append(save_figure(folder / f"{name}_{file_stem(label)}.png", figure))
    if sensitivity:
        records = [(row.parameter, row.value, row.method, row.axis, row.nrmse) for row in sensitivity]
        known = {row.parameter for row in sensitivity}
        figure = plot_sensitivity(records, log=[p for p in _LOGARITHMIC if p in known])
        paths.append(save_figure(folder / "sensitivity.png", figure))
    return paths


def _draw_test(result: TestResult) -> Iterator[tuple[str, Figure]]:
    run, before = result.runs.get(WITH_SGR), result.runs.get(WITHOUT_SGR)
    if run is None or before is None or run.displacement is None or before.displacement is None or run.aligned is None:
        return
    tracks = run.aligned
    for point in result.test.monitored:
        yield f"{point}_trajectories", plot_trajectories(tracks, point=point)
        if not result.test.plan.within_assumptions:
            continue
        view = str(run.displacement["refined_view"].sel(point=point).item())
        if view:
            refined = _add_correction(tracks, run.displacement, view, point)
            yield f"{point}_refinement", _find_figure(plot_refinement(tracks, refined, view=view, point=point))
        yield f"{point}_displacement", plot_displacement3d(before.displacement, run.displacement, point=point)
        time_s, series = _series(result, run.displacement, point)
        title = f"{result.test.plan.name}, {point}, 1 to 10 Hz"
        yield f"{point}_comparison", plot_comparison(time_s, series, title=title)
        if all("reference" in named for named in series.values()):
            yield f"{point}_parity", plot_parity(series, title=title)
    if result.test.plan.within_assumptions and run.cameras is not None and run.cameras.rig is not None:
        cameras = result.test.plan.site.cameras()
        world = np.array([point.position for point in result.test.plan.points])
        points3d = world @ cameras[0].rotation.T + cameras[0].translation
        rigs = {"true": Rig.from_world(run.cameras.rig.names, cameras, metric=True), "estimated": run.cameras.rig}
        axes = plot_camera_poses(rigs, frame=run.cameras.frame, points3d=points3d, title=result.test.plan.name)
        yield "camera_poses", _find_figure(axes)


def _add_correction(tracks: xr.Dataset, displacement: xr.Dataset, view: str, point: str) -> xr.Dataset:
    """The tracks with the correction of one point added to u of its refined view."""
    refined = tracks.sel(point=[point]).copy(deep=True)
    number = [str(v) for v in tracks["view"].values].index(view)
    refined["position"].values[number, :, 0, 0] += displacement["refinement_correction"].sel(point=point).values
    return refined


def _series(
    result: TestResult, displacement: xr.Dataset, point: str
) -> tuple[FloatArray, dict[str, dict[str, FloatArray]]]:
    """Vision, truth and the sensor's displacement on the video's clock, all in the sensors' band."""
    evaluation = result.evaluations["accelerometers"].get(WITH_SGR)
    time_s, rate_hz = even_clock(displacement["time"].values)
    band = _BAND_HZ if evaluation is None or evaluation.band_hz is None else evaluation.band_hz
    series = {}
    for axis in _AXES:
        truth = result.test.truth.sel(point=point, axis=axis)
        vision = displacement.sel(point=point, axis=axis)
        named = {"vision": (vision["time"].values, vision), "truth": (truth["time"].values, truth)}
        clock = None if evaluation is None else evaluation.synchronization
        if clock is not None and clock.ok and result.test.reference is not None:
            sensor = result.test.reference.sel(sensor=result.test.monitored[point], axis=axis)
            named["reference"] = (sensor["time"].values * clock.rate_ratio + clock.offset_s, sensor)
        aligned = {name: interpolate(have, s["displacement"].values, time_s) for name, (have, s) in named.items()}
        # Cut alike first: the ringing of the filter at the ends is then the same in all.
        known = np.isfinite(list(aligned.values())).all(axis=0)
        series[axis] = {name: band_pass(np.where(known, v, np.nan), rate_hz, band) for name, v in aligned.items()}
    return time_s, series


def _find_figure(axes: object) -> Figure:
    """The figure of axes."""
    figure = getattr(axes, "figure", None)
    if not isinstance(figure, Figure):
        raise TypeError(f"axes: expected matplotlib axes in a figure, got {type(axes).__name__}")
    return figure
