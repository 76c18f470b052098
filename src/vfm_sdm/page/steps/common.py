"""What the steps share: errors told to who clicked, and work that keeps the page alive."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast
from urllib.parse import quote

from nicegui import context, run, ui

from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Point
from vfm_sdm.page.state import PageState

__all__ = ["as_point", "in_thread", "picture_address", "tell_errors", "value_at", "while_busy"]

P = ParamSpec("P")
R = TypeVar("R")


def tell_errors(handler: Callable[P, Awaitable[None]]) -> Callable[P, Awaitable[None]]:
    """A handler whose errors of use are told on the page, in their own words.

    Parameters
    ----------
    handler
        Handles an event.
    """

    @wraps(handler)
    async def told(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            await handler(*args, **kwargs)
        except _LeftError:
            pass
        except VfmSdmError as error:
            _warn(str(error))
        except Exception as error:
            words = f"an error of the page itself: {type(error).__name__}: {error}; the terminal says where"
            _warn(words)
            raise

    return told


def _warn(words: str) -> None:
    # Where nothing to click in lies below: it stays until it is read.
    ui.notify(words, type="negative", multi_line=True, close_button="close", timeout=0, position="top-right")


def while_busy(button: ui.button, handler: Callable[[], Awaitable[None]]) -> Callable[[], Awaitable[None]]:
    """A handler during which the button that began it shows that work is done, and takes no second click.

    Parameters
    ----------
    button
        The button.
    handler
        Handles its clicks.
    """

    async def shown() -> None:
        button.props("loading")
        try:
            await handler()
        finally:
            if not button.is_deleted:
                button.props(remove="loading")

    return tell_errors(shown)


class _LeftError(Exception):
    """The step was left while something for it was computed: nothing is to be shown any more."""


async def in_thread(function: Callable[..., R], *args: Any) -> R:
    """What a function returns that would keep the page waiting; its errors come out here.

    Parameters
    ----------
    function
        The function.
    *args
        Its arguments.
    """
    parent = context.slot.parent
    found = cast("R", await run.io_bound(function, *args))
    if parent.is_deleted:
        raise _LeftError
    return found


def as_point(row: Mapping[str, Any]) -> Point:
    """A point's table as a point of the first frames.

    Parameters
    ----------
    row
        Its table in the session.
    """
    return Point(**{key: row[key] for key in ("name", "view", "pixel", "pixel_in", "static") if key in row})


def picture_address(page: PageState, view: str, number: int | None = 0, *, whole: bool = False) -> str:
    """Where the page serves a frame of a view; for ``None``, of any, whose number takes the place of ``{}``.

    It changes with the session, so that a browser shows no picture of another film that it still has.

    Parameters
    ----------
    page
        What the steps share.
    view, number
        The view, and the number of its frame, in the part of the recording that is used.
    whole
        Whether it is counted in the whole recording instead.
    """
    frame = "{}" if number is None else number
    return f"/picture/{quote(view, safe='')}/{frame}?version={page.version}" + ("&whole=1" if whole else "")


def value_at(fields: Any, path: Sequence[str]) -> Any:
    """What stands under a path of names in plain tables; nothing where there is none.

    Parameters
    ----------
    fields
        The tables.
    path
        Names of tables, and of rows in lists of tables.

    Examples
    --------
    >>> value_at({"view": [{"name": "left", "lens": {"focal_mm": 4.2}}]}, ("view", "left", "lens", "focal_mm"))
    4.2
    """
    for step in path:
        if isinstance(fields, list):
            fields = next((one for one in fields if one.get("name") == step), {})
        else:
            fields = (fields or {}).get(step)
    return fields
