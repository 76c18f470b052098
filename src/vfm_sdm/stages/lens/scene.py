"""What is known of a pan clip before it is adjusted: its scene, its tripod, and lenses as such."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.lens.turning_camera import LensClip, Sightings, TurningCamera

__all__ = ["PRINCIPAL_POINT_STD", "READOUT_S", "PanScene", "begin_adjustment", "plain_camera"]

_FOCAL_STD = 1.0
PRINCIPAL_POINT_STD = 0.015
"""Principal point from the image centre, over the image diagonal: usual for lenses that are not calibrated."""
_K1_CORNER_STD, _K2_CORNER_STD = 0.1, 0.03
"""Radial distortion at the image corner, over the radius: of lenses of any field of view."""
READOUT_S = 0.012
"""Read-out of a picture, and its standard deviation: rolling shutters take 5 to 30 ms, global ones none [s]."""


@dataclass(frozen=True)
class PanScene:
    """What is known of a pan clip's scene and tripod.

    Parameters
    ----------
    nearest_m, farthest_m
        Distances between which the scene lies [m].
    lever_std_m
        Standard deviation of the lever along each axis, from the point about which the camera turns to its lens [m].

    Raises
    ------
    DatasetError
        A distance is not positive, they are in the wrong order, or the standard deviation is negative.

    Examples
    --------
    >>> [round(value, 4) for value in PanScene(50.0, 1000.0).nearness]
    [0.0105, 0.0055]
    """

    nearest_m: float = 50.0
    farthest_m: float = 1000.0
    lever_std_m: float = 0.08

    def __post_init__(self) -> None:
        if not (0 < self.nearest_m <= self.farthest_m and self.lever_std_m >= 0):
            raise DatasetError(
                f"pan clip: expected 0 < nearest <= farthest distance and a lever >= 0 m, got {self.nearest_m:g}, "
                f"{self.farthest_m:g} and {self.lever_std_m:g} m; correct them"
            )

    @property
    def nearness(self) -> tuple[float, float]:
        """Mean and standard deviation of 1 / distance, as if every value between the ends were as likely [1/m]."""
        near, far = 1 / self.nearest_m, 1 / self.farthest_m
        return (near + far) / 2, float(max((near - far) / np.sqrt(12), 1e-3 * near))


def plain_camera(focal: float, size: tuple[int, int]) -> Camera:
    """A camera with its principal point in the middle, without distortion.

    Parameters
    ----------
    focal
        Focal length [px].
    size
        Width and height [px].

    Examples
    --------
    >>> plain_camera(1000.0, (640, 480)).K[0].tolist()
    [1000.0, 0.0, 319.5]
    """
    return Camera(np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]]), size)


def begin_adjustment(
    seen: Sightings, attitudes: FloatArray, lens: tuple[float, tuple[int, int]], scene: PanScene
) -> tuple[TurningCamera, LensClip]:
    """Where the adjustment starts, and what is known before it.

    Parameters
    ----------
    seen
        The sightings.
    attitudes
        Approximate ``camera_from_scene`` of each frame, shape (F, 3, 3).
    lens
        Approximate focal length [px], and width and height of the picture [px].
    scene
        How far the scene is, and how long the lever.
    """
    focal, (width, height) = lens
    diagonal = float(np.hypot(width, height))
    corner = diagonal / 2 / focal
    nearness, nearness_std = scene.nearness
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    mean = np.array([np.log(focal), *centre, *[0.0] * 5, nearness, READOUT_S])
    levers = [scene.lever_std_m] * 3
    centre_std = PRINCIPAL_POINT_STD * diagonal
    std = np.array(
        [
            *(_FOCAL_STD, centre_std, centre_std, _K1_CORNER_STD / corner**2, _K2_CORNER_STD / corner**4),
            *(*levers, nearness_std, READOUT_S),
        ]
    )
    rays = np.column_stack([(seen.pixel - centre) / focal, np.ones(len(seen))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    turned = np.einsum("nji,nj->ni", attitudes[seen.frame], rays)
    directions = np.add.reduceat(turned, np.flatnonzero(np.diff(seen.point, prepend=-1)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    none = np.zeros(len(directions))
    camera = TurningCamera(plain_camera(focal, (width, height)), mean[5:], attitudes, directions, none, none)
    return camera, LensClip(seen, (mean, std), nearness_std)
