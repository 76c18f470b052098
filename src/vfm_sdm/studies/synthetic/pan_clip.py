"""Clip of a camera that pans, tilts and rolls on its tripod before a street: with a lever and a rolling shutter.

Scene: the point of rotation is the origin, x points right, y down, z forward in the middle of the pan [m]. Facades
stand across the direction in which they are seen, near ones before a closed row of far ones.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.imager import Imager
from vfm_sdm.studies.synthetic.recording import write_video
from vfm_sdm.studies.synthetic.scene import GUARD, Texture, texture_luma

__all__ = ["PanClip", "pan_frames", "write_pan_clip"]

_SHORTEST_PX = 3.0
"""Shortest wavelength of the textures in the camera's pixels."""
_LONGEST_PX = 60.0
_FACADE = 0.35
"""Width of a facade over that of the picture."""
_NEAR_SHARE = 0.6
"""Share of the directions in which a near facade stands."""
_MARGIN = 1.25
_SKY = 200.0


@dataclass(frozen=True, eq=False)
class PanClip:
    """Plan of a pan clip.

    Parameters
    ----------
    camera
        Intrinsics and distortion; its pose has no meaning.
    lever_m
        From the point of rotation to the optical centre, in the camera's axes [m].
    distance_m
        Of the nearest and the farthest facades from the point of rotation [m].
    turn_deg
        Amplitudes of pan, tilt and roll [deg].
    duration_s, fps
        Length [s] and frames a second.
    readout_s
        From the first row to the last [s].
    exposure_s
        Time for which a row gathers light [s].
    noise_std
        Noise of the sensor, in luma units.
    focus_growth
        Growth of the focal length from the first frame to the last [1], as when the focus hunts.
    seed
        Of scene, turns and noise.

    Raises
    ------
    DatasetError
        A distance or the duration is not positive, or the nearest is farther than the farthest.
    """

    camera: Camera
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance_m: tuple[float, float] = (100.0, 1000.0)
    turn_deg: tuple[float, float, float] = (10.0, 5.0, 20.0)
    duration_s: float = 10.0
    fps: int = 30
    readout_s: float = 0.0
    exposure_s: float = 0.0
    noise_std: float = 1.5
    focus_growth: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        near, far = self.distance_m
        if not (0 < near <= far and self.duration_s > 0):
            raise DatasetError(
                f"pan clip: expected 0 < nearest <= farthest distance and a duration > 0 s, got {self.distance_m} m "
                f"and {self.duration_s} s; correct them"
            )

    def attitude(self, time_s: FloatArray) -> Rotation:
        """``camera_from_scene`` at these times, shape (N,) [s].

        Notes
        -----
        Pan, tilt and roll are sinusoids of one, two and three periods a clip.
        """
        phase = 2 * np.pi * np.asarray(time_s) / self.duration_s
        shift = np.random.default_rng((self.seed, 1)).uniform(0, 2 * np.pi, 3)
        angles = np.sin(phase[:, None] * (1, 2, 3) + shift) * self.turn_deg
        return Rotation.from_euler("zxy", angles[:, ::-1], degrees=True)


