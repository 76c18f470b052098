"""Level and distances of the reference camera as parameters, and the structure's axes that follow from them.

Where the structure's edges are used, their directions are parameters, too: near the axes, and not quite along them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.inputs.session import Lines, Site
from vfm_sdm.stages.cameras.edge_axes import EdgeAxes
from vfm_sdm.stages.cameras.site_values import AdjustedValue

__all__ = ["OFF_FACE", "AxesParameters", "AxesValues"]

_UNSTATED_LEVEL_STD = np.radians(1.0)
"""Standard deviation of pitch and roll without a level reading: a tripod head set by eye [rad]."""
_OPEN_STD = np.radians(20.0)
"""Standard deviation of axes that edges alone tell, about the place to start from: wide, and of one minimum [rad]."""
AXES = ("lateral", "vertical", "longitudinal")
_OFF_SQUARE = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Axis of an edge, and axis towards which it is off its own."""
_LEVEL = ("pitch reference camera", "roll reference camera")
_DISTANCES = ("perpendicular distance", "longitudinal distance")
_AXES_OF_EDGES = "axes before the edges"
OFF_FACE = "points off the face"
_DISTANCES_END = 6
_NOT_SQUARE = (
    "expected edges at right angles, got others, do: state out_of_square_std_deg as large as the structure has it, or "
    "leave site.lines out"
)


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
    angle_rad
        Horizontal angle between optical axis and longitudinal axis, where edges alone tell it [rad].
    tilt_rad
        Rotations of the structure about its lateral and longitudinal axis against the horizon [rad].
    off_square
        Of edges along each axis, components along the other two [rad].
    """

    pitch_rad: float
    roll_rad: float
    perpendicular_m: float
    longitudinal_m: float
    offset_m: float
    lean_m: float
    angle_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    off_square: tuple[float, ...] = field(default=(0.0,) * len(_OFF_SQUARE))


class AxesParameters:
    """Pitch, roll, perpendicular and longitudinal distance, face offset and lean, each with its prior.

    Parameters
    ----------
    site
        What was measured on site.
    edge_axes
        Axes as edges show them, where the distances that give them were not measured.

    Attributes
    ----------
    has_face
        Whether the two distances were measured, which place the structure's face and give the axes.
    prior, std
        Prior values and standard deviations, shape (size,) [rad, m]; the latter 0 of what is held fixed.
    """

    def __init__(self, site: Site, edge_axes: EdgeAxes | None = None) -> None:
        self._side = site.structure_side if edge_axes is None else edge_axes.side
        across, along = site.perpendicular_distance, site.longitudinal_distance
        self.has_face = across is not None and along is not None
        self.of_edges = edge_axes is not None
        level = site.reference_camera_level
        self._levelled = level is not None
        self._square_deg = 0.0
        pitch, roll, std = (0.0, 0.0, _UNSTATED_LEVEL_STD)
        if level is not None:
            pitch, roll, std = np.radians([level.pitch, level.roll, level.std_deg])
        if across is None or along is None:
            self.prior = np.array([pitch, roll, 1.0, 1.0, 0.0, 0.0])
            self.std = np.array([std, std, 0.0, 0.0, 0.0, 0.0])
        else:
            self.prior = np.array([pitch, roll, across.value, along.value, 0.0, 0.0])
            self.std = np.array([std, std, across.std, along.std, site.face_offset_std, site.face_offset_std])
        if edge_axes is not None and level is None:
            self.prior[:2], self.std[:2] = (edge_axes.pitch_rad, edge_axes.roll_rad), _OPEN_STD
        if site.lines is not None:
            self._add_edges(site.lines, edge_axes)

    def _add_edges(self, lines: Lines, edge_axes: EdgeAxes | None) -> None:
        """Parameters of the directions of edges."""
        # The angle between edges of two axes has the errors of both in it.
        square = np.radians(lines.out_of_square_std_deg) / np.sqrt(2)
        plumb = np.radians(lines.out_of_plumb_std_deg)
        angle = (0.0, 0.0) if edge_axes is None else (edge_axes.angle_rad, _OPEN_STD)
        self.prior = np.concatenate([self.prior, [angle[0]], np.zeros(2 + len(_OFF_SQUARE))])
        self.std = np.concatenate([self.std, [angle[1], plumb, plumb], np.full(len(_OFF_SQUARE), square)])
        self._square_deg = lines.out_of_square_std_deg

    @property
    def has_axes(self) -> bool:
        """Whether distances or edges tell the axes."""
        return self.has_face or self.of_edges

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.std.size)

    @property
    def sources(self) -> list[str]:
        """What each whitened parameter belongs to, shape (size,)."""
        names = [*_LEVEL, *_DISTANCES, OFF_FACE, OFF_FACE, _AXES_OF_EDGES, "out of plumb", "out of plumb"]
        return [*names, *["out of square"] * len(_OFF_SQUARE)][: self.size]

    def values(self, part: FloatArray) -> AxesValues:
        """Values at whitened parameters.

        Parameters
        ----------
        part
            Whitened parameters of the axes, shape (size,) [1].
        """
        now = (self.prior + self.std * part).tolist()
        values = AxesValues(*now[:_DISTANCES_END])
        if len(now) == _DISTANCES_END:
            return values
        angle, across, lengthwise, *off_square = now[_DISTANCES_END:]
        return replace(values, angle_rad=angle, tilt_rad=(across, lengthwise), off_square=tuple(off_square))

    def rotation(self, values: AxesValues, camera: Camera) -> FloatArray:
        """Rotation from the reference camera to the structure's axes, shape (3, 3).

        Parameters
        ----------
        values
            Values of the parameters.
        camera
            Reference camera.
        """
        if not self.has_axes:
            return np.eye(3)
        level = {"pitch_rad": values.pitch_rad, "roll_rad": values.roll_rad}
        if not self.has_face:
            return structure_from_cam1(values.angle_rad, **level, side=self._side)
        # The distances tell where the image centre looks, which differs from the optical axis by the principal point.
        centre = (camera.image_size[0] - 1) / 2
        aside = np.arctan((centre - camera.K[0, 2]) / camera.K[0, 0])
        sign = 1.0 if self._side == "right" else -1.0
        # As `compute_view_angle`, but a step on the way to the solution may pass distances that nobody could measure.
        angle = float(np.arctan2(values.perpendicular_m, values.longitudinal_m)) - sign * aside
        return structure_from_cam1(angle, **level, side=self._side)

    def edge_directions(self, values: AxesValues, rotation: FloatArray) -> FloatArray:
        """Directions of lateral, vertical and longitudinal edges in the reference camera's frame, shape (3, 3) [1].

        Parameters
        ----------
        values
            Values of the parameters.
        rotation
            Rotation from the reference camera to the structure's axes, shape (3, 3).
        """
        along = np.eye(3)
        for (axis, towards), off in zip(_OFF_SQUARE, values.off_square, strict=True):
            along[axis, towards] = off
        across, lengthwise = values.tilt_rad
        along = along + np.cross([across, 0.0, lengthwise], along)
        return np.asarray(along @ rotation)

    def square_angles(self, values: AxesValues, axes: Sequence[int]) -> list[AdjustedValue]:
        """Angles between edges of two axes.

        Parameters
        ----------
        values
            Values of the parameters.
        axes
            Indices of the axes that have edges.
        """
        off = dict(zip(_OFF_SQUARE, values.off_square, strict=True))
        found = []
        for first, second in combinations(axes, 2):
            angle = 90.0 - float(np.degrees(off[first, second] + off[second, first]))
            found.append(AdjustedValue(_name_angle(first, second), "deg", 90.0, self._square_deg, angle, True))
        return found

    def edge_claims(self, axes: Sequence[int]) -> list[tuple[str, str, float, float, dict[int, float], str]]:
        """Name, unit, value, standard deviation, parameters that an error of it moves [std of each], and advice.

        Parameters
        ----------
        axes
            Indices of the axes that have edges.
        """
        first_off = _DISTANCES_END + 3
        found = []
        for pair in combinations(axes, 2):
            places = [first_off + _OFF_SQUARE.index(one) for one in (pair, pair[::-1])]
            moved = dict.fromkeys(places, -(0.5**0.5))
            found.append((_name_angle(*pair), "deg", 90.0, self._square_deg, moved, _NOT_SQUARE))
        return found

    def named(self, values: AxesValues) -> list[tuple[int, str, str, float, float, float]]:
        """Position, name, unit, prior, its standard deviation and value of every parameter that is reported.

        Parameters
        ----------
        values
            Values of the parameters.
        """
        if not self.has_axes:
            return []
        now = (values.pitch_rad, values.roll_rad, values.perpendicular_m, values.longitudinal_m)
        found = []
        # Of edges alone, the level is what they tell.
        names = (*_LEVEL, *_DISTANCES) if self.has_face else _LEVEL if self._levelled else ()
        for index, name in enumerate(names):
            unit, scale = ("deg", np.degrees(1.0)) if index < len(_LEVEL) else ("m", 1.0)
            prior, std = scale * self.prior[index], scale * self.std[index]
            found.append((index, name, unit, float(prior), float(std), float(scale * now[index])))
        return found


def _name_angle(first: int, second: int) -> str:
    return f"angle between {AXES[first]} and {AXES[second]} edges"
