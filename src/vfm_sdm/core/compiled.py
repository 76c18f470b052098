"""Compiled functions whose cache on disk notices a change in any file that they are made of."""

from collections.abc import Callable
from typing import TypeVar

from vfm_sdm.core.code import code_hash

__all__ = ["cached_by_code"]

_Function = TypeVar("_Function", bound=Callable[..., object])


def cached_by_code(function: _Function) -> _Function:
    """The function, under a qualified name that ends in a hash of its module and of all that this one imports.

    Parameters
    ----------
    function
        What is to be compiled. The decorator stands below that of numba.

    Notes
    -----
    numba keeps compiled functions under their qualified names, and makes them anew when the file of the function that
    Python calls has changed. Compiled helpers and constants of other files are part of the machine code, but their
    files are not watched: a change there alone would go on running the old code. Under another name it is compiled
    anew.
    """
    function.__qualname__ += f".{code_hash(frozenset({function.__module__}))[:16]}"
    return function
