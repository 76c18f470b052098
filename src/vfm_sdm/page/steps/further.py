"""Further lengths, rectangles and edges of the site: rows that are added and taken away."""

from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any

from nicegui import ui

from vfm_sdm.errors import SessionError
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import tell_errors

__all__ = ["show_further"]

_CAMERA = "camera "
_CORNERS = ("top left", "top right", "bottom right", "bottom left")


def show_further(page: PageState, refresh: Callable[[], Awaitable[None]]) -> None:
    """Builds the rows, and the fields that add one.

    Parameters
    ----------
    page
        What the steps share.
    refresh
        Called after a change.
    """
    _Rows(page, refresh).build()


class _Rows:
    """Rows of the tables ``range``, ``length`` and ``rectangle`` of the site."""

    def __init__(self, page: PageState, refresh: Callable[[], Awaitable[None]]) -> None:
        self._page, self._refresh = page, refresh
        self._points = [str(point["name"]) for point in page.fields.get("point", ())]
        self._cameras = [f"{_CAMERA}{view['name']}" for view in page.fields.get("view", ())]

    def build(self) -> None:
        """Shows all rows, and the fields that add one."""
        ui.label("Further lengths check the scale").classes("text-bold")
        self._listed = ui.column().classes("w-full gap-0")
        self._show()
        self._length_fields()
        with ui.expansion("Rectangles and straight edges, which tell the lens").classes("w-full"):
            self._rectangle_fields()
            edges = ui.checkbox("Edges of the structure run along its axes (to about 1 deg)")
            edges.set_value("lines" in self._page.fields.get("site", {}))
            edges.on_value_change(tell_errors(self._keep_edges))

    def _show(self) -> None:
        self._listed.clear()
        site = self._page.fields.get("site", {})
        with self._listed:
            for table in ("range", "length", "rectangle"):
                for number, row in enumerate(site.get(table, ())):
                    with ui.row().classes("items-center no-wrap"):
                        ui.label(self._describe(table, row))
                        remove = ui.button(icon="delete", on_click=tell_errors(partial(self._remove, table, number)))
                        remove.props("flat dense").props["aria-label"] = f"remove {table} {number + 1}"

    def _describe(self, table: str, row: Mapping[str, Any]) -> str:
        if table == "rectangle":
            aspect = row.get("aspect")
            ratio = "" if aspect is None else f", width over height {aspect['value']:g}, std {aspect['std']:g}"
            return f"rectangle {', '.join(row.get('points', ('of pixels',)))}{ratio}"
        reference = self._cameras[0].removeprefix(_CAMERA) if self._cameras else ""
        ends = row.get("points") or (f"{_CAMERA}{row.get('view', reference)}", row.get("point"))
        return f"{ends[0]} to {ends[1]}: {row['value']:g} m, std {1e3 * row['std']:g} mm"

    def _length_fields(self) -> None:
        with ui.row().classes("items-end no-wrap w-full"):
            begin = ui.select([*self._cameras, *self._points], label="from").props("dense").classes("w-40")
            begin.set_value(self._cameras[0] if self._cameras else None)
            end = ui.select(self._points, label="to").props("dense").classes("w-32")
            begin.props["aria-label"], end.props["aria-label"] = "length from", "length to"
            value = ui.number("length [m]", min=0).props("dense").classes("w-28")
            std = ui.number("std [mm]", value=5, min=0.001).props("dense").classes("w-20")
            std.props["aria-label"] = "std of the length [mm]"

            async def add() -> None:
                if end.value is None or not begin.value or value.value is None or not std.value:
                    raise SessionError("length: expected two ends and a length, got none; choose and type them")
                measured = {"value": float(value.value), "std": round(float(std.value) / 1e3, 6)}
                table, row = "length", {"points": [begin.value, end.value], **measured}
                if begin.value in self._cameras:
                    named = {} if begin.value == self._cameras[0] else {"view": begin.value.removeprefix(_CAMERA)}
                    table, row = "range", {"point": end.value, **named, **measured}
                await self._add(table, row)

            ui.button("Add", on_click=tell_errors(add)).props("outline dense")

    def _rectangle_fields(self) -> None:
        with ui.row().classes("items-end w-full"):
            corners = [ui.select(self._points, label=name).props("dense").classes("w-28") for name in _CORNERS]
            width, height = (ui.number(f"{name} [m]", min=0).props("dense") for name in ("width", "height"))
            for name, corner in zip(_CORNERS, corners, strict=True):
                corner.props["aria-label"] = f"{name} corner"
            std = ui.number("std of both [mm]", value=2, min=0.001).props("dense").classes("w-28")

            async def add() -> None:
                names = [corner.value for corner in corners]
                if None in names:
                    raise SessionError("rectangle: expected four corners, got fewer; mark them as points and choose")
                row: dict[str, Any] = {"points": names}
                if width.value and height.value and std.value:
                    ratio = float(width.value) / float(height.value)
                    relative = float(std.value) / 1e3 * (width.value**-2 + height.value**-2) ** 0.5
                    row["aspect"] = {"value": round(ratio, 6), "std": round(ratio * relative, 6)}
                await self._add("rectangle", row)

            ui.button("Add rectangle", on_click=tell_errors(add)).props("outline dense no-caps")

    async def _add(self, table: str, row: Mapping[str, Any]) -> None:
        """Adds a row; none that the session refuses."""
        before = list(self._page.fields.get("site", {}).get(table, ()))
        self._page.draft.put(("site", table), [*before, row])
        faults = [fault for fault in self._page.draft.session()[1] if f"{table}[{len(before)}]" in fault]
        if faults:
            self._page.draft.put(("site", table), before or None)
            raise SessionError("; ".join(faults))
        await self._changed()

    async def _remove(self, table: str, number: int) -> None:
        rows = list(self._page.fields["site"][table])
        del rows[number]
        self._page.draft.put(("site", table), rows or None)
        await self._changed()

    async def _keep_edges(self, event: Any) -> None:
        self._page.draft.put(("site", "lines"), {} if event.value else None)
        await self._refresh()

    async def _changed(self) -> None:
        self._show()
        await self._refresh()
