"""Two visits to the same points: what each knows of its cameras is off by as much as its covariance says."""

from dataclasses import dataclass, replace

import numpy as np

from simulation import intrinsics, looking_at
from vfm_sdm.core.datasets import make_points, make_tracks
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.revisit import Visit

SIZE = (1280, 720)
VIEWS = ("left", "right")
STATIC = {
    "s1": (-1.2, 0.8, 8.0),
    "s2": (1.3, 0.7, 8.5),
    "s3": (0.1, 0.9, 7.0),
    "s4": (-0.9, -0.7, 12.0),
    "s5": (1.2, -0.8, 11.0),
}
MOVING = {"mid": (0.2, 0.05, 8.2), "quarter": (-0.8, 0.0, 8.1)}
NAMES = [*MOVING, *STATIC]
REST = np.array([*MOVING.values(), *STATIC.values()])
TURN = StructureFrame(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
"""Lateral is away from the first camera."""
NOISE_PX = 0.02


def true_cameras(*, moved=(0.0, 0.0, 0.0), zoom=1.0):
    """Cameras of a visit in the frame of the first visit's reference camera."""
    target = np.array([0.0, 0.0, 8.5])
    centers = np.array([[0.0, 0.0, 0.0], [2.8, -0.1, 0.4]]) + moved
    focal = zoom * np.array([2500.0, 2450.0])
    first = Camera(intrinsics(focal[0], SIZE), SIZE, cam_from_world=looking_at(centers[0], target))
    second = Camera(intrinsics(focal[1], SIZE), SIZE, cam_from_world=looking_at(centers[1], target))
    return [first, second]


def rig_covariance():
    """What an adjustment to a site may leave of two cameras."""
    inner = [0.004, 4.0, 4.0, 0.01]
    return np.diag(np.array([*inner, *[0.0] * 6, *inner, *[8e-4] * 3, *[0.01] * 3]) ** 2)


@dataclass(frozen=True)
class Pair:
    """Both visits, and what `find_again` would find."""

    earlier: Visit
    later: Visit
    found: dict[str, np.ndarray]


def make_visit(cameras, points3d, rng, *, estimate=True, name="visit", scale=1.0):
    """A visit whose cameras are known as `rig_covariance` says, and its places, (V, P, 2) [px]."""
    true = Rig.from_world(VIEWS, cameras, metric=True).scaled(scale)
    covariance = rig_covariance()
    error = rng.normal(0, 1, 20) * np.sqrt(np.diag(covariance)) if estimate else np.zeros(20)
    rig = replace(true.perturbed(error), covariance=covariance)
    places = np.stack([camera.project(points3d) for camera in cameras])
    std = np.zeros(places.shape)
    status = np.full(places.shape[:2], "ok", dtype=object)
    points = make_points(VIEWS, NAMES, position=places, position_std=std, status=status)
    tracks = {}
    for number, view in enumerate(VIEWS):
        position = np.repeat(places[number][None], 20, axis=0)
        own = np.tile(1e-3**2 * np.eye(2), (20, len(NAMES), 1, 1))
        tracks[view] = make_tracks(np.arange(20) / 20, NAMES, position, own, np.zeros((20, len(NAMES))), attrs={})
    session = Session(
        name=name,
        view=[{"name": v, "video": f"{v}.mp4"} for v in VIEWS],
        site={"baseline": {"value": 2.8, "std": 0.01}},
        point=[
            {"name": n, "view": "left", "pixel": [*map(float, places[0, i])], "static": n in STATIC}
            for i, n in enumerate(NAMES)
        ],
    )
    frames = {view: np.zeros(SIZE[::-1], np.uint8) for view in VIEWS}
    solution = CameraSolution(rig, TURN, None, points)
    return Visit(session, frames, solution, tracks, None), places


def make_pair(seed=0, *, change_mm=None, estimate=True, later_scale=1.0):
    """Visits between which points move by (lateral, vertical, longitudinal) [mm], by name."""
    rng = np.random.default_rng(seed)
    change = np.zeros((len(NAMES), 3))
    for name, value in (change_mm or {}).items():
        change[NAMES.index(name)] = value
    after = REST + 1e-3 * change @ TURN.rotation
    earlier, _ = make_visit(true_cameras(), REST, rng, estimate=estimate, name="May")
    later_cameras = true_cameras(moved=(0.3, -0.05, 0.2), zoom=1.05)
    later, places = make_visit(later_cameras, after, rng, estimate=estimate, name="October", scale=later_scale)
    noisy = places + rng.normal(0, NOISE_PX, places.shape)
    return Pair(earlier, later, dict(zip(VIEWS, noisy, strict=True)))
