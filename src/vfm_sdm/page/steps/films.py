"""Step 1: which films are the views, what they are worth, and which interval of them is used."""

from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from vfm_sdm.inputs.video import VideoInfo
from vfm_sdm.page.folder import Film
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import in_thread, picture_address, tell_errors, value_at

__all__ = ["show_films"]

_NONE = "not used"
_VIEWS = ("left", "right", "third", "fourth")


def show_films(page: PageState) -> None:
    """Builds the step.

    Parameters
    ----------
    page
        What the steps share.
    """
    ui.markdown(
        "Choose the recording of each camera. The **first view is the reference**: time is counted by its clock, and "
        "what is measured on site begins at its camera. Films lie in this folder; copy others there and look again."
    )
    listed = ui.column().classes("w-full")
    scrubbed = ui.row().classes("w-full no-wrap items-start")
    rested = ui.column().classes("w-full gap-1")

    async def refresh() -> None:
        films = await in_thread(page.project.films)
        listed.clear()
        with listed:
            _list_films(page, films, preview)
        await preview()

    async def preview() -> None:
        scrubbed.clear()
        rested.clear()
        views = page.fields.get("view", ())
        if not views:
            return
        pictures = await in_thread(partial(page.pictures, whole=True))
        with scrubbed:
            for number, view in enumerate(views):
                _scrub(page, number, view, pictures.recordings[view["name"]].info)
        with rested:
            _rest(page)

    ui.button("Look again", icon="refresh", on_click=tell_errors(refresh)).props("flat dense")
    ui.timer(0, tell_errors(refresh), once=True)


def _list_films(page: PageState, films: list[Film], changed: Any) -> None:
    """A table of the recordings, with a choice of the view each is."""
    if not films:
        ui.label(f"No film in {page.project.folder}: copy the recordings there and look again.").classes(
            "text-negative"
        )
        return
    choices: dict[str, ui.select] = {}

    def roles() -> dict[str, str]:
        return {_first(view.get("video")): str(view["name"]) for view in page.fields.get("view", ())}

    async def follow() -> None:
        """Shows which view each film is now."""
        chosen = roles()
        for file, choice in choices.items():
            choice.set_value(chosen.get(file, _NONE))
        await changed()

    chosen = roles()
    with ui.grid(columns="minmax(12em,2fr) repeat(5,auto) minmax(9em,1fr)").classes("w-full items-center gap-x-4"):
        for title in ("film", "size", "frames/s", "duration", "codec", "bits/pixel", "view"):
            ui.label(title).classes("text-bold")
        for film in films:
            info = film.info
            ui.label(", ".join(film.files)).classes("break-all")
            ui.label("-" if info is None else f"{info.width} x {info.height}")
            ui.label("-" if info is None else f"{info.fps:.3f}")
            ui.label("-" if info is None or info.duration_s is None else f"{info.duration_s:.1f} s")
            ui.label("-" if info is None else info.codec)
            ui.label(f"{film.bits_per_pixel:.3f}")
            choice = ui.select([_NONE, *_VIEWS], value=chosen.get(film.files[0], _NONE)).props("dense outlined")
            choice.props["aria-label"] = f"view of {film.files[0]}"
            choice.set_enabled(info is not None)
            choices[film.files[0]] = choice
            choice.on_value_change(tell_errors(partial(_choose, page, film, follow)))
            for warning in film.warnings:
                ui.label(warning).classes("col-span-7 text-warning text-caption")


async def _choose(page: PageState, film: Film, changed: Any, event: Any) -> None:
    """Makes a recording a view, or none; where another one was that view, they change places."""
    views = {str(view["name"]): view.get("video") for view in page.fields.get("view", ())}
    was = next((name for name, video in views.items() if _first(video) == film.files[0]), _NONE)
    if event.value == was:
        return
    other = views.pop(event.value, None)
    views.pop(was, None)
    if event.value != _NONE:
        views[event.value] = film.video
        if other is not None and was != _NONE:
            views[was] = other
    order = {name: number for number, name in enumerate(_VIEWS)}
    names = sorted(views, key=lambda name: order.get(name, len(order)))
    page.draft.set_rows("view", [{"name": name, "video": views[name]} for name in names])
    await changed()


