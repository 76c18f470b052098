"""Whole simulated measurements without images: a session as an engineer would note it, tracks, cameras and the truth.

`simulate` draws everything that is not known from the standard deviation that the session states for it, so that what
`vfm_sdm.measurement.Measurement` says of its own accuracy can be held against the truth. Every drawn quantity is a
field of `Conditions` and can be fixed: ``simulate(7, focal_errors=(0.2, 0.2))`` is a lens that is 20 % wrong.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from simulation import SIZE, intrinsics, looking_at, project_all
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STRUCTURE_AXES, make_points, make_tracks
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Length, Lens, Level, Measured, Method, Point, Range, Session, Site, View
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.base import Hypothesis
from vfm_sdm.stages.cameras.confusions import Statements
from vfm_sdm.stages.cameras.contradictions import explain_contradiction
from vfm_sdm.stages.cameras.hypotheses import weigh_hypotheses
from vfm_sdm.stages.cameras.relative_pose import estimate_relative_pose
from vfm_sdm.stages.cameras.site import SiteAdjustment, adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.straight_edges import StraightEdges
from vfm_sdm.stages.tracking.track_noise import include_track_noise

__all__ = ["MOVING", "STATIC", "STILL_S", "VIEWS", "Conditions", "Simulated", "draw_conditions", "measured", "simulate"]

VIEWS = ("left", "right")
MOVING = ("p0", "p1")
STATIC = ("s0", "s1", "s2")
STILL_S = (0.0, 1.0)
FPS = 30.0

_DIAGONAL = float(np.hypot(*SIZE))
# The same as `two-view` states for a lens that was not calibrated.
_CENTRE_STD = 0.015 * _DIAGONAL
_POINT_STD_PX = 0.5
_SHARED_MATCH_STD_PX, _OWN_MATCH_STD_PX = 0.2, 0.35
_MATCHES = 400
_MARGIN_PX = 150


def measured(session: Session, tracks: dict[str, xr.Dataset], solution: CameraSolution, **given: Any) -> Measurement:
    """The measurement of given tracks with given cameras."""
    return Measurement(session).given(cameras=solution, tracks=tracks, **{"frames": {}, **given})


@dataclass(frozen=True)
class Conditions:
    """One site and how well everything on it was measured; lengths in m, angles in degrees, errors in true units.

    Errors are what the noted or assumed value is too large by; those of focal lengths are logarithms.
    """

    perpendicular: float
    longitudinal: float
    height: float
    """Of the bridge above the reference camera."""
    baseline: float
    baseline_angle: float
    """By how far the second camera stands behind (-) or in front of the plane of the first camera's sensor."""
    baseline_side: float
    """+1: the second camera stands on the right."""
    focal_px: float
    focal_std: float
    focal_errors: tuple[float, float]
    centre_errors_px: tuple[float, float, float, float]
    distortion_std: float
    """At the image's corner, over the radius, as the next; 0: a lens known to have none."""
    distortion_errors: tuple[float, float]
    baseline_std: float
    baseline_error: float
    perpendicular_std: float
    perpendicular_error: float
    longitudinal_std: float
    longitudinal_error: float
    face_offset_std: float
    level_std: float
    level_errors: tuple[float, float]
    roll: float
    range_std: float | None
    """``None``: no range to the first static point was measured."""
    range_error: float
    length_std: float | None
    """``None``: no length between the points of the face was measured."""
    length_error: float
    track_std_px: tuple[float, float]
    """Of each view."""
    vertical_mm: float
    """Peak to peak, as the next."""
    lateral_mm: float
    longitudinal_share: float
    """Root mean square of longitudinal motion over that of vertical motion."""
    vertical_hz: float
    lateral_hz: float
    duration_s: float
    synchronization: str
    time_offset_s: float
    time_offset_std_s: float
    time_offset_error_s: float
    lens_covariances: tuple[FloatArray, ...] = ()
    """Of ``log_focal, cx, cy, k1`` of each view (4, 4), as of lens files; none: what the standard deviations say."""
    mistaken_m: float = 0.0
    """By how far along the structure the first point's place in the second view is another's, as of a baluster."""
    stated_side: str = "right"
    """Of the structure, which is on the right."""
    pixel_aspect: float = 1.0
    """Width of the recorded pixels over their height; `SIZE` is in square ones."""
    stated_aspect: float = 1.0


