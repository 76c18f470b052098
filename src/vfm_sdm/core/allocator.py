"""Memory that the C library holds back once it was used."""

import ctypes
import gc
import sys
from collections.abc import Callable
from functools import cache

__all__ = ["return_free_memory"]


def return_free_memory() -> None:
    """Gives the system back what was used and is free, so that arrays of passing sizes do not add up over a recording.

    Notes
    -----
    What holds itself in a circle, as measurements of intervals and figures do, goes first. The GNU C library keeps free
    blocks between others that are in use: an hour of film took 130 MB more than ten minutes by both. Other C libraries
    do without being told.

    Examples
    --------
    >>> return_free_memory()
    """
    gc.collect()
    trim = _find_trim()
    if trim is not None:
        trim(0)


@cache
def _find_trim() -> Callable[[int], int] | None:
    if sys.platform != "linux":
        return None
    trim: Callable[[int], int] | None = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return trim
