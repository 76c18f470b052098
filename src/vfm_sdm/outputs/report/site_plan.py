"""Plan and elevation of cameras, structure and points, drawn to one scale."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, mean_of_known
from vfm_sdm.core.grids import without_grids
from vfm_sdm.outputs.plots.drawing import AXIS_COLOURS, BLUE, GREY, VERMILION
from vfm_sdm.outputs.report.drawing import WIDTH, Drawing, nice_ticks, shorten
from vfm_sdm.outputs.report.inputs import MANY_POINTS, ReportInputs
from vfm_sdm.outputs.report.language import Language, count_decimals

__all__ = ["Place", "draw_site", "lay_flat", "point_positions", "site_places"]

_MARGIN, _ROOM = 26.0, 70.0
_TALLEST = 330.0
_STRIP = 56.0
"""Height below a drawing, for axes and ruler."""
_FLATTEST = 90.0
"""Height of a drawing at least, also where all lies on one level."""
_NAME_SIZE = 10.5
_SPOTS = (
    *((anchor, right, down) for down in (-5.0, 13.0) for anchor, right in (("start", 7.0), ("end", -7.0))),
    *(("middle", 0.0, down) for down in (-9.0, 17.0)),
)
_FAR_SPOTS = tuple((anchor, right, down) for down in (26.0, -18.0) for anchor, right in (("start", 7.0), ("end", -7.0)))
"""Where a name may stand beside its dot, the best first: which of its ends, and how far to the right and down; far
ones where there are few names."""


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
    data = without_grids(inputs.displacement)
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
        ``plan`` or ``elevation``, see `lay_flat`.
    language
        Language of the texts.
    """
    axes = inputs.axis_names
    sheet = lay_flat(axes, view)
    flat = np.array([sheet @ place.position for place in places])
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.maximum(high - low, 1e-3)
    scale = min((WIDTH - 2 * _ROOM) / size[0], (_TALLEST - 2 * _MARGIN) / size[1])
    height = max(float(size[1] * scale), _FLATTEST) + 2 * _MARGIN + _STRIP
    drawing = Drawing(height, language.say(f"figure {view} label"))
    # Upwards on the site is downwards in a drawing.
    at = np.array([WIDTH / 2, (height - _STRIP) / 2]) + (flat - (low + high) / 2) * [scale, -scale]
    on_face = np.array([place.sight is None and not place.static for place in places])
    if view == "plan" and "longitudinal" in axes and np.count_nonzero(on_face) > 1:
        _draw_face(drawing, at[on_face])
    for here, place in zip(at, places, strict=True):
        if place.sight is not None:
            direction, half = place.sight
            seen = (sheet @ direction) * [1.0, -1.0], float(half[0 if view == "plan" else 1])
            away = np.linalg.norm(at[on_face] - here, axis=1).max(initial=60.0)
            _draw_camera(drawing, here, seen, float(away))
    _draw_names(drawing, list(zip(at, places, strict=True)))
    _draw_axes(drawing, sheet * [[1.0], [-1.0]], axes, language)
    _draw_ruler(drawing, scale, language)
    return drawing.svg()


def lay_flat(axes: tuple[str, ...], view: str) -> FloatArray:
    """Directions of the axes in a plan or an elevation: to the right, and upwards, shape (2, 3) [1].

    Parameters
    ----------
    axes
        Names of the axes.
    view
        ``plan``, as seen from above, or ``elevation``, as seen from the side of the cameras.

    Notes
    -----
    The axes are right-handed and the second one points down: seen from above, with the first one upwards, the third one
    points to the left. So it does for someone who looks along the first one. The axes of a camera are right, down and
    forward.

    Examples
    --------
    >>> lay_flat(("lateral", "vertical", "longitudinal"), "plan").tolist()
    [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    """
    of_structure = "longitudinal" in axes
    right = [0.0, 0.0, -1.0] if of_structure else [1.0, 0.0, 0.0]
    away = [1.0, 0.0, 0.0] if of_structure else [0.0, 0.0, 1.0]
    return np.array([right, away if view == "plan" else [0.0, -1.0, 0.0]])


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
    taken = [(*(at - 4.5), *(at + 4.5)) for at, _ in placed]
    many = sum(place.sight is None for _, place in placed) > MANY_POINTS
    for at, place in placed:
        colour = VERMILION if place.sight is not None else GREY if place.static else BLUE
        drawing.dot(at, 4 if place.sight is not None else 3, colour, filled=not place.static)
        text = shorten(place.name, 150)
        spots = [(spot, _letters_box(at, spot, text)) for spot in _SPOTS + (() if many else _FAR_SPOTS)]
        inside = [one for one in spots if one[1][0] > 0 and one[1][1] > 0 and one[1][2] < drawing.width] or spots
        free = [one for one in inside if not any(_overlap(one[1], other) for other in taken)]
        if free or not many:
            (anchor, right, down), box = (free or inside)[0]
            taken.append(box)
            drawing.text(at[0] + right, at[1] + down, text, anchor=anchor, size=_NAME_SIZE, halo="white")


def _letters_box(at: FloatArray, spot: tuple[str, float, float], text: str) -> tuple[float, float, float, float]:
    """Left, top, right and bottom edge of a name at a spot beside its dot."""
    (anchor, right, down), width = spot, 0.56 * _NAME_SIZE * len(text)
    left = float(at[0]) + right - width * {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor]
    return left - 2.0, float(at[1]) + down - 8.5, left + width + 2.0, float(at[1]) + down + 2.0


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether two boxes cover a common place."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _draw_axes(drawing: Drawing, sheet: FloatArray, axes: tuple[str, ...], language: Language) -> None:
    """Arrows of the two axes of a sheet in their positive directions, at the lower left."""
    along, across = (sheet[row, np.abs(sheet[row]).argmax()] for row in (0, 1))
    corner = np.array([24.0 if along > 0 else 130.0, drawing.height - (50.0 if across > 0 else 14.0)])
    for number in np.flatnonzero(np.abs(sheet).any(axis=0)):
        direction, colour = sheet[:, number], AXIS_COLOURS[number]
        end = corner + 30 * direction
        drawing.arrow(corner, end, colour)
        x, y = end + ([4 * direction[0], 4] if direction[0] else [6, 8 if direction[1] > 0 else 0])
        label, anchor = language.word("axis", axes[number]), "end" if direction[0] < 0 else "start"
        drawing.text(x, y, label, anchor=anchor, size=10.5, colour=colour, halo="white")


def _draw_ruler(drawing: Drawing, scale: float, language: Language) -> None:
    """A bar of a round number of metres, at the lower right."""
    length_m = nice_ticks(0.0, 140.0 / scale, 1)[-1] or 1.0
    right, y = WIDTH - 16.0, drawing.height - 10.0
    left = right - length_m * scale
    drawing.line([[left, y - 4], [left, y], [right, y], [right, y - 4]], "#222222", width=1.2)
    shown = f"{language.write(length_m, count_decimals(length_m, 1))} m"
    drawing.text((left + right) / 2, y - 4, shown, anchor="middle", size=10.5, halo="white")
