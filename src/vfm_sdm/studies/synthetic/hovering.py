"""Cameras that hover, as on drones or in hands: decimetres and degrees, every frame drawn from where it was taken.

World frame: along the structure, down, away from the cameras, with the middle of the structure as origin. Lengths are
metres.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.studies.synthetic.defects import compute_wandering
from vfm_sdm.studies.synthetic.imager import Imager
from vfm_sdm.studies.synthetic.render import Renderer
from vfm_sdm.studies.synthetic.scene import Face, Scene, Texture, coarsest_pixel

__all__ = ["HOVERING_POINTS", "STATIC_POINTS", "Hover", "HoveringSite", "film_hovering"]

HOVERING_POINTS = {
    "quarter": (-1.2, 0.05, 0.0),
    "middle": (0.0, -0.05, 0.0),
    "three quarters": (1.25, 0.02, 0.0),
    "block": (0.35, 1.0, -2.0),
    "pier": (-1.7, 1.02, 0.2),
    "wall left": (-0.75, -0.95, 3.0),
    "wall right": (0.75, -0.85, 3.0),
}
"""Points of the site [m]; the first three are on the structure."""
STATIC_POINTS = ("block", "pier", "wall left", "wall right")
"""Those that stand still, at three depths."""
_HALF_ANGLE = np.deg2rad(22.5)
_FACES = {
    "girder": ((-3.0, -0.38, 0.0), (6.0, 0.0, 0.0), (0.0, 0.76, 0.0)),
    "block": ((-0.1, 0.6, -2.0), (0.9, 0.0, 0.0), (0.0, 1.6, 0.0)),
    "pier": ((-3.0, 0.55, 0.2), (2.0, 0.0, 0.0), (0.0, 2.2, 0.0)),
    "wall": ((-9.0, -6.0, 3.0), (18.0, 0.0, 0.0), (0.0, 12.0, 0.0)),
}
_LONGEST_M = 0.3
_PIXELS_A_WAVE = 3.0
"""Pixels in the shortest wavelength of a texture: a camera that comes nearer or turns still sees no aliasing."""
_REACH_M = 0.05


@dataclass(frozen=True)
class Hover:
    """How far a camera wanders from where it was in the first frame.

    Parameters
    ----------
    reach_m, reach_deg
        Distance and angle that it stays within [m, deg].
    band_hz
        Lowest and highest frequency of the wandering [Hz].
    seed
        Of the wandering.

    Raises
    ------
    DatasetError
        A reach is negative, or the band is none.
    """

    reach_m: float = 0.5
    reach_deg: float = 2.0
    band_hz: tuple[float, float] = (0.1, 0.6)
    seed: int = 0

    def __post_init__(self) -> None:
        if not (min(self.reach_m, self.reach_deg) >= 0 and 0 < self.band_hz[0] < self.band_hz[1]):
            raise DatasetError(f"hover: expected reaches >= 0 and a band of frequencies > 0, got {self}; correct it")

    def motion(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Rotation vectors of the camera in its own axes [rad] and translations [m], shapes (T, 3), from time 0 on.

        Parameters
        ----------
        time_s
            Times, shape (T,) [s].

        Examples
        --------
        >>> turns, way = Hover(seed=1).motion(np.arange(500) / 25)
        >>> bool(1.5 < np.rad2deg(np.linalg.norm(turns, axis=1)).max() <= 2.0)
        True
        >>> bool(0.35 < np.linalg.norm(way, axis=1).max() <= 0.5), way[0].tolist()
        (True, [0.0, 0.0, 0.0])
        """
        times = np.append(0.0, np.asarray(time_s, np.float64))
        pairs = [compute_wandering(times, self.band_hz, seed=(self.seed, pair)) for pair in range(3)]
        wander = np.column_stack(pairs)
        wander = wander[1:] - wander[0]
        turns, way = (_within(part) for part in (wander[:, :3], wander[:, 3:]))
        return np.deg2rad(self.reach_deg) * turns, self.reach_m * way


