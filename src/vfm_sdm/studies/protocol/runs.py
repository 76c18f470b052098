"""Runs of the methods on the field tests; what is finished on disk is not done again."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from shutil import copyfile

import numpy as np
import xarray as xr

from vfm_sdm.analysis.evaluation import Evaluation, evaluate, read_sensors
from vfm_sdm.core.datasets import make_displacement
from vfm_sdm.core.files import replace_file
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Session, open_views, read_session, write_session
from vfm_sdm.measurement import Run
from vfm_sdm.outputs.results import write_displacement
from vfm_sdm.pipeline import displacement_of, synchronize_tracks
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.monocular import planar_displacement, scale_factor
from vfm_sdm.stages.refinement import refine
from vfm_sdm.stages.tracking.template import TemplateTracker
from vfm_sdm.studies.protocol.cost import Cost, measure_cost
from vfm_sdm.studies.protocol.methods import MONOCULAR, Method
from vfm_sdm.studies.synthetic.field_test import make_field_test
from vfm_sdm.studies.synthetic.plan import Preset

__all__ = [
    "FieldTest",
    "MethodRun",
    "Progress",
    "measure_geometry",
    "prepare_field_test",
    "run_method",
    "run_monocular",
]

Progress = Callable[[str, int, int | None], None]

_KNOWN_HEIGHT_M, _KNOWN_HEIGHT_STD = 0.5, 0.005
"""A dimension beside each point that gives the monocular baseline its scale, and its relative standard deviation."""
_PICK_STD_PX = 0.5
"""How well its two ends are pointed at."""
_REPETITIONS = 5


@dataclass(frozen=True, eq=False)
class FieldTest:
    """A field test on disk with its truth and its accelerometers' displacement.

    Parameters
    ----------
    plan
        What it shows.
    folder
        Its session folder.
    session
        As an engineer would have written it.
    truth
        Exact displacement.
    reference
        Displacement from the accelerometers, on their clock; ``None`` where it has none.
    """

    plan: Preset
    folder: Path
    session: Session
    truth: xr.Dataset
    reference: xr.Dataset | None

    @property
    def monitored(self) -> dict[str, str]:
        """Sensor at each monitored point."""
        return {mounted.point: mounted.sensor.name for mounted in self.plan.accelerometers}

    def against_truth(self, displacement: xr.Dataset) -> Evaluation:
        """Evaluation of the monitored points."""
        axes = [str(a) for a in displacement["axis"].values if a in ("lateral", "vertical")]
        return evaluate(displacement, self.truth, pairs={point: point for point in self.monitored}, axes=axes)

    def against_sensors(self, displacement: xr.Dataset) -> Evaluation | None:
        """Evaluation of the monitored points, the sensors' clock aligned to the video by the motion."""
        if self.reference is None:
            return None
        axes = [str(a) for a in displacement["axis"].values if a in ("lateral", "vertical")]
        return evaluate(displacement, self.reference, pairs=self.monitored, axes=axes)


@dataclass(eq=False)
class MethodRun:
    """What one method yields on one field test.

    Parameters
    ----------
    displacement
        ``None`` where there is none; ``status`` says why.
    cameras
        ``None`` for the monocular baseline.
    tracks
        By view, each on its own clock.
    status
        Of the cameras.
    """

    displacement: xr.Dataset | None
    cameras: CameraSolution | None = None
    tracks: Mapping[str, xr.Dataset] = field(default_factory=dict)
    status: str = "ok"


def prepare_field_test(folder: Path, plan: Preset, *, progress: Progress | None = None) -> FieldTest:
    """The field test, made where it is not on disk yet, with its accelerometers' displacement."""

    def step(done: int, total: int) -> None:
        if progress is not None:
            progress(f"filming {plan.name}", done, total)

    session = read_session(make_field_test(folder, plan, progress=step))
    reference = None
    if session.sensor:
        paths = [session.resolve(sensor.file) for sensor in session.sensor]
        reference = read_sensors(paths, sensors=[sensor.name for sensor in session.sensor])
    return FieldTest(plan, folder, session, read_displacement(folder / "truth.nc"), reference)


def run_method(
    test: FieldTest, method: Method, folder: Path, *, progress: Progress | None = None
) -> tuple[MethodRun, list[Cost]]:
    """Displacement by a method, and what its stages cost when they were run.

    Parameters
    ----------
    test
        The field test.
    method
        How to measure.
    folder
        For all methods on this test; methods with the same cameras and tracker share what they can.
    progress
        Called with what is being done.
    """
    chosen = {"tracker": method.tracker, "cameras": method.cameras, "refinement": method.refinement}
    session = test.session.model_copy(update={"method": test.session.method.model_copy(update=chosen)})
    if method.cameras == "file":
        views = [view.model_copy(update={"camera": Path("cameras_true.toml")}) for view in session.view]
        session = session.model_copy(update={"view": tuple(views)})
    place = folder / method.run_name
    place.mkdir(parents=True, exist_ok=True)
    run = Run(session, place, progress)
    run.check_method()
    write_session(place / "session.resolved.toml", session)
    # Trackers share the cameras and their cost; a run takes the files only if they belong to the same inputs.
    if not (place / "cameras.toml").exists():
        for cost in sorted(folder.glob(f"*+{method.cameras}/costs.json"))[:1]:
            copyfile(cost.with_name("cameras.toml"), place / "cameras.toml")
            copyfile(cost, place / "costs.json")
    frames = f"{test.plan.frames} frames, {len(session.point)} points"
    with measure_cost("camera parameter estimation", f"{len(session.view)} frames") as of_cameras:
        cameras = run.cameras()
    # Now already, lest a run that is cut short while tracking forgets it.
    _kept(place / "costs.json", [of_cameras], run.reused)
    with measure_cost("point tracking", frames, calls=len(session.view)) as of_tracking:
        tracks = run.tracks(cameras)
    costs = _kept(place / "costs.json", [of_cameras, of_tracking], run.reused)
    displacement = displacement_of(session, tracks, cameras)
    if displacement is not None:
        write_displacement(place / method.refinement, displacement)
    return MethodRun(displacement, cameras, tracks, cameras.status), costs


