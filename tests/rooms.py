"""Pictures of a textured room by known cameras: depth enough for every method that finds cameras from images."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from simulation import intrinsics, looking_at
from textures import WaveTexture
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session

SIZE = (400, 300)
FOCAL_PX = 500.0
BASELINE_M = 2.0
TARGET = np.array([0.0, 0.0, 11.0])
NAMES = ("left", "right", "third")

_WALLS = (  # a point of the wall, its normal, two directions along it
    ([0.0, 0.0, 13.0], [0.1, 0.0, -1.0], [1.0, 0.0, 0.1], [0.0, 1.0, 0.0]),
    ([2.2, 0.0, 11.0], [-1.0, 0.0, -0.5], [-0.5, 0.0, 1.0], [0.0, 1.0, 0.0]),
    ([0.0, 1.8, 11.0], [0.0, -1.0, -0.4], [1.0, 0.0, 0.0], [0.0, -0.4, 1.0]),
)
_TEXELS_PER_M = 46.0


def room_rig(views: int = 2, *, size: tuple[int, int] = SIZE, distortion: FloatArray | None = None) -> Rig:
    """Cameras `BASELINE_M` apart that look at one spot of the room; every view has its own focal length."""
    cameras = []
    for index in range(views):
        center = np.array([BASELINE_M * index, -0.1 * index, 0.2 * index])
        center *= BASELINE_M / max(1e-9, np.linalg.norm(center)) * index
        K = intrinsics((FOCAL_PX + 15 * index) * size[0] / SIZE[0], size)
        k = np.zeros(5) if distortion is None else distortion
        cameras.append(Camera(K, size, k, looking_at(center, TARGET)))
    return Rig.from_world(NAMES[:views], cameras, metric=True)


def room_picture(camera: Camera) -> np.ndarray:
    """What the camera sees, uint8 of shape (H, W); one sample a pixel, which the texture is smooth enough for."""
    width, height = camera.image_size
    v, u = np.mgrid[:height, :width].astype(float)
    rays = np.concatenate([camera.normalize(np.stack([u, v], axis=-1)), np.ones((height, width, 1))], axis=-1)
    rays = rays @ camera.rotation
    nearest, picture = np.full((height, width), np.inf), np.zeros((height, width))
    for seed, (anchor, normal, along, up) in enumerate(_WALLS):
        with np.errstate(divide="ignore"):
            distance = ((np.array(anchor) - camera.center) @ normal) / (rays @ np.array(normal))
        seen = (distance > 0) & (distance < nearest)
        X = camera.center + distance[seen][:, None] * rays[seen] - anchor
        texture = WaveTexture(20 + seed, waves=60, longest_px=90.0)
        picture[seen] = texture(X @ along * _TEXELS_PER_M, X @ up * _TEXELS_PER_M)
        nearest[seen] = distance[seen]
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def room_frames(rig: Rig) -> dict[str, np.ndarray]:
    return {name: room_picture(camera) for name, camera in zip(rig.names, rig.cameras, strict=True)}


def room_session(
    rig: Rig, *, focal_factor: float = 1.0, lens: bool = True, baseline: bool = True, **more: Any
) -> Session:
    """A session whose lenses are stated to 1 %, times a factor that makes them wrong, with the tape's baseline."""
    stated = [{"focal_px": focal_factor * camera.focal_px, "relative_std": 0.01} for camera in rig.cameras]
    fields: dict[str, Any] = {
        "name": "room",
        "view": [
            {"name": name, "video": f"{name}.mp4", **({"lens": known} if lens else {})}
            for name, known in zip(rig.names, stated, strict=True)
        ],
        "site": {"baseline": {"value": BASELINE_M, "std": 0.005}} if baseline else {},
        "point": [{"name": "p", "view": rig.names[0], "pixel": [10.0, 10.0]}],
        "method": {"cameras": "sfm"},  # whatever it says, tests call the estimator that they mean
    }
    return Session(**{**fields, **more})


def angle_between_deg(first: FloatArray, second: FloatArray) -> float:
    """Between two directions, shape (3,) each, or two rotations, shape (3, 3) each [deg]."""
    if first.ndim == 2:
        return float(np.degrees(np.linalg.norm(Rotation.from_matrix(first @ second.T).as_rotvec())))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))