@dataclass(frozen=True, eq=False)
class Simulated:
    """One measurement; `measured` makes its displacement.

    Parameters
    ----------
    session
        With moving points `MOVING` on the face and static points `STATIC` in the background.
    tracks
        By view, on its own clock.
    solution
        Cameras adjusted to the site as noted.
    truth
        ``displacement`` (time, point, axis) [mm] along the true axes at the frames of the reference view, relative to
        the rest.
    rig, frame, points3d
        True cameras, axes and places of all points in the first camera's frame, shape (P, 3) [m].
    conditions
        What was drawn.
    """

    session: Session
    tracks: dict[str, xr.Dataset]
    solution: CameraSolution
    truth: xr.Dataset
    rig: Rig
    frame: StructureFrame
    points3d: FloatArray
    conditions: Conditions

    def error_of(self, displacement: xr.Dataset) -> xr.DataArray:
        """Displacement less the truth at its frames (time, point, axis) [mm]."""
        return displacement["displacement"] - self.truth["displacement"].sel(time=displacement["time"])


def draw_conditions(rng: np.random.Generator) -> Conditions:
    """A site as they are met: near and far, good and poor lenses, tapes and tracks."""
    # Where the motion tells the offset, it is noted roughly: to some frames.
    synchronization = str(rng.choice(["motion", "none"]))
    stds = {
        "focal": rng.uniform(0.005, 0.03),
        # Mostly none, because undistorting pixels is what the simulation of a site takes longest for.
        "distortion": rng.choice([0.0, 0.0, 0.0, 0.025]),
        "baseline": rng.uniform(0.003, 0.03),
        "perpendicular": rng.uniform(0.02, 0.2),
        "longitudinal": rng.uniform(0.05, 0.4),
        "level": rng.uniform(0.1, 0.8),
        "range": rng.uniform(0.01, 0.1),
        "length": rng.uniform(0.002, 0.01),
        "time": rng.uniform(2e-4, 5e-3) * (20 if synchronization == "motion" else 1),
    }
    return Conditions(
        perpendicular=rng.uniform(6, 15),
        longitudinal=rng.uniform(12, 30),
        height=rng.uniform(-1, 3),
        baseline=rng.uniform(2.5, 6),
        baseline_angle=rng.uniform(-45, 45),
        baseline_side=float(rng.choice([-1, 1])),
        focal_px=float(np.exp(rng.uniform(np.log(4000), np.log(16000)))),
        focal_std=stds["focal"],
        focal_errors=tuple(rng.normal(0, stds["focal"], 2)),
        centre_errors_px=tuple(rng.normal(0, _CENTRE_STD, 4)),
        distortion_std=stds["distortion"],
        distortion_errors=tuple(rng.normal(0, stds["distortion"], 2)),
        baseline_std=stds["baseline"],
        baseline_error=rng.normal(0, stds["baseline"]),
        perpendicular_std=stds["perpendicular"],
        perpendicular_error=rng.normal(0, stds["perpendicular"]),
        longitudinal_std=stds["longitudinal"],
        longitudinal_error=rng.normal(0, stds["longitudinal"]),
        face_offset_std=rng.uniform(0.02, 0.15),
        level_std=stds["level"],
        level_errors=tuple(rng.normal(0, stds["level"], 2)),
        roll=rng.normal(0, 1.0),
        range_std=stds["range"] if rng.random() < 0.5 else None,
        range_error=rng.normal(0, stds["range"]),
        length_std=stds["length"] if rng.random() < 0.5 else None,
        length_error=rng.normal(0, stds["length"]),
        track_std_px=tuple(np.exp(rng.uniform(np.log(0.005), np.log(0.05), 2))),
        vertical_mm=float(np.exp(rng.uniform(0, np.log(20)))),
        lateral_mm=float(np.exp(rng.uniform(np.log(0.3), np.log(8)))),
        longitudinal_share=rng.uniform(0.01, 0.05),
        vertical_hz=rng.uniform(1, 5),
        lateral_hz=rng.uniform(1, 5),
        duration_s=rng.uniform(5, 8),
        synchronization=synchronization,
        time_offset_s=rng.uniform(-0.3, 0.3),
        time_offset_std_s=stds["time"],
        time_offset_error_s=rng.normal(0, stds["time"]),
    )