@dataclass(frozen=True, eq=False)
class _Facade:
    azimuth: float
    distance: float
    half: float  # [m]
    top: float  # y of the upper edge [m], negative above the horizon
    luma: npt.NDArray[np.float32]
    texels_per_m: float

    def render(self, center: FloatArray, rays: FloatArray, luma: FloatArray, depth: FloatArray) -> None:
        """Draws over what is farther; ``center`` (H, 3) of each row and ``rays`` (H, W, 3) in the scene's axes."""
        across = np.array([np.cos(self.azimuth), 0.0, -np.sin(self.azimuth)])
        normal = np.array([np.sin(self.azimuth), 0.0, np.cos(self.azimuth)])
        toward = rays @ normal
        reach = np.where(
            toward > 0.05, (self.distance - (center @ normal)[:, None]) / np.where(toward > 0.05, toward, 1.0), np.inf
        )
        with np.errstate(invalid="ignore"):
            along = (center @ across)[:, None] + reach * (rays @ across)
            down = center[:, 1:2] + reach * rays[..., 1]
            hit = (reach < depth) & (np.abs(along) <= self.half) & (down >= self.top)
        if not hit.any():
            return
        rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        u = ((along[box] + self.half) * self.texels_per_m + GUARD).astype(np.float32)
        v = ((down[box] - self.top) * self.texels_per_m + GUARD).astype(np.float32)
        seen = cv2.remap(self.luma, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        luma[box] = np.where(hit[box], seen, luma[box])
        depth[box] = np.where(hit[box], reach[box], depth[box])


def pan_frames(plan: PanClip) -> Iterator[npt.NDArray[np.uint8]]:
    """Frames of a pan clip, luma of 8 bits, shape (H, W).

    Parameters
    ----------
    plan
        What the camera does, and before what.

    Notes
    -----
    Each row is seen at its own time. With an exposure, three pictures over it are averaged.
    """
    facades = _build(plan)
    width, height = plan.camera.image_size
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
    slopes = plan.camera.normalize(grid)
    imager = Imager(plan.camera.image_size, noise_std=plan.noise_std, seed=(plan.seed, 2))
    instants = np.array([-1.0, 0.0, 1.0]) / 3 * plan.exposure_s if plan.exposure_s > 0 else np.zeros(1)
    rows_s = plan.readout_s * (np.arange(height) - (height - 1) / 2) / height
    count = round(plan.duration_s * plan.fps)
    for number in range(count):
        longer = 1 + plan.focus_growth * number / max(count - 1, 1)
        rays = np.concatenate([slopes / longer, np.ones((height, width, 1))], axis=-1)
        pictures = [_look(plan, facades, rays, number / plan.fps + rows_s + instant) for instant in instants]
        yield imager.expose(np.mean(pictures, axis=0).astype(np.float32), number)


def _look(plan: PanClip, facades: list[_Facade], rays: FloatArray, times: FloatArray) -> FloatArray:
    """Luma (H, W) with one time a row (H,)."""
    scene_from_camera = plan.attitude(times).inv().as_matrix()
    turned = np.einsum("hij,hwj->hwi", scene_from_camera, rays)
    center = scene_from_camera @ np.asarray(plan.lever_m)
    luma, depth = np.full(turned.shape[:2], _SKY), np.full(turned.shape[:2], np.inf)
    for facade in facades:
        facade.render(center, turned, luma, depth)
    return luma


def _build(plan: PanClip) -> list[_Facade]:
    rng = np.random.default_rng((plan.seed, 0))
    (width, height), focal = plan.camera.image_size, plan.camera.focal_px
    half_u, half_v = np.arctan(width / 2 / focal), np.arctan(np.hypot(width, height) / 2 / focal)
    pan, tilt = np.radians(plan.turn_deg[:2])
    # Roll shows the picture's corners beside its left and right edges.
    reach_u, reach_v = _MARGIN * (pan + half_v), min(_MARGIN * (tilt + half_v), np.radians(75))
    step = 2 * _FACADE * half_u
    near, far = plan.distance_m
    facades = []
    for number, azimuth in enumerate(np.arange(-reach_u, reach_u + step, step)):
        facades.append(_facade(plan, azimuth, far, 0.5 * step * 1.02, (-reach_v, reach_v), (plan.seed, 3, number)))
        if rng.random() < _NEAR_SHARE:
            distance = rng.uniform(near, far)
            top = -rng.uniform(0.0, 0.6) * reach_v
            facades.append(_facade(plan, azimuth, distance, 0.4 * step, (top, reach_v), (plan.seed, 4, number)))
    return facades


def _facade(
    plan: PanClip,
    azimuth: float,
    distance: float,
    half: float,
    heights: tuple[float, float],
    seed: tuple[int, ...],
) -> _Facade:
    """A facade at an azimuth [rad], ``half`` wide to both sides [rad], between two angles of height [rad]."""
    pixel = distance / plan.camera.focal_px
    half_m, top, bottom = distance * np.tan(half), distance * np.tan(heights[0]), distance * np.tan(heights[1])
    rng = np.random.default_rng(seed)
    texture = Texture(
        seed=int(rng.integers(1 << 31)),
        mean=float(rng.uniform(90, 150)),
        contrast=float(rng.uniform(14, 28)),
        shortest_m=(_SHORTEST_PX * pixel, _SHORTEST_PX * pixel),
        longest_m=_LONGEST_PX * pixel,
    )
    luma = texture_luma(texture, (2 * half_m, bottom - top)).astype(np.float32)
    return _Facade(azimuth, distance, half_m, top, luma, float(texture.texels_per_m[0]))


def write_pan_clip(path: Path | str, plan: PanClip, *, crf: int = 20) -> Path:
    """A pan clip as a camera writes it, H.264.

    Parameters
    ----------
    path
        File to write.
    plan
        What the camera does, and before what.
    crf
        Rate factor of x264: the larger, the smaller the file.
    """
    options = {"crf": str(crf), "preset": "veryfast", "threads": "2"}
    return write_video(path, pan_frames(plan), fps=plan.fps, options=options)
