"""Calls in processes of their own: one that dies takes no other along."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import ParamSpec, TypeVar

__all__ = ["OneProcessEach"]

P = ParamSpec("P")
T = TypeVar("T")


class OneProcessEach(ThreadPoolExecutor):
    """An executor that makes a new process for every call, so many at a time.

    A process that is killed, or that a decoder brings down, breaks a pool for all calls; here it breaks its own alone.
    All memory is given back between calls. Where the process that called ends, however it ends, so do these.

    Parameters
    ----------
    max_workers
        Processes at a time.
    """

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """A call that is to be made in a new process; function, arguments and result must be picklable."""
        return super().submit(_call_in_process, partial(fn, *args, **kwargs))


def _call_in_process(call: Callable[[], T]) -> T:
    # New processes, not copies of this one, whose threads and compiled code a copy would lack.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_end_with_parent) as pool:
        return pool.submit(call).result()


def _end_with_parent() -> None:
    Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
