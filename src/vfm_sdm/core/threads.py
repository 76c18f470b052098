"""Number of threads of the linear algebra."""

from contextlib import AbstractContextManager
from functools import cache
from typing import cast

from threadpoolctl import ThreadpoolController

__all__ = ["small_algebra"]


def small_algebra() -> AbstractContextManager[object]:
    """Context in which each call of BLAS or LAPACK keeps to one thread.

    Notes
    -----
    Matrices here are small: hundreds of rows, dozens of columns. Threads that wait for each other cost more than they
    save: a singular value decomposition of 440 x 26 took 0.2 ms with one thread and up to 77 ms with two beside other
    work on two cores.

    Examples
    --------
    >>> with small_algebra():
    ...     pass
    """
    return cast(AbstractContextManager[object], _find_libraries().limit(limits=1, user_api="blas"))


@cache
def _find_libraries() -> ThreadpoolController:
    return ThreadpoolController()