def simulate(seed: int, *, refinement: str = "none", **fixed: Any) -> Simulated:
    """A measurement drawn from a seed.

    Parameters
    ----------
    seed
        The same seed with other ``fixed`` draws the same site, errors and noise otherwise.
    refinement
        ``none`` or ``sgr``.
    **fixed
        Fields of `Conditions` that are not drawn.
    """
    rng, noise = (np.random.default_rng([seed, stream]) for stream in range(2))
    c = replace(draw_conditions(rng), **fixed)
    rig, frame, noted_pitch = _true_rig(c, noise)
    points3d = _place_points(rig, frame, c, noise)
    truth = _true_motion(c, noise)
    # The user's click and the search in the other view: the point that is tracked in both is not quite the same.
    places = _mistake(c, frame, points3d)
    clicked = _project_each(rig, places) + noise.normal(0, _POINT_STD_PX, (2, len(points3d), 2))
    clicked = clicked * _squeeze(c)
    session = _session(c, rig, points3d, clicked, noted_pitch, refinement)
    tracks = _tracks(c, rig, frame, places, clicked, truth, noise)
    solution = _solve(c, session, rig, clicked, noise)
    clock = np.arange(round(c.duration_s * FPS)) / FPS
    dataset = xr.Dataset(
        {"displacement": (("time", "point", "axis"), truth(clock), {"units": "mm"})},
        coords={"time": clock, "point": [*MOVING, *STATIC], "axis": list(STRUCTURE_AXES)},
    )
    return Simulated(session, tracks, solution, dataset, rig, frame, points3d, c)


def _true_rig(c: Conditions, rng: np.random.Generator) -> tuple[Rig, StructureFrame, float]:
    """True cameras, axes, and the reference camera's true pitch [rad]; the world is the reference camera's frame."""
    focals = [c.focal_px * float(np.exp(-error)) for error in c.focal_errors]
    # What the image centre shows was measured; the optical axis looks aside of it by the principal point.
    aside = np.arctan(c.centre_errors_px[0] / focals[0])
    angle = compute_view_angle(c.perpendicular, c.longitudinal) - aside
    pitch = float(np.arctan2(c.height, np.hypot(c.perpendicular, c.longitudinal)))
    rotation = structure_from_cam1(angle, pitch_rad=pitch, roll_rad=np.radians(c.roll))
    forward = np.array([c.perpendicular, 0.0, c.longitudinal]) / np.hypot(c.perpendicular, c.longitudinal)
    right = np.array([forward[2], 0.0, -forward[0]])
    turn = np.radians(c.baseline_angle)
    center = c.baseline * (np.cos(turn) * c.baseline_side * right + np.sin(turn) * forward)
    if center[0] > c.perpendicular - 2:
        # It would stand below or inside the bridge: on the other side then.
        center -= 2 * (center @ right) * right
    target = np.array([c.perpendicular, -c.height, c.longitudinal])
    poses = [np.column_stack([rotation.T, np.zeros(3)]), looking_at(center, target)]
    cameras = []
    for view, (pose, focal) in enumerate(zip(poses, focals, strict=True)):
        offset = tuple(-np.array(c.centre_errors_px[2 * view : 2 * view + 2]))
        k1 = -c.distortion_errors[view] / (_DIAGONAL / 2 / c.focal_px) ** 2
        cameras.append(Camera(intrinsics(focal, offset=offset), SIZE, np.array([k1, 0, 0, 0, 0]), pose))
    turned = cameras[1].perturbed([0, 0, 0, 0, 0, 0, rng.normal(0, 0.02), 0, 0, 0])
    return Rig.from_world(VIEWS, [cameras[0], turned], metric=True), StructureFrame(rotation), pitch


