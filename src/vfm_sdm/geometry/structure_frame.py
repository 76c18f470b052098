"""The structure's own axes, from a levelled reference camera and two distances (section Overall pipeline)."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.errors import CameraError

__all__ = ["StructureFrame", "compute_view_angle", "structure_from_cam1"]


@dataclass(frozen=True, eq=False)
class StructureFrame:
    """Orientation of the structure's axes relative to the reference camera.

    Parameters
    ----------
    rotation
        ``structure_from_cam1``, shape (3, 3): rows are the lateral, vertical and longitudinal axes in the frame of
        the reference camera.
    covariance
        Covariance of a small rotation vector in the structure's frame, shape (3, 3) [rad2].

    Raises
    ------
    CameraError
        ``rotation`` is not a rotation.
    DatasetError
        A shape is wrong.
    """

    rotation: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        R = as_float_array(self.rotation, "structure_from_cam1", (3, 3))
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
            raise CameraError("structure_from_cam1: expected a rotation matrix; orthonormalise it")
        object.__setattr__(self, "rotation", R)
        object.__setattr__(self, "covariance", as_float_array(self.covariance, "axes covariance", (3, 3)))


def compute_view_angle(perpendicular_m: float, longitudinal_m: float) -> float:
    """Horizontal angle between the optical axis and the structure's longitudinal axis [rad].

    Parameters
    ----------
    perpendicular_m
        Distance from the reference camera to the structure's face, at right angles to it [m].
    longitudinal_m
        Distance along the structure, from the foot of that perpendicular to what the image centre shows [m].

    Raises
    ------
    CameraError
        The perpendicular distance is not positive or the longitudinal one is negative.

    Notes
    -----
    The two distances are the legs of a right triangle whose hypotenuse is the optical axis seen from above.

    Examples
    --------
    >>> round(float(np.degrees(compute_view_angle(10.0, 10.0))), 6)
    45.0
    """
    if not (perpendicular_m > 0 and longitudinal_m >= 0):
        raise CameraError(
            f"distances: expected perpendicular > 0 and longitudinal >= 0, got {perpendicular_m} and "
            f"{longitudinal_m} m; measure both from the reference camera"
        )
    return float(np.arctan2(perpendicular_m, longitudinal_m))


def structure_from_cam1(
    angle_rad: float,
    *,
    pitch_rad: float = 0.0,
    roll_rad: float = 0.0,
    side: Literal["right", "left"] = "right",
) -> FloatArray:
    """Rotation from the reference camera's frame to the structure's axes.

    Parameters
    ----------
    angle_rad
        Horizontal angle between optical axis and longitudinal axis, of `compute_view_angle` [rad].
    pitch_rad
        Upward tilt of the optical axis above the horizon [rad].
    roll_rad
        Rotation of the camera about its optical axis, clockwise as seen from behind the camera [rad].
    side
        On which side of the camera the structure's face lies for an observer who looks along the structure.

    Returns
    -------
    structure_from_cam1
        Shape (3, 3) [1]. Its rows are the axes in the camera's frame: lateral (horizontal, away from the camera),
        vertical (down), longitudinal.

    Notes
    -----
    The axes are right-handed, so the longitudinal axis points away from the camera when the structure is on its
    right, and towards it on its left.

    Examples
    --------
    >>> rotation = structure_from_cam1(np.pi / 2)
    >>> rotation.round(6).tolist()[0]
    [0.0, 0.0, 1.0]
    """
    # Columns of level_from_cam are the camera's axes seen in the level frame (x right, y down, z forward).
    rise, run = np.sin(pitch_rad), np.cos(pitch_rad)
    lean, stand = np.sin(roll_rad), np.cos(roll_rad)
    level_from_cam = np.array([[stand, -lean, 0.0], [run * lean, run * stand, -rise], [rise * lean, rise * stand, run]])
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    sign = 1.0 if side == "right" else -1.0
    structure_from_level = np.array([[sign * cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, sign * cosine]])
    return np.asarray(structure_from_level @ level_from_cam)
