"""Step 5: what was measured, how well, and whether to trust it; and the report."""

from functools import partial
from itertools import cycle
from json import dumps
from typing import Any

import numpy as np
from nicegui import ui

from vfm_sdm.errors import VfmSdmError
from vfm_sdm.outputs.report import write_report
from vfm_sdm.page.review import Results, stand_before
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import in_thread, picture_address, tell_errors, while_busy

__all__ = ["show_review"]

_COLOURS = ("#1565c0", "#e65100", "#2e7d32", "#6a1b9a", "#00838f", "#ad1457", "#5d4037", "#455a64")
_MOST_AT_ONCE = 8
_VERDICTS = {"fit to use": "positive", "use with care": "warning", "do not use": "negative"}
_SCENE_MAGNIFICATION = 100
_ZOOMED = "(event) => { const one = (event.batch ?? [event])[0]; emit(one.start, one.end); }"
_SHORT = {":formatter": "(value) => String(Math.round(1000 * value) / 1000)"}
"""Labels of an axis: where a recording begins and ends is no round number."""
_REST_S = 0.3
"""How long the wheel rests before what is zoomed into is drawn anew [s]."""
_ABOVE, _FROM = np.array([0.0, 0.0, 0.1]), np.array([0.0, -1.6, 0.6])


def show_review(page: PageState) -> None:
    """Builds the step.

    Parameters
    ----------
    page
        What the steps share.
    """
    area = ui.column().classes("w-full")

    async def refresh() -> None:
        area.clear()
        with area:
            if not (page.project.run / "displacement.nc").exists():
                ui.label("Nothing measured yet.")
                return
            try:
                results = await in_thread(Results, page.project.run)
            except VfmSdmError as error:
                ui.label(str(error)).classes("text-negative")
                return
            _Review(page, results).build()

    ui.button("Read again", icon="refresh", on_click=tell_errors(refresh)).props("flat dense")
    ui.timer(0, tell_errors(refresh), once=True)


