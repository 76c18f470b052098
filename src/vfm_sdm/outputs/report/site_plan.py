"""Plan and elevation of cameras, structure and points, drawn to one scale."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, mean_of_known
from vfm_sdm.outputs.plots.drawing import AXIS_COLOURS, BLUE, GREY, VERMILION
from vfm_sdm.outputs.report.drawing import WIDTH, Drawing, nice_ticks, shorten
from vfm_sdm.outputs.report.inputs import MANY_POINTS, ReportInputs
from vfm_sdm.outputs.report.language import Language, count_decimals

__all__ = ["Place", "draw_site", "point_positions", "site_places"]

_MARGIN, _ROOM = 26.0, 70.0
_TALLEST = 330.0
_FLATTEST = 90.0
"""Height of a drawing at least, also where all lies on one level."""


@dataclass(frozen=True, eq=False)
class Place:
    """Something on the site.

    Parameters
    ----------
    name
        Its name.
    position
        Its place along the axes of the displacement, from the reference camera, shape (3,) [m].
    sight
        Unit vector of a camera's optical axis, shape (3,), and half its horizontal and vertical field, shape (2,)
        [rad]; ``None`` of points.
    static
        Whether it is a point that must not move.
    """

    name: str
    position: FloatArray
    sight: tuple[FloatArray, FloatArray] | None = None
    static: bool = False


def point_positions(inputs: ReportInputs) -> FloatArray:
    """Places of all points along the axes of the displacement, shape (P, 3) [m]; NaN where they are not known.

    Parameters
    ----------
    inputs
        Files of the run.
    """
    data = inputs.displacement
    if "origin" in data:
        return np.asarray(data["origin"].transpose("point", "axis").values, dtype=np.float64)
    # The first minutes are enough of it.
    first = data["position"].isel(time=slice(0, 1000)).transpose("time", "point", "axis").values
    return mean_of_known(first)


def site_places(inputs: ReportInputs) -> list[Place]:
    """Cameras and points of known places; empty where there are no metric cameras.

    Parameters
    ----------
    inputs
        Files of the run.
    """
    rig, frame = inputs.cameras.rig, inputs.cameras.frame
    if rig is None or not rig.metric:
        return []
    rotation = np.eye(3) if frame is None else frame.rotation
    places = []
    for name, camera in zip(rig.names, rig.cameras, strict=True):
        half = np.arctan(np.array(camera.image_size) / 2 / np.diag(camera.K)[:2])
        places.append(Place(name, rotation @ camera.center, (rotation @ camera.rotation[2], half)))
    for name, position in zip(inputs.point_names, point_positions(inputs), strict=True):
        if np.isfinite(position).all():
            places.append(Place(name, position, static=name in inputs.static))
    return places


def draw_site(inputs: ReportInputs, places: list[Place], view: str, language: Language) -> str:
    """A plan, or an elevation, as SVG.

    Parameters
    ----------
    inputs
        Files of the run.
    places
        Cameras and points.
    view
        ``plan``: the third axis to the right, the first one up; ``elevation``: the third axis to the right, the second
        one down. Of the axes of a camera the first one lies to the right.
    language
        Language of the texts.

    Notes
    -----
    Without the structure's axes, right, down and forward of the reference camera take their places.
    """
    axes = inputs.axis_names
    of_structure = "longitudinal" in axes
    if of_structure:
        right, up, sign = (2, 0, 1.0) if view == "plan" else (2, 1, -1.0)
    else:
        right, up, sign = (0, 2, 1.0) if view == "plan" else (0, 1, -1.0)
    flat = np.array([[p.position[right], sign * p.position[up]] for p in places])
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.maximum(high - low, 1e-3)
    scale = min((WIDTH - 2 * _ROOM) / size[0], (_TALLEST - 2 * _MARGIN) / size[1])
    height = max(float(size[1] * scale), _FLATTEST) + 2 * _MARGIN + 20
    middle = (low + high) / 2
    drawing = Drawing(height, language.say(f"figure {view} label"))

    def at(position: FloatArray) -> FloatArray:
        """Place of a position (2,) in the drawing."""
        return np.asarray(np.array([WIDTH / 2, (height - 20) / 2]) + (position - middle) * [scale, -scale])

    points = [at(f) for f, p in zip(flat, places, strict=True) if p.sight is None and not p.static]
    if view == "plan" and of_structure and len(points) > 1:
        _draw_face(drawing, np.stack(points))
    for f, place in zip(flat, places, strict=True):
        if place.sight is not None:
            direction, half = place.sight
            seen = np.array([direction[right], -sign * direction[up]]), float(half[0 if view == "plan" else 1])
            away = np.linalg.norm(np.array(points) - at(f), axis=1).max(initial=60.0)
            _draw_camera(drawing, at(f), seen, float(away))
    _draw_names(drawing, [(at(f), p) for f, p in zip(flat, places, strict=True)])
    _draw_axes(drawing, height, [(axes[right], right, (1.0, 0.0)), (axes[up], up, (0.0, -sign))], language)
    _draw_ruler(drawing, height, scale, language)
    return drawing.svg()


def _draw_face(drawing: Drawing, points: FloatArray) -> None:
    """The structure's face, through the points on it (N, 2)."""
    level = float(np.median(points[:, 1]))
    ends = [float(points[:, 0].min()) - 20, float(points[:, 0].max()) + 20]
    drawing.line([[ends[0], level], [ends[1], level]], "#b9b9b9", width=5)


