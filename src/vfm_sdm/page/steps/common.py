"""What the steps share: errors told to who clicked, and work that keeps the page alive."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast
from urllib.parse import quote

from nicegui import context, run, ui

from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Point

__all__ = ["as_point", "in_thread", "picture_address", "tell_errors", "value_at"]

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
            ui.notify(str(error), type="negative", multi_line=True, close_button="close", timeout=0)
        except Exception as error:
            words = f"an error of the page itself: {type(error).__name__}: {error}; the terminal says where"
            ui.notify(words, type="negative", multi_line=True, close_button="close", timeout=0)
            raise

    return told


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


def picture_address(view: str, number: int | None = 0) -> str:
    """Where the page serves a frame of a view; of all its frames for ``None``.

    Parameters
    ----------
    view, number
        The view, and the number of its frame.

    Examples
    --------
    >>> picture_address('north "A"', 3)
    '/picture/north%20%22A%22/3'
    """
    return f"/picture/{quote(view, safe='')}" + ("" if number is None else f"/{number}")


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
