"""The page's server: on this machine alone, for who knows its address."""

import asyncio
import os
import secrets
import socket
import webbrowser
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from fastapi import Response
from fastapi.responses import FileResponse
from nicegui import app, background_tasks, run, ui

from vfm_sdm.errors import SessionError, VfmSdmError
from vfm_sdm.page.guard import Guard
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import tell_errors

__all__ = ["serve"]

_HOST = "127.0.0.1"
_STEPS = ("Films", "Points", "Site", "Measure", "Review")
"""Each is ``show_NAME`` of a module of its own, imported when it is wanted: the first needs little of all that."""
_STATIC = Path(__file__).parent / "static"
_MISSING = 404
_PATIENCE_S = 0.05


def serve(page: PageState, *, port: int | None = None, browser: bool = True, tell: Callable[[str], None]) -> None:
    """Serves the page until it is interrupted.

    Parameters
    ----------
    page
        State of the page, of the folder that it works in.
    port
        Where it listens; a free port when left out.
    browser
        Whether a browser is opened.
    tell
        Called with the page's address once it is there.

    Raises
    ------
    SessionError
        The port is taken.
    ResultsError
        Another page works in the folder.
    """
    chosen = _free_port(port)
    token = secrets.token_urlsafe(24)
    address = f"http://{_HOST}:{chosen}/?token={token}"
    _add_routes(page)
    app.add_middleware(Guard, token=token, port=chosen)

    async def announce() -> None:
        while not _listens(chosen):
            await asyncio.sleep(_PATIENCE_S)
        tell(address)
        if browser:
            webbrowser.open(address)
        await run.io_bound(page.wait)  # which everybody looks at first
        await run.io_bound(lambda: [_step(name) for name in _STEPS])

    # Startup ends before the port is open.
    app.on_startup(lambda: background_tasks.create(announce(), name="announce"))
    with page.project.opened():
        try:
            ui.run(
                lambda: build(page),
                host=_HOST,
                port=chosen,
                title=f"vfm-sdm: {page.project.folder.name}",
                show=False,
                reload=False,
                show_welcome_message=False,
                favicon="📐",
            )
        finally:
            if page.process is not None:
                page.process.stop()


def _listens(port: int) -> bool:
    """Whether the page's port is open."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((_HOST, port)) == 0


def _free_port(port: int | None) -> int:
    with socket.socket() as probe:
        if os.name != "nt":  # there it would take the port of another program
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port or 0))
        except OSError as error:
            raise SessionError(f"port {port}: expected a free one, got: {error.strerror}; leave it out") from error
        return int(probe.getsockname()[1])


def build(page: PageState) -> None:
    """The five steps; each is built anew when it is opened, from the files."""
    ui.add_head_html('<link rel="stylesheet" href="/static/page.css"><script src="/static/page.js"></script>')
    with ui.row().classes("items-center"):
        ui.label(f"vfm-sdm · {page.project.folder.name}").classes("text-h6")
        back = ui.button("Undo", icon="undo").props("flat dense no-caps")
        with back:
            ui.tooltip("Takes back the last change of session.toml that was made on this page")
    with ui.tabs().props("no-caps align=left").classes("w-full") as tabs:
        for number, name in enumerate(_STEPS, start=1):
            ui.tab(name, label=f"{number} {name}")
    area = ui.column().classes("w-full")

    def show(name: str) -> None:
        area.clear()
        # A column of its own, by which what is still computed for a step sees that it was left.
        with area, ui.column().classes("w-full"):
            try:
                _step(name)(page)
            except VfmSdmError as error:
                ui.label(str(error)).classes("text-negative whitespace-pre-line")

    async def undo() -> None:
        page.draft.undo()
        show(str(tabs.value))

    back.on_click(tell_errors(undo))
    tabs.on_value_change(lambda event: show(str(event.value)))
    tabs.set_value(_STEPS[0])


def _step(name: str) -> Callable[[PageState], None]:
    """What builds a step."""
    name = name.lower()
    show: Callable[[PageState], None] = getattr(import_module(f"vfm_sdm.page.steps.{name}"), f"show_{name}")
    return show


def _add_routes(page: PageState) -> None:
    app.add_static_files("/static", _STATIC)

    @app.get("/picture/{view}/{number}")
    async def picture(view: str, number: int, *, whole: bool = False) -> Response:
        """A frame of a view as JPEG."""
        try:
            content = await run.io_bound(lambda: page.pictures(whole=whole).picture(view, max(number, 0)))
        except VfmSdmError as error:
            return Response(str(error), status_code=_MISSING, media_type="text/plain")
        return Response(content, media_type="image/jpeg", headers={"cache-control": "private, max-age=60"})

    @app.get("/report")
    async def report() -> Response:
        """The report of the run."""
        path = page.project.run / "report.html"
        if not path.is_file():
            return Response("no report yet: write it in the review", status_code=_MISSING, media_type="text/plain")
        return FileResponse(path)