def _place_points(rig: Rig, frame: StructureFrame, c: Conditions, rng: np.random.Generator) -> FloatArray:
    """Points of the face, then static ones nearer or farther, all seen by both cameras; shape (P, 3) [m]."""
    lateral = frame.rotation[0]
    face = c.perpendicular + rng.normal(0, c.face_offset_std)
    distance = float(np.hypot(c.perpendicular, c.longitudinal))
    places: list[FloatArray] = []
    while len(places) < len(MOVING) + len(STATIC):
        pixel = rng.uniform([0.15 * SIZE[0], 0.2 * SIZE[1]], [0.85 * SIZE[0], 0.8 * SIZE[1]])
        ray = np.append(rig.cameras[0].normalize(pixel), 1.0)
        if len(places) < len(MOVING):
            depth = (face + rng.normal(0, c.face_offset_std)) / (ray @ lateral)
            near = 0.5 * distance < depth < 2 * distance
        else:
            depth, near = distance * rng.choice([rng.uniform(0.75, 0.9), rng.uniform(1.15, 1.6)]), True
        if near and _seen(rig, (ray * depth)[None]).all():
            places.append(ray * depth)
    return np.stack(places)


def _mistake(c: Conditions, frame: StructureFrame, points3d: FloatArray) -> FloatArray:
    """Places that each view follows, shape (V, P, 3) [m]: the second one's first may be another's."""
    places = np.stack([points3d] * len(VIEWS))
    places[1, 0] += c.mistaken_m * frame.rotation[2]
    return places


def _project_each(rig: Rig, places: FloatArray) -> FloatArray:
    """Pixels of places that each view has for itself, shape (V, ..., 2) [px]."""
    return np.stack([camera.project(own) for camera, own in zip(rig.cameras, places, strict=True)])


def _squeeze(c: Conditions) -> FloatArray:
    """Recorded pixels in a square one, along u and v, shape (2,) [1]."""
    return np.array([1 / c.pixel_aspect, 1.0])


def _size(c: Conditions) -> tuple[int, int]:
    """Width and height of the pictures as they are recorded [px]."""
    return (round(SIZE[0] / c.pixel_aspect), SIZE[1])


