"""Sensitivity study: the error of the displacement against one parameter of the site at a time."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.progress import Progress
from vfm_sdm.studies.protocol.methods import WITH_SGR, WITHOUT_SGR, ComparedMethod
from vfm_sdm.studies.protocol.runs import FieldTest, prepare_field_test, run_method
from vfm_sdm.studies.synthetic.motion import Motion
from vfm_sdm.studies.synthetic.plan import Preset, Recording
from vfm_sdm.studies.synthetic.presets import Size, preset

__all__ = ["PARAMETERS", "SensitivityRow", "run_sensitivity", "sensitivity_plan"]

PARAMETERS: dict[str, dict[Size, tuple[float, ...]]] = {
    "amplitude [1]": {"small": (0.03, 0.2), "full": (0.01, 0.03, 0.1, 0.3)},
    "defocus [px]": {"small": (1.0, 2.5), "full": (0.5, 1.0, 1.7, 2.5)},
    "noise [grey levels]": {"small": (3.0, 8.0), "full": (2.0, 4.0, 8.0, 16.0)},
    "compression [crf]": {"small": (20.0, 30.0), "full": (8.0, 20.0, 26.0, 32.0)},
    "baseline [m]": {"small": (1.0, 2.0), "full": (0.5, 1.0, 2.0, 6.0)},
}
"""Values of each parameter beside that of the unchanged `sensitivity_plan`."""
_UNCHANGED = {
    "amplitude [1]": 1.0,
    "defocus [px]": 0.0,
    "noise [grey levels]": 1.0,
    "compression [crf]": 14.0,
    "baseline [m]": 4.0,
}
_WIDTH, _DURATION_S, _SUBSET_PX = 960, 4.0, 31
_CLOCK_STD_S = 0.002


@dataclass(frozen=True)
class SensitivityRow:
    """Error of one axis at one value of one parameter, over both monitored points."""

    parameter: str
    value: float
    method: str
    axis: str
    nrmse: float
    rms_error_mm: float


@dataclass(frozen=True)
class _ScaledMotion:
    """A motion with another amplitude."""

    motion: Motion
    factor: float

    @property
    def support_m(self) -> float:
        return self.motion.support_m

    @property
    def span_m(self) -> float:
        return self.motion.span_m

    @property
    def still_s(self) -> float:
        return self.motion.still_s

    def displacement(self, time_s: npt.ArrayLike, positions: npt.ArrayLike) -> FloatArray:
        return self.factor * self.motion.displacement(time_s, positions)

    def acceleration(self, time_s: npt.ArrayLike, positions: npt.ArrayLike) -> FloatArray:
        return self.factor * self.motion.acceleration(time_s, positions)


def sensitivity_plan() -> Preset:
    """``data-2`` in good light and focus, a quarter of the width, 4 s at 30 frames a second, cameras known."""
    plan = preset("data-2", "small")
    start_s = plan.recordings[1].start_s
    return replace(
        plan,
        name="sensitivity",
        site=replace(plan.site, image_size=(_WIDTH, _WIDTH * 9 // 16)),
        points=plan.points[:2],
        recordings=(Recording(), Recording(start_s=start_s)),
        accelerometers=plan.accelerometers,
        duration_s=_DURATION_S,
    )


def run_sensitivity(folder: Path, *, size: Size, progress: Progress | None = None) -> list[SensitivityRow]:
    """Errors [1, mm] with and without SGR at every value of every parameter.

    Parameters
    ----------
    folder
        Folder of the field tests and runs; what is there already is not done again.
    size
        ``small`` for two further values of each parameter, ``full`` for four.
    progress
        Called with the name of the step.
    """
    plan = sensitivity_plan()
    rows = _measure_errors("unchanged", plan, folder, progress)
    found = [_relabel(row, name, _UNCHANGED[name]) for name in PARAMETERS for row in rows]
    for name, values in PARAMETERS.items():
        for value in values[size]:
            rows = _measure_errors(f"{name.split()[0]} {value:g}", _CHANGES[name](plan, value), folder, progress)
            found += [_relabel(row, name, value) for row in rows]
    return sorted(found, key=lambda row: (list(PARAMETERS).index(row.parameter), row.value))


def _relabel(row: SensitivityRow, parameter: str, value: float) -> SensitivityRow:
    """The row as one of another parameter."""
    return replace(row, parameter=parameter, value=value)


def _measure_errors(name: str, plan: Preset, folder: Path, progress: Progress | None) -> list[SensitivityRow]:
    place = folder / name.replace(" ", "_")
    test = _give_cameras(prepare_field_test(place / "recording", replace(plan, name=name), progress=progress))
    rows = []
    for method in (WITHOUT_SGR, WITH_SGR):
        run, _ = run_method(
            test, ComparedMethod(method.label, cameras="file", refinement=method.refinement), place / "run"
        )
        for axis in ("vertical", "lateral"):
            scored = [] if run.displacement is None else test.against_truth(run.displacement).rows
            chosen = [row for row in scored if row.axis == axis]
            errors = [(row.score.nrmse_range, row.rms_error_mm) for row in chosen] or [(np.nan, np.nan)]
            nrmse, rms = (float(value) for value in np.mean(errors, axis=0))
            rows.append(SensitivityRow(name, np.nan, method.label, axis, nrmse, rms))
    return rows


def _give_cameras(test: FieldTest) -> FieldTest:
    """The field test with places and clocks of the further views given, so that only tracking and geometry count."""
    start = [recording.start_s for recording in test.plan.recordings]
    views = tuple(
        view.model_copy(update={"time_offset_s": s - start[0], "time_offset_std_s": _CLOCK_STD_S})
        for view, s in zip(test.session.view, start, strict=True)
    )
    further = dict(zip(test.plan.views[1:], test.plan.site.cameras()[1:], strict=True))
    places = {
        p.name: {view: tuple(camera.project(np.array(p.position)).tolist()) for view, camera in further.items()}
        for p in test.plan.points
    }
    points = tuple(p.model_copy(update={"pixel_in": places[p.name]}) for p in test.session.point)
    method = test.session.method.model_copy(update={"subset_px": _SUBSET_PX})
    return replace(test, session=test.session.model_copy(update={"view": views, "point": points, "method": method}))


def _change_recordings(plan: Preset, **changes: float | int) -> Preset:
    recordings = (replace(recording, **changes) for recording in plan.recordings)  # type: ignore[arg-type]
    return replace(plan, recordings=tuple(recordings))


def _change_baseline(plan: Preset, length_m: float) -> Preset:
    x, y, z = (length_m / plan.baseline_m * np.asarray(plan.site.further[0].center)).tolist()
    return replace(plan, site=plan.site.with_second_at((x, y, z)))


_CHANGES: dict[str, Callable[[Preset, float], Preset]] = {
    "amplitude [1]": lambda plan, value: replace(plan, motion=_ScaledMotion(plan.motion, value)),
    "defocus [px]": lambda plan, value: _change_recordings(plan, defocus_px=value),
    "noise [grey levels]": lambda plan, value: _change_recordings(plan, noise_std=value),
    "compression [crf]": lambda plan, value: _change_recordings(plan, crf=int(value)),
    "baseline [m]": _change_baseline,
}
