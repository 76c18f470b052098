"""What was measured on site beside what parameters of cameras and axes say of it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Level, Readings, Rectangle, Site

__all__ = ["POINTED_STD_PX", "AdjustedValue", "SitePoint", "SiteState", "list_measured"]

POINTED_STD_PX = 0.5
"""Least standard deviation of where a point that somebody measured to lies [px]."""


@dataclass(frozen=True)
class AdjustedValue:
    """Value of a quantity at some parameters, with its prior or measured value.

    Parameters
    ----------
    name, units
        Name and unit of the quantity.
    prior, prior_std
        Prior or measured value and its standard deviation [units].
    value
        Value at the parameters [units].
    measured
        Whether the quantity is a reading on site; else it is a parameter with a prior.
    """

    name: str
    units: str
    prior: float
    prior_std: float
    value: float
    measured: bool = False


@dataclass(frozen=True, eq=False)
class SitePoint:
    """A named point as the views see it.

    Parameters
    ----------
    pixels
        Its place in each of V views, shape (V, 2) [px]; NaN where one of more than two views does not see it.
    std_px
        Standard deviation of these, shape (V, 2) [px]; half a pixel at least.
    on_face
        Whether it lies on the structure's face, whose perpendicular distance was measured.
    """

    pixels: FloatArray
    std_px: FloatArray | float = POINTED_STD_PX
    on_face: bool = False

    def __post_init__(self) -> None:
        pixels = as_float_array(self.pixels, "pixels of a point", (None, 2))
        std = np.broadcast_to(np.asarray(self.std_px, dtype=np.float64), pixels.shape)
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "std_px", np.fmax(std, POINTED_STD_PX))


@dataclass(frozen=True, eq=False)
class SiteState:
    """Cameras, points and axes at some parameters.

    Parameters
    ----------
    rig
        Cameras; the reference camera is the origin.
    points
        Named points in the reference camera's frame, shape (3,) each [m].
    pitch_rad, roll_rad
        Inclination of the reference camera [rad].
    perpendicular_m
        Distance from the reference camera to the structure's face [m].
    axes
        Rotation from the reference camera to the structure's axes, shape (3, 3); ``None`` where they are not known.
    """

    rig: Rig
    points: Mapping[str, FloatArray]
    pitch_rad: float
    roll_rad: float
    perpendicular_m: float
    axes: FloatArray | None


def list_measured(state: SiteState, site: Site, readings: Mapping[str, Readings]) -> list[AdjustedValue]:
    """Baseline, ranges, lengths, rectangles, motions and readings at further cameras, beside those at the parameters.

    Parameters
    ----------
    state
        Cameras, points and axes.
    site
        What was measured on site.
    readings
        What was read at cameras other than the reference camera, by view.

    Returns
    -------
    values
        One for each reading [m, deg].

    Examples
    --------
    >>> from vfm_sdm.inputs.session import Measured
    >>> first = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> second = first.perturbed([0, 0, 0, 0, 0, 0, 0, -3.0, 0, 0])
    >>> state = SiteState(Rig(("left", "right"), (first, second), True), {}, 0.0, 0.0, 10.0, None)
    >>> [baseline] = list_measured(state, Site(baseline=Measured(value=3.01, std=0.01)), {})
    >>> baseline.name, round(baseline.value, 3)
    ('baseline', 3.0)
    """
    rig, points, values = state.rig, state.points, []
    if site.baseline is not None:
        values.append(_in_metres("baseline", site.baseline.value, site.baseline.std, rig.baseline()))
    for r in site.range:
        view = r.view or rig.names[0]
        distance = float(np.linalg.norm(points[r.point] - rig.camera(view).center))
        values.append(_in_metres(f"range {view} to {r.point}", r.value, r.std, distance))
    for s in site.length:
        first, second = (points[name] for name in s.points)
        name = f"length {s.points[0]} to {s.points[1]}"
        values.append(_in_metres(name, s.value, s.std, float(np.linalg.norm(first - second))))
    for number, rectangle in enumerate(site.rectangle, start=1):
        corners = np.array([points[name] for name in rectangle.corner_names(number)])
        values += _list_rectangle(f"rectangle {number}", rectangle, corners)
    for motion in site.motion:
        nowhere = (np.nan, np.nan)
        ends = [np.array([pixels.get(view, nowhere) for view in rig.names]) for pixels in (motion.rest, motion.moved)]
        length = float(np.linalg.norm(np.subtract(*triangulate(np.stack(ends, axis=1), rig))))
        name = f"motion of {motion.point} by sensor {motion.sensor}"
        values.append(_in_metres(name, motion.length, motion.std, length))
    for view, read in readings.items():
        if read.level is not None:
            values += _list_level(view, read.level, state)
        values += _list_distances(view, read, state)
    return values


def _in_metres(name: str, measured: float, std: float, value: float) -> AdjustedValue:
    return AdjustedValue(name, "m", measured, std, value, True)


def _list_rectangle(name: str, rectangle: Rectangle, corners: FloatArray) -> Iterator[AdjustedValue]:
    """Aspect of a rectangle, and the four ways in which corners (4, 3) depart from one.

    With the sides as vectors ``w1, w2`` along the width and ``h1, h2`` along the height, these are the angle between
    the mean sides less the right one, half the angles by which opposite sides part, and by how much they are twisted.
    """
    top, bottom = corners[1] - corners[0], corners[2] - corners[3]
    left, right = corners[3] - corners[0], corners[2] - corners[1]
    wide, high = (top + bottom) / 2, (left + right) / 2
    width, height = float(np.linalg.norm(wide)), float(np.linalg.norm(high))
    if rectangle.aspect is not None:
        yield AdjustedValue(f"{name}: aspect", "1", rectangle.aspect.value, rectangle.aspect.std, width / height, True)
    # Sides part by what is longer at one end: both differences are the same vector.
    apart = (bottom - top) / 2
    normal = np.cross(wide, high)
    errors = {
        "right angle": float(wide @ high) / (width * height),
        "taper of its height": float(apart @ wide) / (width * height),
        "taper of its width": float(apart @ high) / (width * height),
        "flatness": float(apart @ normal) / (width * height) ** 1.5,
    }
    for what, error in errors.items():
        yield AdjustedValue(f"{name}: {what}", "deg", 0.0, rectangle.out_of_square_std_deg, np.degrees(error), True)


def _list_level(view: str, level: Level, state: SiteState) -> Iterator[AdjustedValue]:
    """Pitch and roll of a further camera."""
    level_from_cam1 = structure_from_cam1(0.0, pitch_rad=state.pitch_rad, roll_rad=state.roll_rad)
    axes = level_from_cam1 @ state.rig.camera(view).rotation.T
    pitch, roll = np.degrees([-np.arcsin(axes[1, 2]), np.arctan2(axes[1, 0], axes[1, 1])])
    for name, read, value in (("pitch", level.pitch, pitch), ("roll", level.roll, roll)):
        yield AdjustedValue(f"{name} {view}", "deg", read, level.std_deg, float(value), True)


def _list_distances(view: str, read: Readings, state: SiteState) -> Iterator[AdjustedValue]:
    """Distances of a further camera to the face, and along it to what the centre of its picture shows."""
    if state.axes is None:
        return
    camera = state.rig.camera(view)
    across = state.perpendicular_m - float(state.axes[0] @ camera.center)
    if (reading := read.perpendicular_distance) is not None:
        yield _in_metres(f"perpendicular distance {view}", reading.value, reading.std, across)
    if (reading := read.longitudinal_distance) is not None:
        along = across * _centre_slope(camera, state)
        yield _in_metres(f"longitudinal distance {view}", reading.value, reading.std, along)


def _centre_slope(camera: Camera, state: SiteState) -> float:
    """Way along the structure over the way across it, of the ray through the centre of a picture [1]."""
    axes = np.eye(3) if state.axes is None else state.axes
    centre = (np.array(camera.image_size) - 1) / 2
    ray = axes @ camera.rotation.T @ np.append(camera.normalize(centre), 1.0)
    forward = axes @ state.rig.cameras[0].rotation.T @ np.array([0.0, 0.0, 1.0])
    # The longitudinal axis points away from the reference camera or, with the structure on its left, towards it.
    return float(np.copysign(1.0, forward[2]) * ray[2] / ray[0])