def _seen(rig: Rig, points3d: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Whether both cameras see a point, well inside the image; shape (P,)."""
    pixels = project_all(rig, points3d)
    inside = (pixels >= _MARGIN_PX) & (pixels <= np.array(SIZE) - 1 - _MARGIN_PX)
    return np.asarray(inside.all(axis=(0, 2)))


def _true_motion(c: Conditions, rng: np.random.Generator) -> Any:
    """Function from seconds (T,) to motion of all points along the true axes, shape (T, P, 3) [mm]."""
    share = np.concatenate([[1.0], rng.uniform(0.5, 1.0, len(MOVING) - 1), np.zeros(len(STATIC))])
    amplitude = np.array([c.lateral_mm, c.vertical_mm, c.vertical_mm * c.longitudinal_share]) / 2
    # Bending shifts the face along the bridge with the vertical motion; a second mode is a fifth of the first.
    first = np.array([c.lateral_hz, c.vertical_hz, c.vertical_hz])
    second = np.clip(first * rng.uniform(1.5, 2.5), None, 6.0)
    phases = rng.uniform(0, 2 * np.pi, (2, 3))

    def motion(time_s: FloatArray) -> FloatArray:
        since = (time_s - STILL_S[1])[:, None]
        begun = np.clip(since / 0.7, 0.0, 1.0)
        wave = np.sin(2 * np.pi * since * first + phases[0]) + 0.2 * np.sin(2 * np.pi * since * second + phases[1])
        return np.asarray((begun**2 * (3 - 2 * begun) * wave * amplitude / 1.2)[:, None] * share[:, None])

    return motion


def _tracks(
    c: Conditions,
    rig: Rig,
    frame: StructureFrame,
    points3d: FloatArray,
    clicked: FloatArray,
    motion: Any,
    rng: np.random.Generator,
) -> dict[str, xr.Dataset]:
    """Tracks of all points with white noise of the covariance that they state, each view on its own clock.

    Places are those that each view follows, shape (V, P, 3) [m].
    """
    start, squeeze = _project_each(rig, points3d) * _squeeze(c), _squeeze(c)
    clock = np.arange(round(c.duration_s * FPS)) / FPS
    tracks = {}
    for view, name in enumerate(VIEWS):
        places = points3d[view] + motion(clock + view * c.time_offset_s) / 1e3 @ frame.rotation
        factor = rng.uniform(0.8, 1.25, places.shape[1]) * c.track_std_px[view]
        std = factor[:, None] * [1.0, rng.uniform(0.6, 1.4)]
        covariance = std[:, :, None] * std[:, None, :] * np.array([[1.0, 0.2], [0.2, 1.0]])
        noise = np.einsum("pij,tpj->tpi", np.linalg.cholesky(covariance), rng.normal(size=(*places.shape[:2], 2)))
        position = rig.cameras[view].project(places) * squeeze + (clicked - start)[view] + noise
        made = make_tracks(
            clock,
            [*MOVING, *STATIC],
            position,
            np.broadcast_to(covariance, (len(clock), *covariance.shape)),
            np.zeros(position.shape[:2], int),
            attrs={"tracker": "simulated", "view": name, "image_width": _size(c)[0], "image_height": _size(c)[1]},
        )
        tracks[name] = include_track_noise(made)
    return tracks


def _session(
    c: Conditions, rig: Rig, points3d: FloatArray, clicked: FloatArray, pitch: float, refinement: str
) -> Session:
    """The session as an engineer would note it: true values with their errors."""
    names = [*MOVING, *STATIC]
    ranged = float(np.linalg.norm(points3d[names.index("s0")]))
    length = float(np.linalg.norm(points3d[0] - points3d[1]))
    site = Site(
        baseline=Measured(value=rig.baseline() + c.baseline_error, std=c.baseline_std),
        perpendicular_distance=Measured(value=c.perpendicular + c.perpendicular_error, std=c.perpendicular_std),
        longitudinal_distance=Measured(value=c.longitudinal + c.longitudinal_error, std=c.longitudinal_std),
        structure_side=c.stated_side,
        face_offset_std=c.face_offset_std,
        reference_camera_level=Level(
            pitch_deg=float(np.degrees(pitch)) + c.level_errors[0],
            roll_deg=c.roll + c.level_errors[1],
            std_deg=c.level_std,
        ),
        range=() if c.range_std is None else (Range(point="s0", value=ranged + c.range_error, std=c.range_std),),
        length=()
        if c.length_std is None
        else (Length(points=("p0", "p1"), value=length + c.length_error, std=c.length_std),),
    )
    views = [
        View(
            name=name,
            video=f"{name}.mp4",
            lens=Lens(focal_px=c.focal_px, relative_std=c.focal_std),
            time_offset_s=c.time_offset_s + c.time_offset_error_s if view else None,
            time_offset_std_s=c.time_offset_std_s if view else None,
        )
        for view, name in enumerate(VIEWS)
    ]
    points = [
        Point(name=name, view=VIEWS[0], pixel=tuple(clicked[0, index]), static=name in STATIC)
        for index, name in enumerate(names)
    ]
    method = Method(refinement=refinement, synchronization=c.synchronization, still_interval_s=STILL_S)
    return Session(name="simulated", view=views, site=site, point=points, method=method)


def points_dataset(pixels: dict[str, FloatArray]) -> xr.Dataset:
    """Points seen in both views, shape (2, 2) each [px], as found."""
    position = np.stack(list(pixels.values()), axis=1)
    status = np.full(position.shape[:2], "ok", dtype=object)
    return make_points(VIEWS, list(pixels), position=position, position_std=0 * position, status=status)


def _solve(
    c: Conditions,
    session: Session,
    rig: Rig,
    clicked: FloatArray,
    rng: np.random.Generator,
    edges: tuple[StraightEdges, ...] = (),
) -> CameraSolution:
    """Cameras adjusted to noisy matches and the site, from a start and priors like those of ``two-view``."""
    pixels = {point.name: clicked[:, index] for index, point in enumerate(session.point)}
    matches = _matches(c, rig, rng)
    prior = _prior_rig(c, session, matches)
    points = {name: SitePoint(u, on_face=name in MOVING) for name, u in pixels.items()}
    start = Hypothesis(prior, (matches,))
    readings = {view.name: view for view in session.view[1:]}
    stated = Statements(prior, (matches,), session.site, points, readings, edges)

    def adjust(one: Hypothesis) -> SiteAdjustment:
        return adjust_to_site(one.rig, one.matches, session.site, points, readings=readings, edges=edges)

    # As the camera stage does: through narrow views the start may be the mirror image.
    adjusted = explain_contradiction(stated, weigh_hypotheses(session, [start], adjust).adjusted)
    return CameraSolution.of(adjusted, points_dataset(pixels))


def _prior_rig(c: Conditions, session: Session, matches: Matches) -> Rig:
    """What is known of the cameras before the adjustment: the lens, and a pose that is free."""
    assert session.site.baseline is not None
    noted = session.site.baseline.value
    K = intrinsics(c.focal_px, _size(c))
    K[0, 0] /= c.stated_aspect
    lens = Camera(K, _size(c))
    pose, _ = estimate_relative_pose(matches.points_first, matches.points_second, lens, lens)
    k1_std = c.distortion_std / (_DIAGONAL / 2 / c.focal_px) ** 2
    inner = [c.focal_std, _CENTRE_STD, _CENTRE_STD, k1_std]
    std = np.array([*inner, *[0.0] * 6, *inner, *[1.0] * 3, *[2.0 * noted] * 3])
    covariance = np.diag(std**2)
    for begin, own in zip((0, 10), c.lens_covariances, strict=False):
        covariance[begin : begin + 4, begin : begin + 4] = own
    start = Rig(VIEWS, (lens, replace(lens, cam_from_world=pose)), False)
    return replace(start.scaled(noted), covariance=covariance)


def _matches(c: Conditions, rig: Rig, rng: np.random.Generator) -> Matches:
    """Matches all over the image and in depth, with noise of their own and errors that neighbours share [px]."""
    distance = np.hypot(c.perpendicular, c.longitudinal)
    rays = rig.cameras[0].normalize(rng.uniform(0, np.array(SIZE) - 1, (5 * _MATCHES, 2)))
    depth = distance * rng.uniform(0.65, 2.0, (len(rays), 1))
    u = project_all(rig, np.column_stack([rays * depth, depth]))
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))][:, :_MATCHES]
    cell = (u[0, :, 0] * 6 // SIZE[0] * 6 + u[0, :, 1] * 6 // SIZE[1]).astype(int)
    shared = rng.normal(0, _SHARED_MATCH_STD_PX, (2, 36, 2))[:, cell]
    u = (u + shared + rng.normal(0, _OWN_MATCH_STD_PX, u.shape)) * _squeeze(c)
    return Matches(0, 1, u[0], u[1])
