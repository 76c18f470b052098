"""A plan as geometry: true cameras, points and motion, and the session that an engineer would note on that site.

The world frame has the structure's axes (lateral away from the cameras, vertical down, longitudinal) and its origin in
the optical centre of the first camera, as in `vfm_sdm.studies.synthetic.scene`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.errors import CameraError, SessionError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.inputs.session import Length, Level, Measured, Method, Point, Range, Session, Site, View
from vfm_sdm.stages.cameras.priors import CameraPriors, read_priors
from vfm_sdm.studies.planning.plan import Plan, PlannedCamera, ReadingsAt
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode

__all__ = ["ONSET_S", "Layout", "check_seen", "lay_out", "note", "try_lay_out"]

_UNHURT_PX = 24.0
"""How far from the border of a picture a point has to stay for its subset [px]."""
ONSET_S = 0.5
"""Time after rest until the structure moves at its full amplitude [s]."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Where everything is, and what is known of it beforehand.

    Parameters
    ----------
    plan
        The plan.
    cameras
        True cameras in the world frame, V of them.
    priors
        What is known of their lenses, pan clips included.
    points3d
        Points at rest in the world frame, shape (P, 3) [m].
    face_m
        Lateral coordinate of the face, vertical ones of its upper and lower edge, and longitudinal ones of its ends
        [m].
    motion
        Of the structure.
    session
        As an engineer would note it, with exact values.
    """

    plan: Plan
    cameras: tuple[Camera, ...]
    priors: CameraPriors
    points3d: FloatArray
    face_m: tuple[float, float, float, float, float]
    motion: ModalMotion
    session: Session

    @property
    def rig(self) -> Rig:
        """The true rig in the first camera's frame, without covariance."""
        return Rig.from_world(self.priors.names, self.cameras, metric=True)

    @property
    def structure_from_cam1(self) -> FloatArray:
        """True rotation from the first camera's frame to the structure's axes, shape (3, 3) [1]."""
        return self.cameras[0].rotation.T

    @property
    def static(self) -> BoolArray:
        """Whether each point stands still, shape (P,)."""
        return np.array([point.static for point in self.plan.point])

    @property
    def pixels(self) -> FloatArray:
        """Pixels of all points in every view, shape (V, P, 2) [px]; NaN behind a camera."""
        return np.stack([camera.project(self.points3d) for camera in self.cameras])

    def visible(self) -> BoolArray:
        """Whether each camera sees each point well inside its picture, and the face from in front, shape (V, P)."""
        sizes = np.array([camera.image_size for camera in self.cameras])[:, None]
        pixels = self.pixels
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= _UNHURT_PX) & (pixels <= sizes - 1 - _UNHURT_PX)).all(axis=-1)
        before = np.array([camera.center[0] < self.face_m[0] for camera in self.cameras])
        return np.asarray(inside & before[:, None])


def lay_out(plan: Plan) -> Layout:
    """The geometry of a plan and the session that belongs to it.

    Parameters
    ----------
    plan
        The plan.

    Raises
    ------
    SessionError
        A name is none that a session may have.
    """
    first = plan.camera[0]
    frames = {one.name: np.broadcast_to(np.uint8(0), (one.image_size[1], one.image_size[0])) for one in plan.camera}
    points3d = np.array([_to_world(plan, p.perpendicular_m, p.longitudinal_m, p.height_m) for p in plan.point])
    draft = _draft(plan)
    priors = read_priors(draft, frames, estimator="plan")
    if plan.measured.pan_clip_std is not None:
        focals = np.array([np.diag(camera.K)[:2] for camera in priors.cameras])
        priors = priors.fused(focals, relative_std=plan.measured.pan_clip_std, source="pan clip")
    cameras = tuple(_aim(plan, one, camera.K) for one, camera in zip(plan.camera, priors.cameras, strict=True))
    structure = plan.structure
    support = -first.longitudinal_m
    face = (
        first.perpendicular_m,
        first.height_m - structure.top_m,
        first.height_m - structure.bottom_m,
        support,
        support + structure.span_m,
    )
    modes = tuple(
        Mode(axis, one.frequency_hz, one.amplitude_mm, damping_ratio=0.0, half_waves=int(axis != "longitudinal"))
        for axis, one in plan.motion.by_axis.items()
    )
    motion = ModalMotion(modes, support_m=support, span_m=structure.span_m, still_s=plan.still_s, onset_s=ONSET_S)
    laid = Layout(plan, cameras, priors, points3d, face, motion, draft)
    return replace(laid, session=note(laid))


