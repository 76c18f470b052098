"""Plan and elevation of a planned site: where the cameras stand, what each sees of the face, and what both see."""

from io import BytesIO
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.outputs.plots.drawing import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, plain_text
from vfm_sdm.studies.planning.layout import Layout

__all__ = ["draw_plan", "draw_site"]

_COLOURS = (BLUE, ORANGE, PURPLE, GREEN)
_DPI = 150
_WIDTH_IN = 9.0
_FAR = 1e3
"""What is drawn of a ray that never meets the face [m]."""
_BORDER = 25
"""Rays along each side of a picture."""


def draw_site(laid: Layout) -> bytes:
    """The figure as PNG.

    Parameters
    ----------
    laid
        Geometry of the plan.
    """
    buffer = BytesIO()
    draw_plan(laid).savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def draw_plan(laid: Layout) -> Figure:
    """Plan above, elevation of the face below, both as somebody sees them who faces the structure [m].

    Parameters
    ----------
    laid
        Geometry of the plan.
    """
    along, across, up = _limits(laid)
    sizes = [abs(float(np.diff(one)[0])) for one in (along, across, up)]
    scale = _WIDTH_IN / sizes[0]
    figure = Figure(figsize=(_WIDTH_IN + 1.2, scale * (sizes[1] + sizes[2]) + 2.2), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(sizes[1], sizes[2]))
    figure.suptitle(plain_text(f"{laid.plan.name}: fields of view in plan and on the face"), x=0.01, ha="left")
    _draw_above(laid, above, across)
    _draw_face(laid, below)
    for axes, limits in ((above, across), (below, up)):
        axes.set(xlim=along, ylim=limits, xlabel="along the structure [m]")
        axes.set_aspect("equal")
        axes.grid(visible=True, linewidth=0.4, color="#cccccc")
    return figure


def _limits(laid: Layout) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """What is drawn along the structure, from the face and of its height [m]; the first two run backwards."""
    plan, structure = laid.plan, laid.plan.structure
    places = [0.0, structure.span_m, *[one.longitudinal_m for one in plan.camera]]
    places += [one.longitudinal_m for one in plan.point]
    margin = 0.05 * (max(places) - min(places))
    reach = max(camera.perpendicular_m for camera in plan.camera)
    behind = min(structure.background_m[1], 0.35 * reach)
    height = structure.top_m - structure.bottom_m
    heights = [structure.bottom_m - height, structure.top_m + height, *[one.height_m for one in plan.point]]
    # The longitudinal axis leads to the left for somebody who faces the structure.
    along = (max(places) + margin, min(places) - margin)
    return along, (1.12 * reach, -behind), (min(heights) - 0.2, max(heights) + 0.2)


def _draw_above(laid: Layout, axes: Axes, limits: tuple[float, float]) -> None:
    """The site from above, the structure at the top."""
    plan, structure = laid.plan, laid.plan.structure
    axes.plot([0, structure.span_m], [0, 0], color=GREY, linewidth=5, solid_capstyle="butt", label="face")
    for number, (one, camera) in enumerate(zip(plan.camera, laid.cameras, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        edges = [_to_plan(laid, camera, ray, limits[1]) for ray in _side_rays(camera)]
        outline = np.array([[one.longitudinal_m, one.perpendicular_m], *edges])
        axes.fill(*outline.T, color=colour, alpha=0.15, linewidth=0)
        for edge in edges:
            axes.plot(*np.array([outline[0], edge]).T, color=colour, linewidth=0.8)
        axes.plot(one.longitudinal_m, one.perpendicular_m, "s", color=colour, markersize=8, label=plain_text(one.name))
    _mark_points(laid, axes, [(p.longitudinal_m, p.perpendicular_m) for p in plan.point], names=False)
    axes.set(ylabel="from the face [m]")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), frameon=False, ncols=len(plan.camera) + 3)


def _draw_face(laid: Layout, axes: Axes) -> None:
    """What each camera sees of the plane of the face."""
    plan, structure = laid.plan, laid.plan.structure
    for number, (one, camera) in enumerate(zip(plan.camera, laid.cameras, strict=True)):
        outline = np.array([_on_face(laid, camera, ray) for ray in _border_rays(camera)])
        colour = _COLOURS[number % len(_COLOURS)]
        axes.fill(*outline.T, color=colour, alpha=0.18, linewidth=0)
        axes.plot(*outline.T, color=colour, linewidth=1.2, label=plain_text(one.name))
    low, high, span = structure.bottom_m, structure.top_m, structure.span_m
    axes.plot([0, span, span, 0, 0], [low, low, high, high, low], color=GREY, linewidth=1.5)
    _mark_points(laid, axes, [(p.longitudinal_m, p.height_m) for p in plan.point], names=True)
    axes.set(ylabel="height [m]")


def _mark_points(laid: Layout, axes: Axes, places: list[tuple[float, float]], *, names: bool) -> None:
    """Points that move as crosses, static ones as triangles, those that fewer than two cameras see in red."""
    enough = laid.visible().sum(axis=0) >= 2
    labels = {"x": "point", "^": "static point"}
    for one, place, seen in zip(laid.plan.point, places, enough, strict=True):
        marker = "^" if one.static else "x"
        colour = "black" if seen else VERMILION
        axes.plot(*place, marker, color=colour, markersize=7, label=labels.pop(marker, "_"), zorder=3)
        if names:
            axes.annotate(plain_text(one.name), place, (4, 4), textcoords="offset points", fontsize=8, color=colour)


def _side_rays(camera: Camera) -> list[FloatArray]:
    """Rays through the middles of the left and right border of a picture, in the world frame, shape (3,) each."""
    width, height = camera.image_size
    return [_ray(camera, (u, (height - 1) / 2)) for u in (-0.5, width - 0.5)]


def _border_rays(camera: Camera) -> list[FloatArray]:
    """Rays around the border of a picture, in the world frame, shape (3,) each."""
    width, height = camera.image_size
    steps = np.linspace(0, 1, _BORDER)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * [width, height] - 0.5
    sides = [(1 - s) * a + s * b for a, b in pairwise(corners) for s in steps]
    return [_ray(camera, tuple(pixel)) for pixel in sides]


def _ray(camera: Camera, pixel: tuple[float, float]) -> FloatArray:
    return np.append(camera.normalize(np.array(pixel)), 1.0) @ camera.rotation


def _to_plan(laid: Layout, camera: Camera, ray: FloatArray, perpendicular_m: float) -> tuple[float, float]:
    """Longitudinal coordinate and distance from the face at which a ray ends [m]."""
    first = laid.plan.camera[0]
    across = first.perpendicular_m - perpendicular_m - camera.center[0]
    step = min(across / ray[0], _FAR) if ray[0] > 0 else _FAR
    at = camera.center + step * ray
    return float(at[2] + first.longitudinal_m), float(first.perpendicular_m - at[0])


def _on_face(laid: Layout, camera: Camera, ray: FloatArray) -> tuple[float, float]:
    """Longitudinal coordinate and height at which a ray meets the plane of the face [m]; far off where it does not."""
    first = laid.plan.camera[0]
    across = laid.face_m[0] - camera.center[0]
    step = min(across / ray[0], _FAR) if ray[0] > 0 else _FAR
    at = camera.center + step * ray
    return float(at[2] + first.longitudinal_m), float(first.height_m - at[1])
