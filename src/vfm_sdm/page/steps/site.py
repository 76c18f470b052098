"""Step 3: what was measured on site, with units and uncertainty, drawn to scale while it is typed."""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from nicegui import ui

from vfm_sdm.page.sketch import draw_site
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import as_point, in_thread, tell_errors, value_at, while_busy
from vfm_sdm.page.steps.further import show_further
from vfm_sdm.page.steps.lenses import LensForm

__all__ = ["show_site"]

_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
_TOOLS = {"tape": 0.005, "laser": 0.003, "drawing": 0.02, "estimate": 0.1}
"""Standard deviations to begin with [m]: what such readings repeat to between optical centres and a face."""
_LENGTHS = (
    (("site", "baseline"), "Baseline: between the two cameras"),
    (("site", "perpendicular_distance"), "Reference camera to the face of the structure, at a right angle"),
    (("site", "longitudinal_distance"), "From the foot of that line along the face to the picture's centre"),
)
_READINGS = {
    "perpendicular_distance": "This camera to the face, at a right angle",
    "longitudinal_distance": "From the foot of that line along the face to its picture's centre",
}


def show_site(page: PageState) -> None:
    """Builds the step.

    Parameters
    ----------
    page
        What the steps share.
    """
    ui.markdown(
        "Lengths with the tool they were measured with; the standard deviation (std) that goes with it is a beginning "
        "that you may correct. The *face* is the side of the structure that the cameras see, as an upright plane."
    )
    with ui.row().classes("w-full no-wrap items-start"):
        with ui.column().classes("w-1/2"):
            faults = ui.label("").classes("text-negative whitespace-pre-line")
            sketch = _Sketch(page, faults)
            for path, title in _LENGTHS:
                _length(page, path, title, sketch)
            _side(page, sketch)
            _level(page, ("site", "reference_camera_level"), sketch)
            for view in page.fields.get("view", ())[1:]:
                _other_camera(page, str(view["name"]), sketch)
            show_further(page, sketch.refresh)
            ui.label("Lenses").classes("text-bold")
            for view in page.fields.get("view", ()):
                LensForm(page, view, sketch.refresh).build()
        with ui.column().classes("w-1/2"):
            sketch.build()


class _Sketch:
    """The drawing, which follows every change."""

    def __init__(self, page: PageState, faults: ui.label) -> None:
        self._page, self._faults = page, faults

    def build(self) -> None:
        self._drawn = ui.html("", sanitize=False).classes("w-full")
        place = ui.button("Place cameras and points by the pictures").props("flat no-caps")
        place.on_click(while_busy(place, self.relate))
        self._rig: Any = None
        self._points: dict[str, Any] = {}
        ui.timer(0, tell_errors(self.refresh), once=True)

    async def relate(self) -> None:
        """Draws cameras and points where the pictures see them; takes some seconds the first time."""
        sight = await in_thread(self._page.sight)
        self._rig = (await in_thread(lambda: sight.relation)).rig
        views = list(sight.sizes)
        for row in self._page.fields.get("point", ()):
            point = as_point(row)
            found = await in_thread(sight.counterparts, point)
            places = {point.view: point.pixel} | {view: one.pixel for view, one in found.items() if one.pixel}
            pixels = np.array([places.get(view, (np.nan, np.nan)) for view in views])
            self._points[point.name] = pixels, point.static
        await self.refresh()

    async def refresh(self) -> None:
        """Draws anew, and says what is missing."""
        site, wrong = self._page.site()
        _, faults = self._page.draft.session()
        self._faults.set_text("\n".join(faults))
        names = [str(view["name"]) for view in self._page.fields.get("view", ())]
        drawn = f"<p>{escape(wrong)}</p>" if wrong else draw_site(site, names, self._rig, self._points)
        self._drawn.set_content(drawn)


def _length(page: PageState, path: Sequence[str], title: str, sketch: _Sketch) -> None:
    """A length with its unit, its tool and its standard deviation."""
    found = value_at(page.fields, path) or {}
    with ui.row().classes("items-end no-wrap w-full"):
        value = ui.number(title, value=found.get("value")).props("dense clearable").classes("grow")
        unit = ui.select(list(_UNITS), value="m").props("dense")
        tool = ui.select([*_TOOLS, "other"], value="tape" if not found else "other", label="by").props("dense")
        std = ui.number("std [mm]", value=1e3 * found.get("std", _TOOLS["tape"]), min=0.001).props("dense")
        std.classes("w-24")

    async def keep() -> None:
        if value.value is None:
            page.draft.put(path, None)
        elif std.value:
            metres = float(value.value) * _UNITS[str(unit.value)]
            page.draft.put(path, {"value": round(metres, 6), "std": round(float(std.value) / 1e3, 6)})
        await sketch.refresh()

    async def choose(event: Any) -> None:
        if event.value in _TOOLS:
            std.set_value(1e3 * _TOOLS[event.value])
        await keep()

    for one in (value, unit, std):
        one.on_value_change(tell_errors(keep))
    tool.on_value_change(tell_errors(choose))


def _side(page: PageState, sketch: _Sketch) -> None:
    """On which side the face lies."""
    ui.label("Looking where the reference camera looks, the face of the structure lies on its")
    side = ui.toggle(["left", "right"], value=value_at(page.fields, ("site", "structure_side")) or "right").props(
        "dense"
    )

    async def keep() -> None:
        page.draft.put(("site", "structure_side"), str(side.value))
        await sketch.refresh()

    side.on_value_change(tell_errors(keep))


def _other_camera(page: PageState, name: str, sketch: _Sketch) -> None:
    """What was read at a camera that is not the reference: it tells poses apart that look alike in the pictures."""
    path = ("view", name, "stands")
    with ui.expansion(f"Readings at camera {name}").classes("w-full"):
        for field, title in _READINGS.items():
            _length(page, ("view", name, field), title, sketch)
        _level(page, ("view", name, "level"), sketch)
        with ui.row().classes("items-center"):
            ui.label("Looking where it looks, it stands beside the reference camera, on its")
            stands = ui.select(["not said", "left", "right"], value=value_at(page.fields, path) or "not said")
            stands.props("dense").props["aria-label"] = f"side of {name}"

    async def keep(event: Any) -> None:
        page.draft.put(path, None if event.value == "not said" else str(event.value))
        await sketch.refresh()

    stands.on_value_change(tell_errors(keep))


def _level(page: PageState, path: Sequence[str], sketch: _Sketch) -> None:
    """Pitch and roll of a camera."""
    found = value_at(page.fields, path) or {}
    both = found.get("value_deg")
    with ui.row().classes("items-end no-wrap w-full"):
        pitch = ui.number("Camera looks upwards by [deg]", value=found.get("pitch_deg", both))
        pitch.props("dense clearable").classes("grow")
        roll = ui.number("its right side is lower by [deg]", value=found.get("roll_deg", both))
        roll.props("dense clearable").classes("grow")
        std = ui.number("std [deg]", value=found.get("std_deg", 0.2), min=0.001).props("dense").classes("w-24")

    async def keep() -> None:
        stated = {"pitch_deg": pitch.value, "roll_deg": roll.value}
        given = {name: float(value) for name, value in stated.items() if value is not None}
        page.draft.put(path, {**given, "std_deg": float(std.value)} if given and std.value else None)
        await sketch.refresh()

    for one in (pitch, roll, std):
        one.on_value_change(tell_errors(keep))
