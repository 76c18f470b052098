"""Many simulated measurements at a time, one process a processor."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

import pytest

__all__ = ["in_processes"]

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def in_processes(function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """The function of every item, in order; both must be picklable.

    New processes, not copies of this one, whose compiled code may hold threads; one thread each for small matrices.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        patch.setenv("NUMBA_NUM_THREADS", "1")
        with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
            return list(pool.map(function, items, chunksize=4))
