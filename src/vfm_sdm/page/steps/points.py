"""Step 2: points clicked in the first frames, what each is worth, and where it is in the other views."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.path import Path
from nicegui import ui

from vfm_sdm.errors import SessionError
from vfm_sdm.outputs.results import Worth
from vfm_sdm.page.findings import LIGHTS, Findings
from vfm_sdm.page.sight import Sight
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import as_point, in_thread, picture_address, tell_errors
from vfm_sdm.page.steps.point_table import PointTable, TableEvents
from vfm_sdm.studies.planning.suggestion import suggest_points

__all__ = ["fill_polygon", "show_points"]

_MODES = {"new": "new point", "place": "place the chosen point", "area": "area"}
_LEGEND = {
    Worth.GOOD: "measured in both directions, as well as the px say",
    Worth.PART: "by a part of its square, or beside a pattern that repeats",
    Worth.EDGE: "across an edge only",
    Worth.REFUSED: "refused",
}
_MOST_POINTS = 400
_LENS_PX = 168


class _Points:
    """The step's widgets, and what is known of the points."""

    def __init__(self, page: PageState) -> None:
        self.page, self.findings = page, Findings()
        self.chosen = ""
        self.overlays: dict[str, Any] = {}
        self.sight: Sight | None = None
        self.area: tuple[str, list[tuple[float, float]]] = ("", [])

    def build(self) -> None:
        ui.markdown(
            "Click a point in any view; **drag** it to correct it, also where it was found in the other view. Wheel "
            "zooms, dragging the picture moves it. The square is what is compared; its colour says what it is worth."
        )
        with ui.row().classes("gap-x-6 gap-y-0 text-caption"):
            for worth, words in _LEGEND.items():
                with ui.row().classes("items-center no-wrap gap-0"):
                    ui.element("span").classes("vs-light").style(f"background:{LIGHTS[worth]}")
                    ui.label(words)
        self.pictures = ui.row().classes("w-full no-wrap items-start")
        for event, handler in (("vs_click", self.clicked), ("vs_drag", self.dragged), ("vs_pick", self.picked)):
            self.pictures.on(event, tell_errors(handler), ["detail"])
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
        self.table = PointTable(self.findings, TableEvents(self.rename, self.fix, self.remove))
        ui.timer(0, tell_errors(self.open), once=True)

    async def open(self) -> None:
        """Shows the first frames, and looks for the points that there are."""
        if not self.page.fields.get("view"):
            with self.pictures:
                ui.label("Choose films first.")
            return
        self.sight = await in_thread(self.page.sight)
        with self.pictures:
            for view, (width, height) in self.sight.sizes.items():
                self._picture(view, width, height)
        self.refresh()
        await in_thread(self.sight.look_around)
        await self.look_for_all()

    def _picture(self, view: str, width: int, height: int) -> None:
        with ui.column().classes("w-1/2 gap-0 relative"):
            ui.label(view).classes("text-bold")
            frame = ui.element("div").classes("vs-frame w-full")
            frame.props["data-view"], frame.props["data-width"], frame.props["data-height"] = view, width, height
            # Of the picture's shape: what is below the cursor stays there while it grows.
            frame.style(f"aspect-ratio: {width} / {height}")
            with frame, ui.element("div").classes("vs-sheet"):
                ui.html(
                    f'<img src="{picture_address(self.page, view)}" alt="first frame" draggable="false">',
                    sanitize=False,
                )
                self.overlays[view] = ui.html("", sanitize=False)
            lens = ui.element("canvas").classes("vs-lens")
            lens.props["width"] = lens.props["height"] = _LENS_PX
            ui.label("").classes("vs-read")

    async def clicked(self, event: Any) -> None:
        """Adds a point, says where the chosen one is in this view, or adds a corner of an area."""
        at = event.args["detail"]
        view, u, v = at["view"], float(at["u"]), float(at["v"])
        if self.mode.value == "area":
            kept = self.area[1] if self.area[0] == view else []
            self.area = view, [*kept, (u, v)]
            self.refresh()
            return
        if self.mode.value == "place":
            if not self.chosen:
                raise SessionError("place: expected a chosen point, got none; click a point first")
            self.page.draft.move_point(self.chosen, view, (u, v))
        else:
            self.chosen = self.page.draft.add_point(view, (u, v))
        self.refresh()
        await self.look_for(self.chosen)

    async def end_area(self) -> None:
        """Forgets the corners of an area."""
        self.area = "", []
        self.refresh()

    async def fill(self) -> None:
        """Fills the area whose corners were clicked with a grid of points."""
        view, corners = self.area
        if len(corners) < 3:
            raise SessionError("area: expected three corners or more, got fewer; choose 'area' and click them")
        grid = fill_polygon(corners, float(self.spacing.value or 80))
        if not 0 < len(grid) <= _MOST_POINTS:
            raise SessionError(f"area: expected 1 to {_MOST_POINTS} points, got {len(grid)}; change the spacing")
        with self.page.draft.at_once():
            for pixel in grid:
                self.page.draft.add_point(view, pixel)
        self.mode.set_value("new")
        self.refresh()
        await self.look_for_all()

    async def dragged(self, event: Any) -> None:
        """Moves a point in a view."""
        by = event.args["detail"]
        view, name = by["view"], by["point"]
        at = self.findings.places(self.rows, view).get(name)
        if at is None:
            return
        self.page.draft.move_point(name, view, (at[0] + float(by["u"]), at[1] + float(by["v"])))
        self.chosen = name
        self.refresh()
        await self.look_for(name)

    async def picked(self, event: Any) -> None:
        """Chooses a point."""
        self.chosen = event.args["detail"]["point"]
        self.refresh()

    async def look_for_all(self) -> None:
        """Looks for every point, one after the other."""
        for point in self.rows:
            await self.look_for(point["name"])

    async def look_for(self, name: str) -> None:
        """What a point is worth in its own view at once, then where it is in the others, and what it is worth there."""
        point = next((one for one in self.rows if one["name"] == name), None)
        if point is None or self.sight is None:
            return
        self.busy.visible = True
        try:
            await self._judge(self.sight, point["view"], (float(point["pixel"][0]), float(point["pixel"][1])))
            if not self.findings.counterparts(point):
                self.findings.add_counterparts(point, await in_thread(self.sight.counterparts, as_point(point)))
            self.refresh()
            for view, one in self.findings.counterparts(point).items():
                if one.pixel is not None:
                    await self._judge(self.sight, view, one.pixel)
        finally:
            self._rest()

    def _rest(self) -> None:
        """Nothing is looked for any more; the step may have been left meanwhile."""
        if not self.busy.is_deleted:
            self.busy.visible = False
            self.says.set_text("")

    async def _judge(self, sight: Sight, view: str, pixel: tuple[float, float]) -> None:
        if self.findings.subset(view, pixel) is None:
            self.findings.add_subset(view, pixel, await in_thread(sight.judge, view, pixel))
        self.refresh()

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
            self._rest()
        known = {one["name"] for one in self.rows}
        with self.page.draft.at_once():
            for one in suggestion.session.point:
                if one.name not in known:
                    self.page.draft.add_point(one.view, one.pixel, name=one.name, static=one.static)
        self.refresh()
        await self.look_for_all()

    def refresh(self) -> None:
        """Draws the overlays anew, and shows what is known in the table."""
        rows = self.rows
        for view, overlay in self.overlays.items():
            area = ""
            if self.area[0] == view:
                corners = " ".join(f"{u:.1f},{v:.1f}" for u, v in self.area[1])
                area = f'<polygon points="{corners}" fill="#ffb30055" stroke="#ffb300" stroke-width="2"/>'
            size = self.sight.sizes[view] if self.sight else (1, 1)
            overlay.set_content(self.findings.draw(rows, view, size=size, chosen=self.chosen, area=area))
        self.table.show(rows, list(self.overlays))

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Tables of the points, as the file holds them now."""
        return list(self.page.fields.get("point", ()))

    async def rename(self, name: str, wanted: str) -> None:
        """Gives a point another name."""
        if wanted and wanted != name and name in {one["name"] for one in self.rows}:
            self.page.draft.change_point(name, name=wanted)
            self.chosen = wanted if self.chosen == name else self.chosen
            self.refresh()

    async def fix(self, name: str, static: bool) -> None:
        """Says whether a point cannot move; where it is elsewhere, the face tells no more."""
        self.page.draft.change_point(name, static=True if static else None)
        await self.look_for(name)

    async def remove(self, name: str) -> None:
        """Removes a point."""
        self.page.draft.remove_point(name)
        self.refresh()


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
