"""The command ``page``: films to report in a browser."""

from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vfm_sdm.commands.terminal import say
from vfm_sdm.errors import BackendUnavailableError

__all__ = ["page_command"]


def page_command(
    folder: Annotated[Path, Parameter(help="Folder with the films; the session and its run are kept there.")] = Path(),
    *,
    port: Annotated[int | None, Parameter(help="Port on this machine; a free one when left out.")] = None,
    browser: Annotated[bool, Parameter(negative="--no-browser", help="Open a browser.")] = True,
) -> None:
    """Go from films to a report in a browser, on this machine alone; Ctrl-C ends it."""
    try:
        from vfm_sdm.page.folder import Project  # noqa: PLC0415  (an extra)
        from vfm_sdm.page.state import PageState  # noqa: PLC0415

        page = PageState(Project(folder))
        page.begin()
        from vfm_sdm.page.server import serve  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise BackendUnavailableError(
            f'page: expected the extra "page", got no {error.name}; pip install "vfm-sdm[page]"'
        ) from error

    def tell(address: str) -> None:
        say(f"page: {address}\nCtrl-C ends it.")

    with suppress(KeyboardInterrupt):  # which is how it is meant to end
        serve(page, port=port, browser=browser, tell=tell)
