"""Step 1: which films are the views, what they are worth, and which interval of them is used."""

from functools import partial
from typing import Any

from nicegui import ui

from vfm_sdm.page.folder import Film
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import in_thread, picture_address, tell_errors

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
        "Choose the recording of each camera. The **first view is the reference**: its clock and its camera count. "
        "Files must lie in this folder."
    )
    listed = ui.column().classes("w-full")
    scrubbed = ui.row().classes("w-full no-wrap items-start")

    async def refresh() -> None:
        films = await in_thread(page.project.films)
        listed.clear()
        with listed:
            _list_films(page, films, changed)
        await preview()

    async def preview() -> None:
        scrubbed.clear()
        views = page.fields.get("view", ())
        if not views:
            return
        pictures = await in_thread(page.pictures)
        with scrubbed:
            for view in views:
                name = view["name"]
                _scrub(page, view, pictures.lengths[name])

    changed = tell_errors(preview)
    ui.button("Look again", icon="refresh", on_click=tell_errors(refresh)).props("flat dense")
    ui.timer(0, tell_errors(refresh), once=True)


def _list_films(page: PageState, films: list[Film], changed: Any) -> None:
    """A table of the recordings, with a choice of the view each is."""
    if not films:
        ui.label(f"No film in {page.project.folder}: copy the recordings there and look again.").classes(
            "text-negative"
        )
        return
    chosen = {_first(view.get("video")): view["name"] for view in page.fields.get("view", ())}
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
            choice.on_value_change(tell_errors(partial(_choose, page, film, changed)))
            for warning in film.warnings:
                ui.label(warning).classes("col-span-7 text-warning text-caption")


async def _choose(page: PageState, film: Film, changed: Any, event: Any) -> None:
    """Makes a recording a view, or none."""
    views = [dict(view) for view in page.fields.get("view", ())]
    kept = [view for view in views if _first(view.get("video")) != film.files[0] and view["name"] != event.value]
    if event.value != _NONE:
        before = next((view for view in views if view["name"] == event.value), {})
        kept.append({**before, "name": event.value, "video": film.video})
    order = {name: number for number, name in enumerate(_VIEWS)}
    kept.sort(key=lambda view: order.get(view["name"], len(order)))
    page.draft.set_rows("view", [{"name": view["name"], "video": view.get("video")} for view in kept])
    await changed()


def _scrub(page: PageState, view: dict[str, Any], frames: int) -> None:
    """A picture of a view that a slider moves through, and the interval that is used."""
    name = view["name"]
    with ui.column().classes("w-1/2 gap-1"):
        ui.label(name).classes("text-bold")
        picture = ui.image(picture_address(name)).classes("w-full")
        number = ui.label("frame 0")

        def show(event: Any) -> None:
            picture.set_source(picture_address(name, int(event.value)))
            number.set_text(f"frame {int(event.value)}")

        slider = ui.slider(min=0, max=max(frames - 1, 1), value=0).props("label")
        slider.on_value_change(show)
        used = view.get("use_s") or []
        with ui.row().classes("items-center"):
            begin = ui.number("use from [s]", value=used[0] if used else None, min=0).props("dense clearable")
            end = ui.number("to [s]", value=used[1] if len(used) > 1 else None, min=0).props("dense clearable")

            async def keep() -> None:
                interval = None if begin.value is None and end.value is None else [float(begin.value or 0.0)]
                if interval is not None and end.value is not None:
                    interval.append(float(end.value))
                page.draft.put(("view", name, "use_s"), interval)

            for one in (begin, end):
                one.on("blur", tell_errors(keep))


def _first(video: object) -> str:
    """The first file that a session names for a view."""
    if isinstance(video, list):
        return str(video[0]) if video else ""
    return "" if video is None else str(video)