def _within(wander: FloatArray) -> FloatArray:
    """Vectors shortened so that none is longer than 1, shape (T, 3)."""
    return np.asarray(wander / np.sqrt(1 + np.sum(wander**2, axis=1, keepdims=True)))


@dataclass(frozen=True)
class HoveringSite:
    """A girder between a block and a pier in front of it and a wall behind it, seen by two cameras at 45 degrees.

    Parameters
    ----------
    distance_m
        From each camera to the middle of the girder [m].
    focal_px, k1
        Of both cameras [px, 1].
    image_size
        Width and height [px].
    seed
        Of all textures.
    """

    distance_m: float = 20.0
    focal_px: float = 2600.0
    k1: float = -0.05
    image_size: tuple[int, int] = (960, 720)
    seed: int = 0

    def rig(self) -> Rig:
        """The cameras where they were in the first frame."""
        width, height = self.image_size
        K = np.array([[self.focal_px, 0, (width - 1) / 2], [0, self.focal_px, (height - 1) / 2], [0, 0, 1]])
        cameras = []
        for side in (-1.0, 1.0):
            R = Rotation.from_rotvec([0.0, side * _HALF_ANGLE, 0.0]).as_matrix()
            pose = np.column_stack([R, [0.0, 0.0, self.distance_m]])
            cameras.append(Camera(K, self.image_size, np.array([self.k1]), pose))
        return Rig(("left", "right"), tuple(cameras), metric=True)

    def scene(self) -> Scene:
        """What stands there; the girder moves."""
        faces = []
        for number, (name, (corner, u, v)) in enumerate(_FACES.items()):
            pixel = coarsest_pixel(corner, u, v, self.rig().cameras)
            if pixel is None:
                raise DatasetError(f"{name}: expected cameras that see it, got none; use a longer focal length")
            waves = (_PIXELS_A_WAVE * pixel[0], _PIXELS_A_WAVE * pixel[1])
            texture = Texture((self.seed << 3) + number, 120.0, 28.0, waves, longest_m=_LONGEST_M)
            moving = name == "girder"
            faces.append(Face(name, np.array(corner), np.array(u), np.array(v), texture, moving=moving))
        return Scene(tuple(faces))


def film_hovering(
    scene: Scene, camera: Camera, hover: Hover | None, displacement: FloatArray, *, fps: float, noise_std: float = 1.0
) -> Iterator[npt.NDArray[np.uint8]]:
    """Frames of a camera that hovers, each cast ray by ray from its own pose.

    Parameters
    ----------
    scene
        What it sees.
    camera
        The camera in the first frame.
    hover
        How it wanders; ``None`` stands still.
    displacement
        Of what moves in the scene, in each of T frames, shape (T, 3) [m].
    fps
        Frames a second [Hz].
    noise_std
        Standard deviation of the sensor's noise in luma units of 8 bits.

    Yields
    ------
    luma
        Shape (H, W), in units of 8-bit video.
    """
    frames = len(displacement)
    imager = Imager(camera.image_size, noise_std=noise_std, seed=(0 if hover is None else 1 + hover.seed,))
    renderer = Renderer(scene, camera, reach_m=_REACH_M)
    turns, way = (np.zeros((frames, 3)),) * 2 if hover is None else hover.motion(np.arange(frames) / fps)
    for number in range(frames):
        if hover is not None:
            R = Rotation.from_rotvec(turns[number]).as_matrix()
            pose = np.column_stack([R @ camera.rotation, R @ camera.translation + way[number]])
            renderer = Renderer(scene, replace(camera, cam_from_world=pose), reach_m=_REACH_M)
        yield imager.expose(renderer.render(partial(_shifted, displacement[number])), number)


def _shifted(displacement: FloatArray, places: FloatArray) -> FloatArray:
    """The same displacement (3,) at all places (P, 3) [m]."""
    return np.tile(displacement, (len(places), 1))
