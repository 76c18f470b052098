"""Synthetic field tests: a footbridge filmed by two cameras or more, written as a session folder with its truth."""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement
from vfm_sdm.core.netcdf import read_displacement, write_dataset
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.inputs.session import write_session
from vfm_sdm.stages.cameras.file import write_rig
from vfm_sdm.studies.synthetic.disturbance_truth import true_disturbances
from vfm_sdm.studies.synthetic.disturbances import Disturbances
from vfm_sdm.studies.synthetic.film import film_view
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode
from vfm_sdm.studies.synthetic.plan import Preset, Recording, Site, SiteErrors, SitePoint, view_names
from vfm_sdm.studies.synthetic.recording import write_video
from vfm_sdm.studies.synthetic.scene import Scene
from vfm_sdm.studies.synthetic.sensors import write_acceleration
from vfm_sdm.studies.synthetic.survey import make_sessions, true_points

__all__ = ["demo_plan", "make_demo", "make_field_test"]

_VERSION = version("vfm-sdm")
_SHORTEST_S = 0.5
_SENSOR_MARGIN_S = 2.0
"""How much longer than the videos the accelerometers record [s]."""
_PARAMETERS = len(CAMERA_PARAMETERS)
_DEMO_FPS = 30
_DEMO_MODES = (
    Mode("vertical", 2.2, 4.5, damping_ratio=0.012),
    Mode("vertical", 6.1, 0.5, damping_ratio=0.015, half_waves=2),
    Mode("lateral", 1.4, 1.8, damping_ratio=0.010),
    Mode("longitudinal", 2.2, 0.25, damping_ratio=0.012, half_waves=0),
)
# Some 60 Mbit/s, as action cameras write 4K: harder compression would be the largest error of the demonstration.
_DEMO_RECORDING = Recording(exposure_s=0.0, crf=4)


def make_field_test(folder: Path | str, plan: Preset, *, progress: Progress | None = None) -> Path:
    """Writes a virtual field test as a session folder and returns its ``session.toml``.

    Parameters
    ----------
    folder
        New, empty, or of an earlier field test, which is replaced; videos that would be the same are kept, so that work
        that was cut short goes on. Gets a video for every view (``left.mp4``, ``right.mp4``), a CSV file for every
        accelerometer, ``session.toml``, ``truth.nc``, the displacement dataset's layout, exact, and
        ``cameras_true.toml``; of a plan with further readings also ``session_further.toml`` with these, and
        ``points_true.nc``, the layout of ``points.nc``, with where every view sees the points; of a plan with
        disturbances also ``disturbances_true.nc``, `vfm_sdm.studies.synthetic.disturbance_truth.true_disturbances`.
    plan
        What to film; the same plan gives the same bytes.
    progress
        Called with what is filmed, the number of frames written so far and the number of all.

    Raises
    ------
    ResultsError
        The folder holds files of these names that are not of a field test, or cannot be written.
    VideoError
        A video cannot be written.

    Notes
    -----
    Values in the session are the true ones with errors of the size of their standard deviations. The displacement in
    ``truth.nc`` is along the true structural axes, relative to the rest, at the frames of the reference view.
    """
    videos = [f"{name}.mp4" for name in plan.views]
    target, films = _prepare(Path(folder), [*videos, *(f"{m.sensor.name}.csv" for m in plan.accelerometers)])
    try:
        for number, video in enumerate(videos):
            if number >= len(films) or films[number] != _film_hash(plan, number):
                (target / video).unlink(missing_ok=True)
        write_dataset(target / "truth.nc", _truth(plan))
        for number in range(len(plan.accelerometers)):
            _write_sensor(target, plan, number)
        if any(recording.disturbances != Disturbances() for recording in plan.recordings):
            write_dataset(target / "disturbances_true.nc", true_disturbances(plan))
        if plan.further is not None:
            write_dataset(target / "points_true.nc", true_points(plan, _scene(plan.site, plan.seed)))
        # What a camera calibrated beforehand would be taken from.
        cameras = Rig.from_world(plan.views, plan.site.cameras(), metric=True)
        write_rig(target / "cameras_true.toml", replace(cameras, covariance=np.zeros(2 * [len(cameras) * _PARAMETERS])))
    except ResultsError:
        raise
    except OSError as error:
        raise ResultsError(f"{target}: expected to write to this folder, got: {error}; choose another") from error
    missing = [view for view, video in enumerate(videos) if not (target / video).exists()]
    scene = _scene(plan.site, plan.seed) if missing else None
    for view, video in enumerate(videos):
        path = target / video
        if scene is not None and view in missing:
            frames, chroma = film_view(plan, scene, view)
            write_video(
                path,
                _counted(frames, plan, view, progress),
                fps=plan.fps,
                chroma=chroma,
                options={**_rate(plan, view), **plan.encoder},
                stamps=plan.stamps(view),
            )
    sessions = make_sessions(plan, target)
    for name in list(sessions)[1:]:
        write_session(target / name, sessions[name])
    # Last, so that a folder whose making was cut short is no session.
    return write_session(target / "session.toml", sessions["session.toml"])