def measure_geometry(test: FieldTest, run: MethodRun) -> list[Cost]:
    """What triangulation and refinement of one point cost, the least of a few repetitions."""
    if run.cameras is None or run.cameras.rig is None or run.cameras.frame is None:
        return []
    rig, frame = run.cameras.rig, run.cameras.frame
    aligned = synchronize_tracks(test.session, run.tracks)[0].isel(point=[0])
    size = f"{aligned.sizes['time']} frames, 1 point"
    costs = []
    for task, work in (
        ("triangulation", lambda: triangulate(aligned["position"].values, rig)),
        ("triangulation + SGR", lambda: refine(aligned, rig, frame)),
    ):
        trials = []
        for _ in range(_REPETITIONS):
            with measure_cost(task, size) as cost:
                work()
            trials.append(cost)
        costs.append(min(trials, key=lambda one: one.seconds))
    return costs


def run_monocular(test: FieldTest, folder: Path, *, progress: Progress | None = None) -> MethodRun:
    """The paper's baseline: targets in the left view to 1/16 px, times a scale factor; vertical only.

    Notes
    -----
    The scale comes from a known height of the structure at each point, as the pixels between its ends tell it: with
    the errors of a drawing (0.5 %) and of pointing at both ends (0.5 px each). Image rows are taken for vertical.
    """
    place = folder / "monocular"
    kept = place / "displacement.nc"
    source = json.dumps([test.truth.attrs["films"], test.plan.seed])
    if kept.exists():
        earlier = read_displacement(place)
        if earlier.attrs.get("source") == source:
            return MethodRun(earlier)
    view = test.session.reference_view.name
    video = open_views(test.session)[view]
    camera = test.plan.site.cameras()[0]
    points = [p for p in test.plan.points if p.name in test.monitored]
    tracker = TemplateTracker(subset_px=test.session.method.subset_px)
    tracks = tracker.track(
        video,
        np.array([camera.project(np.array(point.position)) for point in points]),
        names=[point.name for point in points],
        progress=None if progress is None else lambda done: progress("monocular baseline", done, test.plan.frames),
    )
    rng = np.random.default_rng([test.plan.seed, len(points)])
    columns = []
    for point in points:
        half = np.array([0.0, _KNOWN_HEIGHT_M / 2, 0.0])
        ends = [camera.project(point.position + sign * half) + rng.normal(0, _PICK_STD_PX, 2) for sign in (-1, 1)]
        height = _KNOWN_HEIGHT_M * (1 + rng.normal(0, _KNOWN_HEIGHT_STD))
        factor = scale_factor(ends[0], ends[1], 1e3 * height)
        columns.append(planar_displacement(tracks.sel(point=[point.name]), factor).sel(axis=["down"]))
    planar = xr.concat(columns, dim="point", join="exact")
    still = planar["time"] <= test.plan.still_s
    values = planar["displacement"] - planar["displacement"].where(still).mean("time")
    shape = values.transpose("time", "point", "axis").shape
    displacement = make_displacement(
        planar["time"].values,
        [point.name for point in points],
        ["vertical"],
        displacement_mm=values.transpose("time", "point", "axis").values,
        displacement_std_mm=planar["displacement_std"].transpose("time", "point", "axis").values,
        scale_std=np.full(shape[1:], _KNOWN_HEIGHT_STD),
        position_m=np.full(shape, np.nan),
        reprojection_error_px=np.full(shape[:2], np.nan),
        status=planar["status"].transpose("time", "point").values,
        attrs={"frame": "image plane", "method": MONOCULAR.label, "source": source},
    )
    write_displacement(place, displacement)
    return MethodRun(displacement)


def _kept(path: Path, costs: list[Cost], reused: list[str]) -> list[Cost]:
    """Costs of stages as they were when they were run, not those of reading their results again."""
    earlier = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    names = {"cameras": "camera parameter estimation", "tracking": "point tracking"}
    again = {names[stage] for stage in reused}
    known = [Cost(**earlier[c.task]) if c.task in again and c.task in earlier else c for c in costs]
    with replace_file(path) as temporary:
        temporary.write_text(json.dumps(earlier | {c.task: asdict(c) for c in known}, indent=1), encoding="utf-8")
    return known
