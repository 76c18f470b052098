"""Plan and elevation of a site as stated so far, to scale: swapped distances and a wrong side are seen at once."""

from collections.abc import Callable, Sequence
from html import escape

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import compute_view_angle, structure_from_cam1
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Site

__all__ = ["draw_site"]

_WIDTH = 720
_MARGIN = 46
_TALLEST = 420
_AHEAD = 1.25
_COLOURS = ("#1565c0", "#e65100", "#6a1b9a", "#2e7d32")
_TICKS = 6
_DRAWN_FROM_STRUCTURE = np.diag([1.0, 1.0, -1.0])
"""Away, down and to the right of who faces the structure: its longitudinal axis leads to the left."""


def draw_site(site: Site, names: Sequence[str], rig: Rig | None, points: dict[str, tuple[FloatArray, bool]]) -> str:
    """Plan above, elevation below, as SVG; words where too little is stated.

    Parameters
    ----------
    site
        What is stated.
    names
        Views, the reference first.
    rig
        Cameras as the pictures tell them, in any unit of length; ``None`` draws the second beside the first.
    points
        Pixels in all views, shape (V, 2) [px], and whether it is static, by name.
    """
    if site.perpendicular_distance is None or site.longitudinal_distance is None:
        return "<p>State both distances of the reference camera to see the site drawn to scale.</p>"
    distance, along = site.perpendicular_distance.value, site.longitudinal_distance.value
    level = site.reference_camera_level
    try:
        axes = _DRAWN_FROM_STRUCTURE @ structure_from_cam1(
            compute_view_angle(distance, along),
            pitch_rad=np.radians(level.pitch) if level else 0.0,
            roll_rad=np.radians(level.roll) if level else 0.0,
            side=site.structure_side,
        )
    except CameraError as error:
        return f"<p>{escape(str(error))}</p>"
    baseline = site.baseline.value if site.baseline else 1.0
    centers, marks = _place(axes, names, rig, baseline, points)
    looks = axes @ np.array([0.0, 0.0, 1.0])
    aim = looks * distance / max(looks[0], 1e-6)
    return _draw(names, centers, aim, distance, marks)


_Mark = tuple[str, FloatArray, bool]
"""Name of a point, its place away, down and to the right (3,) [m], and whether it is static."""


def _place(
    axes: FloatArray,
    names: Sequence[str],
    rig: Rig | None,
    baseline: float,
    points: dict[str, tuple[FloatArray, bool]],
) -> tuple[FloatArray, list[_Mark]]:
    """Cameras (V, 3) and points away, down and to the right from the reference camera [m]."""
    if rig is None:
        beside = axes @ np.array([1.0, 0.0, 0.0]) * baseline
        return np.array([number * beside for number in range(len(names))]), []
    centers = np.array([camera.center for camera in rig.cameras])
    scale = baseline / max(float(np.linalg.norm(centers[1] - centers[0])), 1e-12) if len(centers) > 1 else 1.0
    marks = []
    for name, (pixels, static) in points.items():
        if np.isfinite(pixels).all():
            marks.append((name, scale * axes @ triangulate(pixels[:, None], rig)[0], static))
    return scale * centers @ axes.T, marks


def _draw(
    names: Sequence[str],
    centers: FloatArray,
    aim: FloatArray,
    distance: float,
    marks: list[tuple[str, FloatArray, bool]],
) -> str:
    """Both drawings, of one scale, as seen by who faces the structure."""
    places = np.array([*centers, aim, *(place for _, place, _ in marks), [0.0, 0.0, aim[2]]])
    low, high = places.min(axis=0), places.max(axis=0)
    high[0] = max(high[0], distance) * _AHEAD
    spread = max(float(high[2] - low[2]), 0.5 * distance)
    depth = float(high[0] - low[0])
    scale = min((_WIDTH - 2 * _MARGIN) / spread, _TALLEST / depth)

    def x(right: float) -> float:
        return float(_MARGIN + (right - low[2]) * scale)

    def y(lateral: float) -> float:
        return float(_MARGIN + (high[0] - lateral) * scale)

    tall = depth * scale + 2 * _MARGIN
    lines = [f'<text x="8" y="16" class="t">plan (from above) · 1 tick = {_tick(spread):g} m</text>']
    face = y(distance)
    lines.append(f'<line x1="0" x2="{_WIDTH}" y1="{face:.1f}" y2="{face:.1f}" stroke="#5f6368" stroke-width="5"/>')
    lines.append(f'<text x="8" y="{face - 6:.1f}">face of the structure, {distance:g} m away</text>')
    lines += _ticks(spread, x, low[2], tall)
    lines.append(
        f'<line x1="{x(0):.1f}" y1="{y(0):.1f}" x2="{x(aim[2]):.1f}" y2="{face:.1f}" stroke="{_COLOURS[0]}" '
        'stroke-dasharray="6 4"/>'
    )
    for number, (name, center) in enumerate(zip(names, centers, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        at = x(center[2]), y(center[0])
        lines.append(f'<rect x="{at[0] - 6:.1f}" y="{at[1] - 6:.1f}" width="12" height="12" fill="{colour}"/>')
        lines.append(f'<text x="{at[0] + 9:.1f}" y="{at[1] + 4:.1f}" fill="{colour}">{escape(name)}</text>')
    lines += [_mark(x(place[2]), y(place[0]), name, static=static) for name, place, static in marks]
    plan = _svg(lines, tall, "plan of the site")
    heights = [float(place[1]) for place in places]
    bottom, top = max(heights), min(heights)
    side = (bottom - top) * scale + 2 * _MARGIN

    def up(vertical: float) -> float:
        return _MARGIN + (vertical - top) * scale

    lines = ['<text x="8" y="16" class="t">elevation (as the reference camera sees the face)</text>']
    lines += _ticks(spread, x, low[2], side)
    for number, (name, center) in enumerate(zip(names, centers, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        lines.append(f'<circle cx="{x(center[2]):.1f}" cy="{up(center[1]):.1f}" r="6" fill="{colour}"/>')
        lines.append(
            f'<text x="{x(center[2]) + 9:.1f}" y="{up(center[1]) + 4:.1f}" fill="{colour}">{escape(name)}</text>'
        )
    lines += [_mark(x(place[2]), up(place[1]), name, static=static) for name, place, static in marks]
    return plan + _svg(lines, side, "elevation of the site")


def _svg(lines: Sequence[str], height: float, label: str) -> str:
    style = "<style>text{font:12px sans-serif}.t{font-weight:600}</style>"
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height:.0f}" width="100%" role="img" aria-label="{label}" '
        f'style="background:#fff;max-width:{_WIDTH}px">{style}{"".join(lines)}</svg>'
    )


def _tick(spread: float) -> float:
    """A round length of which some fit [m]."""
    power = 10.0 ** np.floor(np.log10(spread / _TICKS))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= spread / _TICKS))


def _ticks(spread: float, x: Callable[[float], float], first: float, height: float) -> list[str]:
    """Marks of the scale along the lower border."""
    step = _tick(spread)
    begin = np.ceil(first / step) * step
    base = height - 8
    return [
        f'<line x1="{x(z):.1f}" x2="{x(z):.1f}" y1="{base - 6:.1f}" y2="{base:.1f}" stroke="#000"/>'
        for z in np.arange(begin, first + spread + step / 2, step)
    ]


def _mark(x: float, y: float, name: str, *, static: bool) -> str:
    colour = "#0277bd" if static else "#bf360c"
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>'
        f'<text x="{x + 6:.1f}" y="{y - 5:.1f}" fill="{colour}">{escape(name)}</text>'
    )
