"""Step 2: points clicked in the first frames, what each is worth, and where it is in the other views."""

from collections.abc import Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
from matplotlib.path import Path
from nicegui import ui

from vfm_sdm.errors import SessionError
from vfm_sdm.outputs.results import Worth
from vfm_sdm.page.sight import Counterpart, Sight, Subset
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import as_point, in_thread, tell_errors
from vfm_sdm.studies.planning.suggestion import suggest_points

__all__ = ["fill_polygon", "show_points"]

_LIGHTS = {
    Worth.GOOD: "#2e7d32", Worth.PART: "#9ccc65", Worth.EDGE: "#f9a825", Worth.UNKNOWN: "#9e9e9e",
    Worth.REFUSED: "#c62828",
}  # fmt: skip
_FOUND = ("ok", "named")
_MODES = {"new": "new point", "place": "place the chosen point", "area": "area"}
_MOST_POINTS = 400


class _Points:
    """The step's widgets, and what is known of the points."""

    def __init__(self, page: PageState) -> None:
        self.page = page
        self.subsets: dict[tuple[str, str, float, float], Subset] = {}
        self.elsewhere: dict[str, dict[str, Counterpart]] = {}
        self.chosen = ""
        self.overlays: dict[str, Any] = {}
        self.sight: Sight | None = None
        self.area: tuple[str, list[tuple[float, float]]] = ("", [])

    def build(self) -> None:
        ui.markdown(
            "Click a point in any view; **drag** it to correct it, also where it was found in the other view. Wheel "
            "zooms, dragging the picture moves it. The square is what is compared; its colour says what it is worth."
        )
        self.pictures = ui.row().classes("w-full no-wrap items-start")
        with ui.row().classes("items-center"):
            ui.button("Suggest points", icon="auto_fix_high", on_click=tell_errors(self.suggest)).props("outline")
            self.wanted = ui.number("points", value=6, min=1, max=200, format="%d").props("dense").classes("w-20")
            ui.separator().props("vertical")
            self.mode = ui.toggle(_MODES, value="new").props('dense no-caps aria-label="what a click does"')
            self.mode.on_value_change(tell_errors(self.end_area))
            self.spacing = ui.number("spacing [px]", value=80, min=10).props("dense").classes("w-24")
            ui.button("Fill area", on_click=tell_errors(self.fill)).props("outline dense no-caps")
            self.busy = ui.spinner(size="1.5em")
            self.busy.visible = False
            self.says = ui.label("")
        self.table = ui.column().classes("w-full gap-0")
        ui.on("vs_click", tell_errors(self.clicked))
        ui.on("vs_drag", tell_errors(self.dragged))
        ui.on("vs_pick", tell_errors(self.picked))
        ui.timer(0, tell_errors(self.open), once=True)

    async def open(self) -> None:
        self.pictures.clear()
        self.overlays.clear()
        if not self.page.fields.get("view"):
            with self.pictures:
                ui.label("Choose films first.")
            return
        self.sight = await in_thread(self.page.sight)
        with self.pictures:
            for view, (width, height) in self.sight.sizes.items():
                self._picture(view, width, height)
        await self.refresh()
        await self.look_for_all()

    def _picture(self, view: str, width: int, height: int) -> None:
        with ui.column().classes("w-1/2 gap-0 relative"):
            ui.label(view).classes("text-bold")
            frame = ui.element("div").classes("vs-frame w-full")
            frame.props["data-view"], frame.props["data-width"], frame.props["data-height"] = view, width, height
            with frame, ui.element("div").classes("vs-sheet"):
                ui.html(f'<img src="/picture/{escape(view)}/0" alt="first frame" draggable="false">', sanitize=False)
                self.overlays[view] = ui.html("", sanitize=False)
            lens = ui.element("canvas").classes("vs-lens")
            lens.props["width"] = lens.props["height"] = 168
            ui.label("").classes("vs-read")

    async def clicked(self, event: Any) -> None:
        """Adds a point."""
        view, u, v = event.args["view"], float(event.args["u"]), float(event.args["v"])
        if self.mode.value == "area":
            kept = self.area[1] if self.area[0] == view else []
            self.area = view, [*kept, (u, v)]
            await self.refresh()
            return
        if self.mode.value == "place":
            if not self.chosen:
                raise SessionError("place: expected a chosen point, got none; click a point first")
            self.page.draft.move_point(self.chosen, view, (u, v))
        else:
            self.chosen = self.page.draft.add_point(view, (u, v))
        await self.refresh()
        await self.look_for(self.chosen)

    async def end_area(self, _: Any) -> None:
        """Forgets the corners of an area."""
        self.area = "", []
        await self.refresh()

    async def fill(self) -> None:
        """Fills the area whose corners were clicked with a grid of points."""
        view, corners = self.area
        if len(corners) < 3:
            raise SessionError("area: expected three corners or more, got fewer; choose 'area' and click them")
        grid = fill_polygon(corners, float(self.spacing.value or 80))
        if not 0 < len(grid) <= _MOST_POINTS:
            raise SessionError(f"area: expected 1 to {_MOST_POINTS} points, got {len(grid)}; change the spacing")
        for pixel in grid:
            self.page.draft.add_point(view, pixel)
        self.mode.set_value("new")
        await self.refresh()
        await self.look_for_all()

    async def dragged(self, event: Any) -> None:
        """Moves a point in a view."""
        view, name = event.args["view"], event.args["point"]
        at = self._places(view).get(name)
        if at is None:
            return
        self.page.draft.move_point(name, view, (at[0] + float(event.args["u"]), at[1] + float(event.args["v"])))
        self.chosen = name
        self.elsewhere.pop(name, None)
        await self.refresh()
        await self.look_for(name)

    async def picked(self, event: Any) -> None:
        """Chooses a point."""
        self.chosen = event.args["point"]
        await self.refresh()

    async def look_for_all(self) -> None:
        for point in self._rows():
            await self.look_for(point["name"])

    async def look_for(self, name: str) -> None:
        """What a point is worth in its own view at once, then where it is in the others, and what it is worth there."""
        sight = self.sight
        point = next((one for one in self._rows() if one["name"] == name), None)
        if point is None or sight is None:
            return
        self.busy.visible = True
        try:
            await self._judge(sight, point["view"], name, tuple(point["pixel"]))
            self.elsewhere[name] = await in_thread(sight.counterparts, as_point(point))
            await self.refresh()
            for view, one in self.elsewhere[name].items():
                if one.pixel is not None:
                    await self._judge(sight, view, name, one.pixel)
        finally:
            self.busy.visible = False

    async def _judge(self, sight: Sight, view: str, name: str, pixel: tuple[float, float]) -> None:
        key = (view, name, *pixel)
        if key not in self.subsets:
            self.subsets[key] = await in_thread(sight.judge, view, name, pixel)
        await self.refresh()

    async def suggest(self) -> None:
        """Adds the best places that are found, in a thread."""
        found, faults = self.page.draft.session()
        if found is None:
            raise SessionError("points suggest: expected the site's lengths first; " + "; ".join(faults))
        self.busy.visible = True
        self.says.set_text("looks for the best places; this takes some minutes")
        try:
            suggestion = await in_thread(partial(suggest_points, found, count=int(self.wanted.value or 6)))
        finally:
            self.busy.visible = False
            self.says.set_text("")
        known = {one["name"] for one in self._rows()}
        for one in suggestion.session.point:
            if one.name not in known:
                self.page.draft.add_point(one.view, one.pixel, name=one.name, static=one.static)
        await self.refresh()
        await self.look_for_all()

    async def refresh(self) -> None:
        """Draws the overlays and the table anew."""
        for view, overlay in self.overlays.items():
            overlay.set_content(self._svg(view))
        self.table.clear()
        with self.table:
            self._rows_of_table()

    def _rows(self) -> list[dict[str, Any]]:
        return list(self.page.fields.get("point", ()))

    def _places(self, view: str) -> dict[str, tuple[float, float]]:
        """Where points are in a view, named or found [px]."""
        found = {}
        for point in self._rows():
            there = self.elsewhere.get(point["name"], {}).get(view)
            if point["view"] == view:
                found[point["name"]] = tuple(point["pixel"])
            elif view in point.get("pixel_in", {}):
                found[point["name"]] = tuple(point["pixel_in"][view])
            elif there is not None and there.pixel is not None:
                found[point["name"]] = there.pixel
        return found

    def _svg(self, view: str) -> str:
        if self.sight is None:
            return ""
        width, height = self.sight.sizes[view]
        marks = [self._line(view)]
        if self.area[0] == view:
            corners = " ".join(f"{u:.1f},{v:.1f}" for u, v in self.area[1])
            marks.append(f'<polygon points="{corners}" fill="#ffb30055" stroke="#ffb300" stroke-width="2"/>')
        for name, (u, v) in self._places(view).items():
            subset = self.subsets.get((view, name, u, v))
            colour = _LIGHTS[subset.worth] if subset else "#ffffff"
            half = subset.side_px / 2 if subset else 0.0
            thick = 4 if name == self.chosen else 2
            marks.append(
                f'<g class="vs-point" data-point="{escape(name)}" fill="none" stroke="{colour}" stroke-width="{thick}">'
                f'<rect x="{u - half}" y="{v - half}" width="{2 * half}" height="{2 * half}"/>'
                f'<path class="vs-mark" d="M{u - 3} {v}h6M{u} {v - 3}v6"/>'
                f'<text x="{u + half + 2}" y="{v - half - 2}">{escape(name)}</text></g>'
            )
        return f'<svg viewBox="-0.5 -0.5 {width} {height}" preserveAspectRatio="none">{"".join(marks)}</svg>'

    def _line(self, view: str) -> str:
        """The epipolar line of the chosen point."""
        there = self.elsewhere.get(self.chosen, {}).get(view)
        if there is None or len(there.line) < 2:
            return ""
        corners = " ".join(f"{u:.1f},{v:.1f}" for u, v in there.line)
        return f'<polyline points="{corners}" fill="none" stroke="#4fc3f7" stroke-width="1.5" stroke-dasharray="6 4"/>'

    def _rows_of_table(self) -> None:
        rows = self._rows()
        if not rows:
            ui.label("No point yet.")
            return
        with ui.grid(columns="auto minmax(9em,1fr) auto 3fr auto").classes("w-full items-center gap-x-4 gap-y-0"):
            for point in rows:
                self._row_of_table(point)

    def _row_of_table(self, point: dict[str, Any]) -> None:
        name = point["name"]
        with ui.row().classes("no-wrap gap-0"):
            for view in self.overlays:
                self._light(view, name)
        field = ui.input(value=name).props(f'dense borderless aria-label="name of {escape(name)}"')
        field.on("blur", tell_errors(partial(self.rename, name, field)))
        field.on("keydown.enter", tell_errors(partial(self.rename, name, field)))
        still = ui.checkbox("static", value=bool(point.get("static")))
        still.on_value_change(tell_errors(partial(self.set_static, name)))
        ui.label(self._words(point)).classes("text-caption")
        ui.button(icon="delete", on_click=tell_errors(partial(self.remove, name))).props("flat dense round")

    def _light(self, view: str, name: str) -> None:
        at = self._places(view).get(name)
        subset = None if at is None else self.subsets.get((view, name, *at))
        colour = _LIGHTS[subset.worth] if subset else "#fff"
        light = ui.element("span").classes("vs-light").style(f"background:{colour}")
        with light:
            ui.tooltip(f"{view}: {subset.words if subset else 'not looked at yet'}")

    def _words(self, point: dict[str, Any]) -> str:
        said = []
        at = tuple(point["pixel"])
        own = self.subsets.get((point["view"], point["name"], *at))
        said.append(f"{point['view']} ({at[0]:.1f}, {at[1]:.1f}): {own.words if own else '...'}")
        for view, one in self.elsewhere.get(point["name"], {}).items():
            place = "" if one.pixel is None else f" ({one.pixel[0]:.1f}, {one.pixel[1]:.1f})"
            advice = "" if one.status in _FOUND else "; choose it, then 'place the chosen point' and click it there"
            said.append(f"{view}{place}: {one.status}{advice}")
        return " · ".join(said)

    async def rename(self, name: str, field: Any) -> None:
        """Gives a point another name."""
        wanted = str(field.value).strip()
        if wanted and wanted != name and name in {one["name"] for one in self._rows()}:
            self.page.draft.change_point(name, name=wanted)
            self.elsewhere[wanted] = self.elsewhere.pop(name, {})
            for view, old, u, v in [key for key in self.subsets if key[1] == name]:
                self.subsets[view, wanted, u, v] = self.subsets.pop((view, old, u, v))
            self.chosen = wanted
            await self.refresh()

    async def set_static(self, name: str, event: Any) -> None:
        """Says whether a point cannot move."""
        self.page.draft.change_point(name, static=True if event.value else None)

    async def remove(self, name: str) -> None:
        """Removes a point."""
        self.page.draft.remove_point(name)
        self.elsewhere.pop(name, None)
        await self.refresh()


def fill_polygon(corners: Sequence[tuple[float, float]], spacing_px: float) -> list[tuple[float, float]]:
    """Places of a square grid inside a polygon, row by row [px].

    Parameters
    ----------
    corners
        Corners in order (u, v) [px].
    spacing_px
        Distance between neighbours [px].

    Examples
    --------
    >>> fill_polygon([(0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (0.0, 10.0)], 10.0)
    [(5.0, 5.0), (15.0, 5.0)]
    """
    outline = np.array(corners)
    low, high = outline.min(axis=0), outline.max(axis=0)
    u, v = (np.arange(first + spacing_px / 2, last, spacing_px) for first, last in zip(low, high, strict=True))
    places = [(float(a), float(b)) for b in v for a in u]
    return [one for one in places if Path(outline).contains_point(one)]


def show_points(page: PageState) -> None:
    """Builds the step.

    Parameters
    ----------
    page
        What the steps share.
    """
    _Points(page).build()