def _scrub(page: PageState, number: int, view: dict[str, Any], info: VideoInfo) -> None:
    """A picture of a view that a slider moves through, the interval that is used, and when it begins."""
    name = str(view["name"])
    fps = info.fps if np.isfinite(info.fps) else 0.0
    with ui.column().classes("w-1/2 gap-1"):
        ui.label(name if number else f"{name}, the reference").classes("text-bold")
        picture = ui.image(picture_address(page, name, whole=True)).classes("w-full")
        place = ui.label("frame 0")

        def show(event: Any) -> None:
            frame = int(event.value)
            picture.set_source(picture_address(page, name, frame, whole=True))
            place.set_text(f"frame {frame}" + (f", {frame / fps:.2f} s" if fps else ""))

        slider = ui.slider(min=0, max=max((info.frame_count or 1) - 1, 1), value=0).props("label")
        slider.on_value_change(show)
        _interval(page, view, info.duration_s)
        if number:
            _offset(page, view)


def _interval(page: PageState, view: dict[str, Any], duration_s: float | None) -> None:
    """Which part of a recording is used; one that holds nothing is told, and not kept."""
    used = view.get("use_s") or []
    if not all(isinstance(one, int | float) for one in used):
        ui.label(f"used: {' to '.join(map(str, used))}, as session.toml states it")
        return
    with ui.row().classes("items-center"):
        begin = ui.number("use from [s]", value=used[0] if used else None, min=0).props("dense clearable")
        end = ui.number("to [s]", value=used[1] if len(used) > 1 else None, min=0).props("dense clearable")
    says = ui.label("").classes("text-negative")

    async def keep() -> None:
        first, last = float(begin.value or 0.0), None if end.value is None else float(end.value)
        ends = [one for one in (last, duration_s) if one is not None]
        wrong = bool(ends) and first >= min(ends)
        longer = last is not None and duration_s is not None and last > duration_s
        says.set_text(
            "not kept: expected an end after the begin, and a begin within the film" if wrong
            else f"the film ends at {duration_s:.1f} s" if longer
            else ""
        )  # fmt: skip
        if not wrong:
            interval = None if begin.value is None and last is None else [first] if last is None else [first, last]
            page.draft.put(("view", str(view["name"]), "use_s"), interval)

    for one in (begin, end):
        one.on_value_change(tell_errors(keep))


def _offset(page: PageState, view: dict[str, Any]) -> None:
    """When a view begins, where that is known: a short film's motion does not tell it."""
    later = ui.number("begins later than the reference by [s], if known", value=view.get("time_offset_s"))
    later.props("dense clearable").classes("w-80")
    with later:
        ui.tooltip(
            "Left empty, the motion tells it, which needs some seconds of it. 0: both were started by one signal."
        )

    async def keep() -> None:
        stated = None if later.value is None else float(later.value)
        page.draft.put(("view", str(view["name"]), "time_offset_s"), stated)

    later.on_value_change(tell_errors(keep))


def _rest(page: PageState) -> None:
    """When the structure rests, where that is known: displacement is relative to its mean there."""
    still = value_at(page.fields, ("method", "still_interval_s")) or (None, None)
    with ui.row().classes("items-center"):
        begin = ui.number("structure at rest from [s], if known", value=still[0], min=0).props("dense clearable")
        end = ui.number("at rest to [s]", value=still[1], min=0).props("dense clearable")
        begin.classes("w-72")
    with begin:
        ui.tooltip(
            "Counted from where the reference film is used from. Displacement is relative to the mean in that time; "
            "left empty, to the first frame."
        )
    says = ui.label("").classes("text-negative")

    async def keep() -> None:
        first, last = begin.value, end.value
        if first is None and last is None:
            says.set_text("")
            page.draft.put(("method", "still_interval_s"), None)
            return
        holds = last is not None and float(first or 0.0) < float(last)
        says.set_text("" if holds else "not kept: expected a begin, and an end after it")
        if holds:
            page.draft.put(("method", "still_interval_s"), [float(first or 0.0), float(last)])

    for one in (begin, end):
        one.on_value_change(tell_errors(keep))


def _first(video: object) -> str:
    """The first file that a session names for a view."""
    if isinstance(video, list):
        return str(video[0]) if video else ""
    return "" if video is None else str(video)