def _draw_camera(drawing: Drawing, at: FloatArray, sight: tuple[FloatArray, float], reach: float) -> None:
    """A camera with its field of view as far as it reaches, seen along an axis."""
    direction, half = sight
    length = float(np.linalg.norm(direction))
    if length < 0.2:
        drawing.dot(at, 5, VERMILION, filled=False)
        return
    angle = float(np.arctan2(direction[1], direction[0]))
    corners = [at + reach * np.array([np.cos(angle + side), np.sin(angle + side)]) for side in (-half, half)]
    drawing.area([at, *corners], VERMILION, opacity=0.12)
    for corner in corners:
        drawing.line([at, corner], VERMILION, width=0.6)
    drawing.arrow(at, at + 34 * direction / length, VERMILION)


def _draw_names(drawing: Drawing, placed: list[tuple[FloatArray, Place]]) -> None:
    """Dots and names of all; names that would cover another one are left out where there are many points."""
    taken = [(at[0] - 5, at[0] + 5, at[1] + 4) for at, _ in placed]
    many = sum(place.sight is None for _, place in placed) > MANY_POINTS
    for at, place in placed:
        colour = VERMILION if place.sight is not None else GREY if place.static else BLUE
        drawing.dot(at, 4 if place.sight is not None else 3, colour, filled=not place.static)
        text = shorten(place.name, 150)
        width = 0.56 * 10.5 * len(text)
        late = at[0] > WIDTH - _ROOM - width
        x = float(at[0]) + (-7 if late else 7)
        begin = x - width if late else x
        for y in (float(at[1]) - 5, float(at[1]) + 13, float(at[1]) + 26, float(at[1]) - 18):
            free = all(abs(y - other) > 10.5 or begin > end or begin + width < start for start, end, other in taken)
            if free:
                break
        if free or not many:
            taken.append((begin, begin + width, y))
            drawing.text(x, y, text, anchor="end" if late else "start", size=10.5, halo="white")


def _draw_axes(
    drawing: Drawing, height: float, axes: list[tuple[str, int, tuple[float, float]]], language: Language
) -> None:
    """Arrows of two axes in their positive directions, at the lower left."""
    corner = np.array([24.0, height - 40.0])
    if any(direction[1] > 0 for _, _, direction in axes):
        corner = np.array([24.0, height - 66.0])
    for name, number, direction in axes:
        end = corner + 30 * np.array(direction)
        drawing.arrow(corner, end, AXIS_COLOURS[number])
        label = language.word("axis", name)
        x, y = (end[0] + 4, end[1] + 4) if direction[0] else (end[0] + 6, end[1] + (8 if direction[1] > 0 else 0))
        drawing.text(x, y, label, size=10.5, colour=AXIS_COLOURS[number], halo="white")


def _draw_ruler(drawing: Drawing, height: float, scale: float, language: Language) -> None:
    """A bar of a round number of metres, at the lower right."""
    length_m = nice_ticks(0.0, 140.0 / scale, 1)[-1] or 1.0
    right, y = WIDTH - 16.0, height - 10.0
    left = right - length_m * scale
    drawing.line([[left, y - 4], [left, y], [right, y], [right, y - 4]], "#222222", width=1.2)
    shown = f"{language.write(length_m, count_decimals(length_m, 1))} m"
    drawing.text((left + right) / 2, y - 4, shown, anchor="middle", size=10.5, halo="white")
