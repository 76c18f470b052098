"""Runs of the methods on the field tests; what is finished on disk is not done again."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import copyfile

import numpy as np
import xarray as xr

from vfm_sdm.analysis.evaluation import Evaluation, evaluate, read_sensors
from vfm_sdm.core.files import write_file
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Length, Point, Session, Site, read_session, write_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.plots import file_stem
from vfm_sdm.outputs.results import write_displacement
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.refinement import refine
from vfm_sdm.studies.protocol.cost import Cost, measure_cost
from vfm_sdm.studies.protocol.methods import MONOCULAR, ComparedMethod
from vfm_sdm.studies.synthetic.field_test import make_field_test
from vfm_sdm.studies.synthetic.plan import Preset

__all__ = [
    "FieldTest",
    "MethodRun",
    "measure_geometry",
    "prepare_field_test",
    "run_method",
    "run_monocular",
]

_KNOWN_HEIGHT_M, _KNOWN_HEIGHT_STD = 0.5, 0.005
"""Known length beside each point that gives the monocular method its scale [m], and its standard deviation [1]."""
_ENDS = ("upper end", "lower end")
_PICK_STD_PX = 0.5
"""Standard deviation of pointing at its two ends [px]."""
_REPETITIONS = 5


@dataclass(frozen=True, eq=False)
class FieldTest:
    """A field test on disk with its truth and its accelerometers' displacement.

    Parameters
    ----------
    plan
        Settings of the field test.
    folder
        Folder of its session.
    session
        Session as an engineer would have written it.
    truth
        Exact displacement, shape (T, P, 3) [mm].
    reference
        Displacement from the accelerometers on their clock, shape (T', S, 3) [mm]; ``None`` where it has none.
    """

    plan: Preset
    folder: Path
    session: Session
    truth: xr.Dataset
    reference: xr.Dataset | None

    @property
    def monitored(self) -> dict[str, str]:
        """Name of the sensor at each monitored point."""
        return {mounted.point: mounted.sensor.name for mounted in self.plan.accelerometers}

    def against_truth(self, displacement: xr.Dataset) -> Evaluation:
        """Evaluation of the monitored points against the truth.

        Parameters
        ----------
        displacement
            Displacement dataset, shape (T, P, A) [mm].
        """
        axes = [str(a) for a in displacement["axis"].values if a in ("lateral", "vertical")]
        return evaluate(displacement, self.truth, pairs={point: point for point in self.monitored}, axes=axes)

    def against_sensors(self, displacement: xr.Dataset) -> Evaluation | None:
        """Evaluation of the monitored points against the sensors, whose clock is aligned by the motion.

        Parameters
        ----------
        displacement
            Displacement dataset, shape (T, P, A) [mm].
        """
        if self.reference is None:
            return None
        axes = [str(a) for a in displacement["axis"].values if a in ("lateral", "vertical")]
        return evaluate(displacement, self.reference, pairs=self.monitored, axes=axes)


@dataclass(eq=False)
class MethodRun:
    """Result of one method on one field test.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, A) [mm]; ``None`` where there is none, and then ``status`` says why.
    cameras
        Cameras of the run; ``None`` for the monocular method.
    aligned
        Tracks that the displacement was made of, on one clock, shape (V, T, P, 2) [px], before any refinement; ``None``
        where there are none.
    status
        Status of the cameras.
    """

    displacement: xr.Dataset | None
    cameras: CameraSolution | None = None
    aligned: xr.Dataset | None = None
    status: str = CameraStatus.OK


def prepare_field_test(folder: Path, plan: Preset, *, progress: Progress | None = None) -> FieldTest:
    """The field test, made where it is not on disk yet, with its accelerometers' displacement [mm].

    Parameters
    ----------
    folder
        Folder of the field test.
    plan
        Settings of the field test.
    progress
        Called with the name of the step and the frames done.
    """
    session = read_session(make_field_test(folder, plan, progress=progress))
    reference = None
    if session.sensor:
        paths = [session.resolve(sensor.file) for sensor in session.sensor]
        reference = read_sensors(paths, sensors=[sensor.name for sensor in session.sensor])
    return FieldTest(plan, folder, session, read_displacement(folder / "truth.nc"), reference)


def run_method(
    test: FieldTest, method: ComparedMethod, folder: Path, *, progress: Progress | None = None
) -> tuple[MethodRun, list[Cost]]:
    """Displacement [mm] by a method, and the costs of its stages when they were run.

    Parameters
    ----------
    test
        The field test.
    method
        Method to measure with.
    folder
        Folder of all methods on this test; methods with the same cameras and tracker share what they can.
    progress
        Called with the name of the step.
    """
    chosen = {"tracker": method.tracker, "cameras": method.cameras, "refinement": method.refinement}
    session = test.session.model_copy(update={"method": test.session.method.model_copy(update=chosen)})
    if method.cameras == "file":
        views = [view.model_copy(update={"camera": Path("cameras_true.toml")}) for view in session.view]
        session = session.model_copy(update={"view": tuple(views)})
    place = folder / method.run_name
    place.mkdir(parents=True, exist_ok=True)
    measurement = Measurement(session, place, progress=progress)
    measurement.check_method()
    write_session(place / "session.resolved.toml", session)
    # Trackers share the cameras and their cost; a run takes the files only if they belong to the same inputs.
    if not (place / "cameras.toml").exists():
        for cost in sorted(folder.glob(f"*+{method.cameras}/costs.json"))[:1]:
            copyfile(cost.with_name("cameras.toml"), place / "cameras.toml")
            copyfile(cost, place / "costs.json")
    frames = f"{test.plan.frames} frames, {len(session.point)} points"
    with measure_cost("camera parameter estimation", f"{len(session.view)} frames") as of_cameras:
        cameras = measurement.cameras
    # Written now already, so that a run that is cut short while tracking does not forget it.
    _keep_costs(place / "costs.json", [of_cameras], measurement.reused)
    with measure_cost("point tracking", frames, calls=len(session.view)) as of_tracking:
        _ = measurement.tracks
    costs = _keep_costs(place / "costs.json", [of_cameras, of_tracking], measurement.reused)
    if (displacement := measurement.displacement) is None:
        return MethodRun(None, cameras, None, cameras.status), costs
    write_displacement(place / method.refinement, displacement)
    return MethodRun(displacement, cameras, measurement.aligned, cameras.status), costs


def measure_geometry(run: MethodRun) -> list[Cost]:
    """Costs of triangulation and refinement of one point, the least of a few repetitions.

    Parameters
    ----------
    run
        A run whose tracks, shape (V, T, P, 2) [px], and cameras are known.
    """
    if run.aligned is None or run.cameras is None or run.cameras.rig is None or run.cameras.frame is None:
        return []
    rig, frame = run.cameras.rig, run.cameras.frame
    aligned = run.aligned.isel(point=[0])
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
    """Run of the paper's baseline: one view, and a known height beside each point; vertical only.

    Parameters
    ----------
    test
        Field test.
    folder
        Folder for the runs of all methods on this test.
    progress
        Called with each step's description.

    Returns
    -------
    run
        Vertical displacement of all points [m], or a status where the cameras could not be estimated.

    Notes
    -----
    Each monitored point is a session of its own, whose scale is the height of the structure at this point: with the
    errors of a drawing (0.5 %) and of pointing at both ends (0.5 px each). Image rows count as vertical.
    """
    columns = []
    for session in _monocular_sessions(test):
        point = session.point[0].name
        measurement = Measurement(session, folder / "monocular" / file_stem(point), progress=progress)
        displacement = measurement.displacement
        if displacement is None:
            return MethodRun(None, status=measurement.cameras.status)
        columns.append(displacement.sel(point=[point], axis=["down"]).assign_coords(axis=["vertical"]))
    displacement = xr.concat(columns, dim="point", join="exact", combine_attrs="drop_conflicts")
    return MethodRun(displacement.assign_attrs(method=MONOCULAR.label))


def _monocular_sessions(test: FieldTest) -> Iterator[Session]:
    """A session of the reference view for each monitored point, with the ends of a known height beside it."""
    camera = test.plan.site.cameras()[0]
    points = [p for p in test.plan.points if p.name in test.monitored]
    view = test.session.reference_view
    method = {"tracker": MONOCULAR.tracker, "refinement": "none", "still_interval_s": (0.0, test.plan.still_s)}
    rng = np.random.default_rng([test.plan.seed, len(points)])
    for point in points:
        half = np.array([0.0, _KNOWN_HEIGHT_M / 2, 0.0])
        ends = [camera.project(point.position + sign * half) + rng.normal(0, _PICK_STD_PX, 2) for sign in (-1, 1)]
        height = _KNOWN_HEIGHT_M * (1 + rng.normal(0, _KNOWN_HEIGHT_STD))
        places = {point.name: camera.project(np.array(point.position)), **dict(zip(_ENDS, ends, strict=True))}
        length = Length(points=_ENDS, value=height, std=_KNOWN_HEIGHT_STD * height)
        yield test.session.model_copy(
            update={
                "view": (view,),
                "point": tuple(Point(name=n, view=view.name, pixel=tuple(uv.tolist())) for n, uv in places.items()),
                "site": Site(length=(length,)),
                "method": test.session.method.model_copy(update=method),
            }
        )


def _keep_costs(path: Path, costs: list[Cost], reused: list[str]) -> list[Cost]:
    """Costs of stages as they were when they were run, not those of reading their results again."""
    earlier = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    names = {"cameras": "camera parameter estimation", "tracking": "point tracking"}
    again = {names[stage] for stage in reused}
    known = [Cost(**earlier[c.task]) if c.task in again and c.task in earlier else c for c in costs]
    write_file(path, json.dumps(earlier | {c.task: asdict(c) for c in known}, indent=1))
    return known