def demo_plan(*, seed: int = 2026, duration_s: float = 3.0, site: FootbridgeSite | None = None) -> Preset:
    """Two modes of vertical, one of lateral and a slide of longitudinal motion, after 0.4 s at rest.

    Parameters
    ----------
    seed
        Of textures, sensor noise and errors of the measurements on site.
    duration_s
        At 30 frames a second [s].
    site
        Places of footbridge and cameras.

    Raises
    ------
    SessionError
        The recording would be too short.
    """
    if not duration_s >= _SHORTEST_S:
        raise SessionError(f"duration_s: expected at least {_SHORTEST_S} s, got {duration_s}; make it longer")
    site = FootbridgeSite() if site is None else site
    face, cameras = site.perpendicular_m, 1 + len(site.further)
    motion = ModalMotion(_DEMO_MODES, support_m=site.support_m, span_m=site.span_m)
    return Preset(
        name="synthetic footbridge",
        size="demo",
        description="good light, cameras that start together",
        site=site,
        motion=motion,
        points=(
            SitePoint("1/4 span", (face, 0.02, site.station(1 / 4))),
            SitePoint("3/8 span", (face, -0.02, site.station(3 / 8))),
            SitePoint("1/2 span", (face, 0.02, site.station(1 / 2))),
            SitePoint("deck edge", (face - 0.14, -0.455, site.station(0.44))),
            SitePoint("abutment", (face - 0.1, 0.79, site.longitudinal_m - 0.5), static=True),
            SitePoint("abutment corner", (face - 0.1, 0.77, site.longitudinal_m - 1.1), static=True),
        ),
        recordings=(_DEMO_RECORDING,) * cameras,
        views=view_names(cameras),
        accelerometers=(),
        fps=_DEMO_FPS,
        duration_s=duration_s,
        still_s=motion.still_s,
        errors=SiteErrors(0.005, 0.01, 0.02, level_deg=0.1, range_m=0.005, lens_relative=0.02),
        seed=seed,
        ranged="3/8 span",
        refinement="none",
        synchronization="none",
        encoder={"preset": "veryfast", "tune": "grain", "threads": "2"},
    )


def make_demo(
    folder: Path | str,
    *,
    seed: int = 2026,
    duration_s: float = 3.0,
    site: FootbridgeSite | None = None,
    progress: Progress | None = None,
) -> Path:
    """Writes the demonstration's recording; see `demo_plan` and `make_field_test`."""
    return make_field_test(folder, demo_plan(seed=seed, duration_s=duration_s, site=site), progress=progress)


@lru_cache(maxsize=1)
def _scene(site: Site, seed: int) -> Scene:
    """The scene; the last one is kept, because studies film one scene many times."""
    return site.scene(seed=seed)


def _counted(
    frames: Iterator[npt.NDArray[np.uint8]], plan: Preset, view: int, progress: Progress | None
) -> Iterator[npt.NDArray[np.uint8]]:
    """The frames of one view, each reported when it is written; the count goes on from view to view."""
    for number, frame in enumerate(frames, start=view * plan.frames + 1):
        yield frame
        if progress is not None:
            progress(f"filming {plan.name}", number, len(plan.views) * plan.frames)


