"""A small recording with exact truth: a textured plane that moves in front of two known cameras."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

from simulation import intrinsics, looking_at
from textures import WaveTexture
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session, write_session
from vfm_sdm.stages.cameras.file import write_rig

SIZE = (360, 260)
DEPTH = 10.0
FRAMES = 12
FPS = 20.0
POINTS = {"a": (140.3, 110.6), "b": (200.0, 130.0), "c": (240.7, 160.2)}


def make_rig(angle_deg: float = 20.0) -> Rig:
    angle = np.radians(angle_deg)
    target = np.array([0.0, 0.0, DEPTH])
    centers = [np.zeros(3), target + DEPTH * np.array([np.sin(angle), 0.0, -np.cos(angle)])]
    cameras = [Camera(intrinsics(800.0, SIZE), SIZE, cam_from_world=looking_at(c, target)) for c in centers]
    return Rig.from_world(("left", "right"), cameras, metric=True)


def motion_mm(frame: int) -> FloatArray:
    """Displacement of the plane along the reference camera's axes at a frame [mm]; zero in the first."""
    return np.array([6 * np.sin(0.9 * frame), 9 * np.sin(0.7 * frame), 5 * np.sin(0.5 * frame)])


def render(camera: Camera, texture: WaveTexture, displacement_m: FloatArray) -> np.ndarray:
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    rays = np.concatenate([camera.normalize(np.stack([u, v], axis=-1)), np.ones((*u.shape, 1))], axis=-1)
    rays = rays @ camera.rotation
    normal = np.array([-0.2, 0.0, 1.0])
    anchor = np.array([0.0, 0.0, DEPTH]) + displacement_m
    distance = ((anchor - camera.center) @ normal) / (rays @ normal)
    X = camera.center + distance[..., None] * rays - displacement_m
    return np.clip(np.rint(texture(X[..., 0] * 80, X[..., 1] * 80)), 0, 255).astype(np.uint8)


@cache
def _picture(view: str, frame: int) -> bytes:
    """A frame of `make_rig` as a PNG: many tests write the same scene."""
    rig = make_rig()
    camera = rig.cameras[rig.names.index(view)]
    return cv2.imencode(".png", render(camera, WaveTexture(8), motion_mm(frame) / 1e3))[1].tobytes()


def write_scene(folder: Path, *, covariance: bool = True, frames: int = FRAMES, **method: object) -> Path:
    """Image sequences, camera file and session of the scene; returns the session's path."""
    rig = make_rig()
    for name in rig.names:
        (folder / name).mkdir(parents=True, exist_ok=True)
        for frame in range(frames):
            (folder / name / f"{frame:03}.png").write_bytes(_picture(name, frame))
    if covariance:
        std = np.concatenate([[1e-3, 0.5, 0.5, 1e-3, *[0.0] * 6], [1e-3, 0.5, 0.5, 1e-3, *[1e-4] * 3, *[1e-3] * 3]])
        rig = Rig(rig.names, rig.cameras, rig.metric, np.diag(std**2))
    write_rig(folder / "rig.toml", rig)
    session = Session(
        name="moving plane",
        folder=folder,
        view=[
            {"name": n, "images": f"{n}/*.png", "fps": FPS, "camera": "rig.toml", "time_offset_s": 0.0}
            for n in rig.names
        ],
        point=[{"name": n, "view": "left", "pixel": list(uv)} for n, uv in POINTS.items()],
        method={"cameras": "file", **method},
    )
    return write_session(folder / "session.toml", session)
