"""Level and distances of the reference camera as parameters, and the structure's axes that follow from them."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.inputs.session import Site

__all__ = ["AxesParameters", "AxesValues"]

_UNSTATED_LEVEL_STD = np.radians(1.0)
"""Standard deviation of pitch and roll without a level reading: a tripod head set by eye [rad]."""
_LEVEL = ("pitch reference camera", "roll reference camera")
_DISTANCES = ("perpendicular distance", "longitudinal distance")


@dataclass(frozen=True)
class AxesValues:
    """Values of the parameters of the axes.

    Parameters
    ----------
    pitch_rad, roll_rad
        Inclination of the reference camera [rad].
    perpendicular_m, longitudinal_m
        Distances across to the face and along it [m]; 1 where they were not measured.
    offset_m, lean_m
        Common offset of points from the face, and that of matches at the lower border of the image beyond it [m].
    """

    pitch_rad: float
    roll_rad: float
    perpendicular_m: float
    longitudinal_m: float
    offset_m: float
    lean_m: float


class AxesParameters:
    """Pitch, roll, perpendicular and longitudinal distance, face offset and lean, each with its prior.

    Parameters
    ----------
    site
        What was measured on site.

    Attributes
    ----------
    has_face
        Whether the two distances were measured, which place the structure's face and give the axes.
    prior, std
        Prior values and standard deviations, shape (size,) [rad, m]; the latter 0 of what is held fixed.
    """

    def __init__(self, site: Site) -> None:
        self._side = site.structure_side
        across, along = site.perpendicular_distance, site.longitudinal_distance
        self.has_face = across is not None and along is not None
        level = site.reference_camera_level
        pitch, roll, std = (0.0, 0.0, _UNSTATED_LEVEL_STD)
        if level is not None:
            pitch, roll, std = np.radians([level.pitch, level.roll, level.std_deg])
        if across is None or along is None:
            self.prior = np.array([pitch, roll, 1.0, 1.0, 0.0, 0.0])
            self.std = np.array([std, std, 0.0, 0.0, 0.0, 0.0])
        else:
            self.prior = np.array([pitch, roll, across.value, along.value, 0.0, 0.0])
            self.std = np.array([std, std, across.std, along.std, site.face_offset_std, site.face_offset_std])

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.std.size)

    def values(self, part: FloatArray) -> AxesValues:
        """Values at whitened parameters.

        Parameters
        ----------
        part
            Whitened parameters of the axes, shape (size,) [1].
        """
        return AxesValues(*(self.prior + self.std * part))

    def rotation(self, values: AxesValues, camera: Camera) -> FloatArray:
        """Rotation from the reference camera to the structure's axes, shape (3, 3); the identity without distances.

        Parameters
        ----------
        values
            Values of the parameters.
        camera
            Reference camera.
        """
        if not self.has_face:
            return np.eye(3)
        # The distances tell where the image centre looks, which differs from the optical axis by the principal point.
        centre = (camera.image_size[0] - 1) / 2
        aside = np.arctan((centre - camera.K[0, 2]) / camera.K[0, 0])
        sign = 1.0 if self._side == "right" else -1.0
        # As `compute_view_angle`, but a step on the way to the solution may pass distances that nobody could measure.
        angle = float(np.arctan2(values.perpendicular_m, values.longitudinal_m)) - sign * aside
        return structure_from_cam1(angle, pitch_rad=values.pitch_rad, roll_rad=values.roll_rad, side=self._side)

    def named(self, values: AxesValues) -> list[tuple[int, str, str, float, float, float]]:
        """Position, name, unit, prior, its standard deviation and value of every parameter that is reported.

        Parameters
        ----------
        values
            Values of the parameters.
        """
        if not self.has_face:
            return []
        now = (values.pitch_rad, values.roll_rad, values.perpendicular_m, values.longitudinal_m)
        found = []
        for index, name in enumerate((*_LEVEL, *_DISTANCES)):
            unit, scale = ("deg", np.degrees(1.0)) if index < len(_LEVEL) else ("m", 1.0)
            prior, std = scale * self.prior[index], scale * self.std[index]
            found.append((index, name, unit, float(prior), float(std), float(scale * now[index])))
        return found