def _prepare(folder: Path, files: list[str]) -> tuple[Path, list[str]]:
    """The folder, made and without an earlier session file, and what its videos show (`_film_hash`)."""
    present = [name for name in (*files, "session.toml") if (folder / name).exists()]
    if present and not (folder / "truth.nc").exists():
        raise ResultsError(f"{folder}: expected a new folder or an earlier demo, got {present}; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "session.toml").unlink(missing_ok=True)
    except OSError as error:
        raise ResultsError(f"{folder}: expected a folder to write to, got: {error}; choose another") from error
    try:
        return folder, [str(film) for film in read_displacement(folder / "truth.nc").attrs["films"]]
    except (ResultsError, KeyError):  # absent, or of another kind: made anew
        return folder, []


def _film_hash(plan: Preset, view: int) -> str:
    """What tells apart the videos of plans; dataclasses of plain values print in full."""
    recording = plan.recordings[view]
    shown = (plan.site, plan.motion, recording, plan.fps, plan.frames, plan.seed, dict(plan.encoder))
    optics = "" if recording.photometry is None else repr(recording.photometry)
    if recording.disturbances != Disturbances():
        optics += repr(recording.disturbances)
    return hashlib.sha256(f"{_VERSION} {view} {shown!r}{optics}".encode()).hexdigest()


def _rate(plan: Preset, view: int) -> dict[str, str]:
    """Options of the encoder for a constant quality, or for the stated rate."""
    recording = plan.recordings[view]
    rate = recording.disturbances.bits_per_pixel
    if rate == 0:
        return {"crf": str(recording.crf)}
    return {"b": str(round(rate * math.prod(plan.site.image_size) * plan.fps))}


def _write_sensor(folder: Path, plan: Preset, number: int) -> None:
    mounted = plan.accelerometers[number]
    position = [point.position for point in plan.points if point.name == mounted.point]

    def acceleration_of(time_s: FloatArray) -> FloatArray:
        # Before the first and after the last people the structure is at rest.
        return np.asarray(plan.motion.acceleration(time_s, position)[:, 0])

    write_acceleration(
        folder / f"{mounted.sensor.name}.csv",
        mounted.sensor,
        acceleration_of,
        duration_s=(plan.duration_s + _SENSOR_MARGIN_S - mounted.sensor.clock_offset_s) * mounted.sensor.clock_rate,
        seed=plan.seed + number,
    )


def _truth(plan: Preset) -> xr.Dataset:
    time_s = plan.frame_times(0)
    rest = np.array([point.position for point in plan.points])
    moving = ~np.array([point.static for point in plan.points])
    displacement = plan.motion.displacement(time_s, rest) * moving[:, None]
    shape = displacement.shape
    starts = [recording.start_s - plan.recordings[0].start_s for recording in plan.recordings]
    further = {"view_offsets_s": starts} if len(starts) > 2 else {}
    return make_displacement(
        time_s - time_s[0],
        [point.name for point in plan.points],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=1e3 * displacement,
            displacement_std_mm=np.zeros(shape),
            scale_std=np.zeros(shape[1:]),
            position_m=rest + displacement,
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.full(shape[:2], Status.OK),
        ),
        attrs={
            "title": "exact displacement of a synthetic field test",
            "frame": "structure",
            "baseline_m": plan.baseline_m,
            "second_view_offset_s": starts[1],
            "sensor_offset_s": [m.sensor.clock_offset_s - plan.recordings[0].start_s for m in plan.accelerometers],
            "within_assumptions": int(plan.within_assumptions),
            "description": plan.description,
            "films": [_film_hash(plan, view) for view in range(len(plan.views))],
            "seed": plan.seed,
            "blunders": [f"{blunder.reading}: {blunder.error_m:+.3f} m" for blunder in plan.blunders],
            "vfm_sdm_version": _VERSION,
            **further,
        },
    )
