"""The structure's face: a vertical plane whose distances were measured on site."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Site

__all__ = ["Face", "know_face"]

_LEVEL_STD_DEG = 1.0
"""Standard deviation of pitch and roll without a level reading [deg]: a tripod head set by eye."""


@dataclass(frozen=True, eq=False)
class Face:
    """The structure's face: a vertical plane across the lateral axis, in the first camera's frame.

    Parameters
    ----------
    frame
        The structure's axes with their covariance.
    distance_m
        Distance from the first camera along the lateral axis [m].
    distance_std_m
        Standard deviation of that, common to all points [m].
    offset_std_m
        Standard deviation of how far each point lies off it [m].
    """

    frame: StructureFrame
    distance_m: float
    distance_std_m: float
    offset_std_m: float

    @classmethod
    def of(cls, site: Site, frame: StructureFrame | None = None) -> "Face | None":
        """The face from the distances and the level of the reference camera; ``None`` without the distances.

        Parameters
        ----------
        site
            What was measured.
        frame
            The structure's axes, where they are known better than from the distances and the level alone.

        Examples
        --------
        >>> level = {"value_deg": 0.0, "std_deg": 0.2}
        >>> across, along = {"value": 9.0, "std": 0.02}, {"value": 9.0, "std": 0.05}
        >>> face = Face.of(
        ...     Site(perpendicular_distance=across, longitudinal_distance=along, reference_camera_level=level)
        ... )
        >>> face.distance_m, face.axes[0].round(3).tolist()
        (9.0, [0.707, 0.0, 0.707])
        """
        across, along = site.perpendicular_distance, site.longitudinal_distance
        if across is None or along is None:
            return None
        if frame is None:
            level = site.reference_camera_level
            pitch, roll, std = (0.0, 0.0, _LEVEL_STD_DEG) if level is None else (level.pitch, level.roll, level.std_deg)
            angle = compute_view_angle(across.value, along.value)
            rotation = structure_from_cam1(
                angle, pitch_rad=np.radians(pitch), roll_rad=np.radians(roll), side=site.structure_side
            )
            turn = np.hypot(along.value * across.std, across.value * along.std) / (across.value**2 + along.value**2)
            frame = StructureFrame(rotation, np.diag(np.square([np.radians(std), turn, np.radians(std)])))
        return cls(frame, across.value, across.std, site.face_offset_std)

    @property
    def axes(self) -> FloatArray:
        """Rotation from the first camera to the structure's axes, shape (3, 3); its first row is normal to the face."""
        return self.frame.rotation

    @property
    def std_m(self) -> float:
        """Standard deviation of the distance of what lies on it [m]."""
        return float(np.hypot(self.distance_std_m, self.offset_std_m))

    def points(self, camera: Camera, pixels: FloatArray, beyond_m: float = 0.0) -> FloatArray:
        """Points on the face that the first camera sees, along the structure's axes.

        Parameters
        ----------
        camera
            Intrinsics and distortion of the first camera.
        pixels
            Pixels, shape (N, 2) [px].
        beyond_m
            How far behind the face [m].

        Returns
        -------
        points3d
            Points, shape (N, 3) [m]; NaN where the ray does not meet the face.
        """
        rays = np.column_stack([camera.normalize(pixels), np.ones(len(pixels))]) @ self.axes.T
        depth = np.where(rays[:, 0] > 1e-3, (self.distance_m + beyond_m) / np.maximum(rays[:, 0], 1e-3), np.nan)
        return np.asarray(rays * depth[:, None])


def know_face(site: Site, rig: Rig, frame: StructureFrame | None = None) -> tuple[Rig, Face | None]:
    """The structure's face as measured on site, and the rig in metres; without a face where it was not measured.

    Parameters
    ----------
    site
        What was measured.
    rig
        Cameras; where they have no scale, the measured baseline gives it.
    frame
        The structure's axes, where they are known better than from the distances and the level alone.
    """
    face = Face.of(site, frame)
    if face is None or rig.metric:
        return rig, face
    if site.baseline is None or not rig.baseline() > 0:
        return rig, None
    scale_std = site.baseline.std / site.baseline.value
    distance_std = float(np.hypot(face.distance_std_m, face.distance_m * scale_std))
    scaled = rig.scaled(site.baseline.value / rig.baseline())
    return scaled, Face(face.frame, face.distance_m, distance_std, face.offset_std_m)