def _to_world(plan: Plan, perpendicular_m: float, longitudinal_m: float, height_m: float) -> FloatArray:
    """World coordinates of a place of the plan, shape (3,) [m]."""
    first = plan.camera[0]
    return np.array(
        [
            first.perpendicular_m - perpendicular_m,
            first.height_m - height_m,
            longitudinal_m - first.longitudinal_m,
        ]
    )


def _aim(plan: Plan, one: PlannedCamera, K: FloatArray) -> Camera:
    """The camera, level, with the middle of its picture on the place that it looks at."""
    center = _to_world(plan, *one.place)
    if one.looks_at is not None:
        target = _to_world(plan, 0.0, *one.looks_at)
    else:
        target = np.mean([_to_world(plan, 0.0, p.longitudinal_m, p.height_m) for p in plan.moving], axis=0)
    across, below, along = target - center
    angle = float(np.arctan2(across, along))
    pitch = float(np.arctan2(-below, np.hypot(across, along)))
    rotation = structure_from_cam1(angle, pitch_rad=pitch).T
    return Camera(K, one.image_size, cam_from_world=np.column_stack([rotation, -rotation @ center]))


def _draft(plan: Plan) -> Session:
    """The session as far as lenses are read from it."""
    return Session(
        name=plan.name,
        folder=plan.folder,
        # As tables, so that a name that no session may have is reported as a session's faults are.
        view=[{"name": one.name, "video": f"{one.name}.mp4", "lens": one.lens} for one in plan.camera],
        site=Site(baseline=Measured(value=_baseline(plan), std=plan.measured.baseline_std_m)),
        point=[Point(name=one.name, view=plan.camera[0].name, pixel=(0.0, 0.0)) for one in plan.point],
    )


def _baseline(plan: Plan) -> float:
    first, second = (_to_world(plan, *one.place) for one in plan.camera[:2])
    return float(np.linalg.norm(second - first))


def note(laid: Layout) -> Session:
    """The session with everything that will be measured, exact.

    Parameters
    ----------
    laid
        Geometry, with the cameras at which it is measured.
    """
    plan, measured = laid.plan, laid.plan.measured
    first, pixels = laid.cameras[0], laid.pixels[0]
    readings = {reading.view: reading for reading in measured.reading}
    views = [_note_view(laid, number, readings.get(one.name)) for number, one in enumerate(plan.camera)]
    points = [
        Point(name=one.name, view=plan.camera[0].name, pixel=tuple(pixel.tolist()), static=one.static)
        for one, pixel in zip(plan.point, _on_picture(pixels, first), strict=True)
    ]
    site = Site(
        baseline=Measured(value=laid.rig.baseline(), std=measured.baseline_std_m),
        perpendicular_distance=Measured(value=laid.face_m[0], std=measured.perpendicular_std_m),
        longitudinal_distance=Measured(value=abs(_reach(laid, 0)), std=measured.longitudinal_std_m),
        structure_side="right" if _reach(laid, 0) >= 0 else "left",
        face_offset_std=plan.structure.face_offset_std_m,
        reference_camera_level=_level(first, measured.level_std_deg),
        range=tuple(
            Range(point=one.point, view=one.view, value=_distance(laid, one.view, one.point), std=one.std_m)
            for one in measured.range
        ),
        length=tuple(
            Length(points=one.points, value=_length(laid, one.points), std=one.std_m) for one in measured.length
        ),
    )
    method = Method(still_interval_s=(0.0, plan.still_s), synchronization=plan.synchronization, refinement="none")
    return Session(name=plan.name, folder=plan.folder, view=views, site=site, point=points, method=method)


