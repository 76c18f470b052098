"""The points as a table: their lights, names and what was found of them."""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from nicegui import ui

from vfm_sdm.page.findings import Findings
from vfm_sdm.page.steps.common import tell_errors

__all__ = ["PointTable", "TableEvents"]


@dataclass(frozen=True)
class TableEvents:
    """What the table is for.

    Parameters
    ----------
    rename
        Called with a name and the new one.
    fix
        Called with a name, and whether the point is static.
    remove
        Called with a name.
    """

    rename: Callable[[str, str], Awaitable[None]]
    fix: Callable[[str, bool], Awaitable[None]]
    remove: Callable[[str], Awaitable[None]]


class PointTable:
    """A row a point.

    Parameters
    ----------
    findings
        What was found of the points.
    events
        Who is told of changes.
    """

    def __init__(self, findings: Findings, events: TableEvents) -> None:
        self._findings, self._events = findings, events
        self._area = ui.column().classes("w-full gap-0")
        self._names: list[str] | None = None
        self._cells: dict[str, tuple[dict[str, tuple[Any, Any]], Any]] = {}

    def show(self, points: Sequence[dict[str, Any]], views: Sequence[str]) -> None:
        """Shows points; a row is only made anew where points came or went, so that nobody's typing is lost.

        Parameters
        ----------
        points
            Their tables in the session.
        views
            Names of the views.
        """
        names = [str(point["name"]) for point in points]
        if names != self._names:
            self._names = names
            self._build(points, views)
        for point in points:
            lights, words = self._cells[point["name"]]
            for view, (light, tip) in lights.items():
                colour, said = self._findings.light(points, view, point["name"])
                light.style(f"background:{colour}")
                tip.set_text(said)
            words.set_text(self._findings.describe(point))

    def _build(self, points: Sequence[dict[str, Any]], views: Sequence[str]) -> None:
        self._area.clear()
        self._cells.clear()
        with self._area:
            if not points:
                ui.label("No point yet.")
                return
            with ui.grid(columns="auto minmax(9em,1fr) auto 3fr auto").classes("w-full items-center gap-x-4 gap-y-0"):
                for point in points:
                    self._build_row(point, views)

    def _build_row(self, point: dict[str, Any], views: Sequence[str]) -> None:
        name = str(point["name"])
        lights = {}
        with ui.row().classes("no-wrap gap-0"):
            for view in views:
                light = ui.element("span").classes("vs-light")
                with light:
                    lights[view] = light, ui.tooltip("")
        field = ui.input(value=name).props("dense borderless")
        field.props["aria-label"] = f"name of {name}"

        async def rename() -> None:
            await self._events.rename(name, str(field.value).strip())

        field.on("blur", tell_errors(rename))
        field.on("keydown.enter", tell_errors(rename))
        still = ui.checkbox("static", value=bool(point.get("static")))
        with still:
            ui.tooltip(
                "On what cannot move, as an abutment: it shows how the camera itself moved. Two or more are best."
            )

        async def fix() -> None:
            await self._events.fix(name, bool(still.value))

        still.on_value_change(tell_errors(fix))
        words = ui.label("").classes("text-caption")
        remove = ui.button(icon="delete", on_click=tell_errors(partial(self._events.remove, name)))
        remove.props("flat dense round").props["aria-label"] = f"remove {name}"
        self._cells[name] = lights, words