class _Review:
    """The widgets of a finished run."""

    def __init__(self, page: PageState, results: Results) -> None:
        self._page, self._results = page, results
        self._shown = results.points[:_MOST_AT_ONCE]
        self._axis = "vertical" if "vertical" in results.axes else results.axes[0]
        self._between_s: tuple[float, float] | None = None

    def build(self) -> None:
        """Verdict, histories, spectra, film, scene, audit, budget and report, from above."""
        summary = self._results.summary
        audit = summary.get("audit") or {}
        verdict = str(audit.get("verdict", "no verdict"))
        with ui.row().classes("items-center"):
            ui.label(verdict).classes(f"text-h6 text-{_VERDICTS.get(verdict, 'grey')}")
            ui.label(f"{summary.get('name', '')}; cameras: {summary.get('status', '')}")
            language = ui.select({"en": "English", "de": "Deutsch"}, value="en").props("dense")

            async def report() -> None:
                path, *_ = await in_thread(partial(write_report, self._page.project.run, language=str(language.value)))
                ui.notify(f"written: {path}", type="positive")
                link.set_visibility(True)

            write = ui.button("Write report", icon="description")
            write.on_click(while_busy(write, report))
            link = ui.link("open the report", "/report", new_tab=True)
            link.set_visibility((self._page.project.run / "report.html").exists())
        for note in self._results.doubts(self._page.draft.session()[0]):
            ui.label(note).classes("text-negative text-bold")
        self._choices()
        self._history = ui.echart(self._history_options()).classes("w-full h-80")
        zoomed = tell_errors(self._zoom)
        self._history.on("chart:datazoom", zoomed, js_handler=_ZOOMED, throttle=_REST_S, leading_events=False)
        self._spectrum = ui.echart(self._spectrum_options()).classes("w-full h-64")
        with ui.expansion("Audit: what was checked, and what to do", value=True).classes("w-full"):
            self._audit(audit.get("checks", []))
        with ui.expansion("Budget: where the uncertainty comes from (mm; expanded: k = 2, its parts: k = 1)").classes(
            "w-full"
        ):
            self._budget()
        with ui.expansion("Tracks over the film").classes("w-full"):
            for number, view in enumerate(self._results.session.view):
                self._film(str(view.name), f"film-{number}")
        with ui.expansion("Scene: cameras, points and magnified motion").classes("w-full") as scene:
            holder = ui.column().classes("w-full")

        async def open_scene(event: Any) -> None:
            if event.value and not list(holder):
                with holder:
                    self._scene()

        scene.on_value_change(tell_errors(open_scene))

    def _choices(self) -> None:
        with ui.row().classes("items-center"):
            axis = ui.toggle(self._results.axes, value=self._axis).props("dense no-caps")
            axis.on_value_change(tell_errors(self._choose_axis))
            for name in self._results.points:
                box = ui.checkbox(name, value=name in self._shown)
                box.on_value_change(tell_errors(partial(self._switch, name)))

    async def _choose_axis(self, event: Any) -> None:
        self._axis = str(event.value)
        await self._draw()

    async def _switch(self, name: str, event: Any) -> None:
        """Switches a point on or off."""
        kept = {*self._shown, name} if event.value else {*self._shown} - {name}
        self._shown = [one for one in self._results.points if one in kept]
        await self._draw()

    async def _zoom(self, event: Any) -> None:
        """Draws what is zoomed into from all its samples, once the wheel rests."""
        begin_s, end_s = self._results.span_s
        first, last = (begin_s + float(share) / 100 * (end_s - begin_s) for share in event.args)
        self._between_s = None if (first, last) == (begin_s, end_s) else (first, last)
        options = self._history_options()
        self._history.options.update({name: options[name] for name in ("series", "dataZoom")})
        self._history.update()

    async def _draw(self) -> None:
        for chart, options in ((self._history, self._history_options()), (self._spectrum, self._spectrum_options())):
            chart.options.clear()
            chart.options.update(options)
            chart.update()

    def _history_options(self) -> dict[str, Any]:
        """A line a point, with its band of expanded uncertainty; wheel and slider zoom."""
        series: list[dict[str, Any]] = []
        begin_s, end_s = self._results.span_s
        low_s, high_s = self._between_s or (begin_s, end_s)
        for colour, point in zip(cycle(_COLOURS), self._shown, strict=False):
            found = self._results.history(point, self._axis, self._between_s)
            common = {"type": "line", "showSymbol": False, "silent": True, "lineStyle": {"opacity": 0}}
            low = _pairs(found.band_s, found.below)
            high = _pairs(found.band_s, found.above - found.below)
            band = {**common, "stack": f"band {point}", "name": f"{point} band", "tooltip": {"show": False}}
            # A band is stacked on its lower limit, also where that is negative.
            band["stackStrategy"] = "all"
            series += [{**band, "data": low}, {**band, "data": high, "areaStyle": {"color": colour, "opacity": 0.2}}]
            line = {"type": "line", "name": point, "showSymbol": False, "data": _pairs(found.time_s, found.values)}
            series.append({**line, "lineStyle": {"color": colour, "width": 1.2}, "itemStyle": {"color": colour}})
        return {
            "animation": False,
            "title": _title(f"{self._axis} displacement{self._results.positive(self._axis)}; band: k = 2"),
            "legend": {"top": 30, "data": list(self._shown)},
            "grid": {"left": 64, "right": 24, "top": 66, "bottom": 70},
            "tooltip": {"trigger": "axis", "axisPointer": {"type": "cross"}},
            "xAxis": {"type": "value", "name": "s", "min": begin_s, "max": end_s, "axisLabel": _SHORT},
            "yAxis": {"type": "value", "name": "mm", "scale": True},
            "dataZoom": [{"type": kind, "startValue": low_s, "endValue": high_s} for kind in ("inside", "slider")],
            "series": series,
        }

    def _spectrum_options(self) -> dict[str, Any]:
        series = []
        for colour, point in zip(cycle(_COLOURS), self._shown, strict=False):
            data = _pairs(*self._results.spectrum(point, self._axis))
            line = {"type": "line", "name": point, "showSymbol": False, "data": data}
            series.append({**line, "lineStyle": {"color": colour, "width": 1}, "itemStyle": {"color": colour}})
        return {
            "animation": False,
            "title": _title(f"{self._axis} amplitude"),
            "grid": {"left": 64, "right": 24, "top": 36, "bottom": 70},
            "tooltip": {"trigger": "axis", "axisPointer": {"type": "cross"}},
            "xAxis": {"type": "value", "name": "Hz", "min": 0},
            "yAxis": {"type": "value", "name": "mm"},
            "dataZoom": [{"type": "inside"}, {"type": "slider"}],
            "series": series,
        }

    def _audit(self, checks: list[dict[str, Any]]) -> None:
        icons = {"pass": ("check_circle", "positive"), "caution": ("warning", "warning"), "fail": ("error", "negative")}
        for check in checks:
            icon, colour = icons.get(str(check["outcome"]), ("help", "grey"))
            with ui.row().classes("no-wrap items-start gap-2"):
                ui.icon(icon, color=colour)
                ui.label(f"{check['name']}: {check['sentence']}").classes("text-body2")

    def _budget(self) -> None:
        rows = self._results.budget()
        names = [key for key in (rows[0] if rows else {}) if key != "id"]
        columns = [
            {"name": key, "label": key.replace("_", " "), "field": key, "sortable": True,
             "align": "left" if key in ("point", "axis") else "right"}
            for key in names
        ]  # fmt: skip
        ui.table(columns=columns, rows=rows, row_key="id", pagination=15).props("dense flat").classes("w-full")

    def _film(self, view: str, box_id: str) -> None:
        """A view that plays with its points, and vectors of their motion."""
        address = picture_address(self._page, view, None)
        with ui.column().classes("w-full gap-1"):
            with ui.row().classes("items-center"):
                ui.label(view).classes("text-bold")
                play = ui.button(icon="play_arrow").props("dense flat")
                stop = ui.button(icon="pause").props("dense flat")
                play.props["aria-label"], stop.props["aria-label"] = f"play {view}", f"pause {view}"
                times = ui.number("motion times", value=20, min=1, max=1000).props("dense").classes("w-28")
            still = f'<img src="{picture_address(self._page, view)}" alt="film"><canvas></canvas>'
            ui.html(still, sanitize=False).classes("vs-film w-full").props(f'id="{box_id}"')

            async def begin() -> None:
                tracks = await in_thread(self._results.film, view)
                ui.run_javascript(f"vsFilm({box_id!r}, {address!r}, {dumps(tracks)}, {float(times.value or 1)})")
                ui.run_javascript(f"vsPlay({box_id!r}, true)")

            play.on_click(tell_errors(begin))
            stop.on_click(lambda: ui.run_javascript(f"vsPlay({box_id!r}, false)"))
            times.on_value_change(lambda e: ui.run_javascript(f"vsTimes({box_id!r}, {float(e.value or 1)})"))

    def _scene(self) -> None:
        """Cameras, points and their magnified motion along the structure's axes."""
        found = self._results.scene()
        # Shown as one stands before it: to the right, away, up.
        turn = stand_before(found["axes"])
        places = np.nan_to_num(found["places"]) @ turn.T
        middle = places.mean(axis=0)
        reach = float(np.abs(places - middle).max(initial=1.0))
        moving = []
        with ui.scene(width=900, height=480, grid=False).classes("w-full") as scene:
            for name, center, look in zip(found["names"], found["cameras"], found["looks"], strict=True):
                at = turn @ np.array(center)
                tip = at + turn @ np.array(look) * reach
                scene.box(0.2, 0.2, 0.2).move(*at.tolist()).material("#1565c0")
                scene.line(at.tolist(), tip.tolist()).material("#90caf9")
                scene.text(name).move(*at.tolist())
            for name, place in zip(found["points"], places, strict=True):
                moving.append(scene.sphere(0.02 * reach + 0.03).move(*place.tolist()).material("#e65100"))
                scene.text(name).move(*(place + _ABOVE).tolist())
            for axis, colour in ((0, "#c62828"), (1, "#2e7d32"), (2, "#1565c0")):
                end = middle + 0.4 * reach * turn[:, axis]
                scene.line(middle.tolist(), end.tolist()).material(colour)
                scene.text(f"+ {found['axes'][axis]}").move(*end.tolist())
            scene.move_camera(*(middle + reach * _FROM).tolist(), *middle.tolist())
        frame = {"at": 0}
        motion = found["motion"] / 1e3 * _SCENE_MAGNIFICATION @ turn.T
        ui.label(f"motion {_SCENE_MAGNIFICATION} times").classes("text-caption")

        def step() -> None:
            frame["at"] = (frame["at"] + 1) % max(len(motion), 1)
            for one, place, moved in zip(moving, places, motion[frame["at"]], strict=True):
                one.move(*(place + moved).tolist())

        timer = ui.timer(0.1, step, active=False)
        ui.switch("animate").on_value_change(lambda e: setattr(timer, "active", bool(e.value)))


def _title(text: str) -> dict[str, Any]:
    return {"text": text, "textStyle": {"fontSize": 13}}


def _pairs(x: Any, y: Any) -> list[list[float | None]]:
    """Places of a line as a chart takes them, with gaps where nothing is known."""
    return [[round(float(a), 5), round(float(b), 5) if np.isfinite(b) else None] for a, b in zip(x, y, strict=True)]