def _note_view(laid: Layout, number: int, reading: ReadingsAt | None) -> View:
    plan, one, camera = laid.plan, laid.plan.camera[number], laid.cameras[number]
    noted: dict[str, object] = {}
    if reading is not None and reading.level_std_deg is not None:
        noted["level"] = _level(camera, reading.level_std_deg)
    if reading is not None and reading.perpendicular_std_m is not None:
        noted["perpendicular_distance"] = Measured(value=one.perpendicular_m, std=reading.perpendicular_std_m)
    if reading is not None and reading.longitudinal_std_m is not None:
        noted["longitudinal_distance"] = Measured(value=abs(_reach(laid, number)), std=reading.longitudinal_std_m)
    if number and plan.synchronization == "none":
        noted |= {"time_offset_s": 0.0, "time_offset_std_s": plan.time_offset_std_s}
    return View(name=one.name, video=Path(f"{one.name}.mp4"), lens=one.lens, **noted)


def _on_picture(pixels: FloatArray, camera: Camera) -> FloatArray:
    """Pixels that a session may name; those outside the picture at its border."""
    last = np.array(camera.image_size) - 1.0
    return np.clip(np.nan_to_num(pixels), 0.0, last)


def _reach(laid: Layout, number: int) -> float:
    """Way along the structure from a camera to what the middle of its picture shows on the face [m]."""
    camera = laid.cameras[number]
    middle = camera.normalize((np.array(camera.image_size) - 1) / 2)
    ray = np.append(middle, 1.0) @ camera.rotation
    return float(ray[2] / ray[0] * laid.plan.camera[number].perpendicular_m)


def _level(camera: Camera, std_deg: float) -> Level:
    """What a spirit level on a camera shows that was set without roll."""
    return Level(pitch_deg=float(-np.degrees(np.arcsin(camera.rotation[2, 1]))), roll_deg=0.0, std_deg=std_deg)


def _point(laid: Layout, name: str) -> FloatArray:
    return np.asarray(laid.points3d[[one.name for one in laid.plan.point].index(name)])


def _distance(laid: Layout, view: str | None, point: str) -> float:
    number = 0 if view is None else laid.priors.names.index(view)
    return float(np.linalg.norm(_point(laid, point) - laid.cameras[number].center))


def _length(laid: Layout, names: tuple[str, str]) -> float:
    first, second = (_point(laid, name) for name in names)
    return float(np.linalg.norm(second - first))


def check_seen(laid: Layout) -> None:
    """Every point of the structure in at least two pictures.

    Raises
    ------
    SessionError
        Names the points that are not, and where they fall.
    """
    seen: Mapping[str, list[str]] = {
        one.name: [view for view, ok in zip(laid.priors.names, column, strict=True) if ok]
        for one, column in zip(laid.plan.point, laid.visible().T, strict=True)
    }
    missing = [point.name for point in laid.plan.moving if len(seen[point.name]) < 2]
    if missing:
        words = "; ".join(f"{name!r} in {seen[name] or 'none'}" for name in missing)
        raise SessionError(
            f"point: expected every point of the structure well inside two pictures, got {words}; turn a camera "
            "(looks_at), move it away, or take a shorter lens"
        )


def try_lay_out(plan: Plan) -> Layout | None:
    """The geometry of a plan, or ``None`` where two cameras do not see every point of the structure."""
    try:
        laid = lay_out(plan)
        check_seen(laid)
    except (SessionError, CameraError):
        return None
    return laid
