"""Independent tasks on any executor: processes of this machine, a cluster, or this process itself."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from vfm_sdm.errors import BackendUnavailableError

__all__ = ["ProcessWorkers", "ThreadWorkers", "cluster_workers", "run_tasks"]

T = TypeVar("T")
R = TypeVar("R")

_ATTEMPTS = 3
_PATIENCE_S = 10
_GONE = (
    "workers: expected them to be there to the end, got none any more; start them and run again: what is done is kept"
)
_MANY = 32
"""Tasks that are handed out at once to an executor that does not say how many workers it has."""


class ProcessWorkers(Executor):
    """Processes of this machine; where one is lost, all are begun anew.

    Parameters
    ----------
    workers
        Number of processes.

    Attributes
    ----------
    workers
        Number of processes.

    Notes
    -----
    They are begun afresh, not forked: a copy of a process with threads may stop for ever. They end with this process,
    however that ends, and at once where an error leaves the ``with`` block: nobody waits for their work.

    Examples
    --------
    >>> with ProcessWorkers(1) as workers:
    ...     workers.submit(abs, -2).result()
    2
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._context = multiprocessing.get_context("spawn")
        self._heard, self._line = self._context.Pipe(duplex=False)
        self._pool = self._begin()

    def __exit__(self, kind: type[BaseException] | None, *rest: Any) -> None:
        """See `concurrent.futures.Executor`."""
        if kind is not None:
            self._line.close()
        self.shutdown()

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> "Future[R]":
        """See `concurrent.futures.Executor.submit`."""
        try:
            return self._pool.submit(fn, *args, **kwargs)
        except BrokenExecutor:
            self._pool.shutdown(wait=False)
            self._pool = self._begin()
            return self._pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `concurrent.futures.Executor.shutdown`."""
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)

    def _begin(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.workers, self._context, _stay_with_parent, (self._heard,))


class ThreadWorkers(ThreadPoolExecutor):
    """Threads of this process, which say how many they are.

    Parameters
    ----------
    workers
        Number of threads.

    Examples
    --------
    >>> with ThreadWorkers(2) as threads:
    ...     threads.workers, threads.submit(abs, -2).result()
    (2, 2)
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self.workers = workers


@contextmanager
def cluster_workers(address: str) -> Iterator[Executor]:
    """Workers of a running Dask cluster, for the time of the block.

    Parameters
    ----------
    address
        Of its scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    BackendUnavailableError
        Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client  # noqa: PLC0415  (an extra)
    except ImportError as error:
        raise BackendUnavailableError(
            "scheduler: expected dask.distributed, got no such package; install vfm-sdm[cluster]"
        ) from error
    try:
        client = Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BackendUnavailableError(
            f"scheduler: expected a Dask scheduler at {address}, got {str(error) or type(error).__name__}; start one "
            "with `dask scheduler`, and workers with `dask worker`"
        ) from error
    # Not pure: else a task that is tried again would be taken for the one that failed.
    with client:
        executor = client.get_executor(pure=False)
        # Futures of a client that lost its scheduler for good never end, and are not waited for at the end either.
        executor.is_lost = lambda: client.status == "closed"
        yield executor


def _stay_with_parent(line: Connection) -> None:
    """Leaves interruptions to the parent, and ends when that closes the line, or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(line,), daemon=True).start()


def _end_after(line: Connection) -> None:
    with suppress(EOFError, OSError):
        line.recv_bytes()
    os._exit(1)


def run_tasks(
    function: Callable[[T], R], tasks: Sequence[T], executor: Executor | None, done: Callable[[int, R], None]
) -> dict[int, Exception]:
    """Runs a function on tasks that do not depend on each other; the errors of those that failed, by number.

    Parameters
    ----------
    function
        What is done with a task; for processes, a function of a module.
    tasks
        The tasks.
    executor
        Who works; ``None`` is this process, one task after the other.
    done
        Called in this process with the number of each task that is done, and with its result, in any order.

    Raises
    ------
    BackendUnavailableError
        The executor has a method ``is_lost``, and it says so.

    Notes
    -----
    A task that fails with an executor is tried three times. Where a lost process takes all tasks with it that were in
    work, these are then run one by one, so that only that one counts as failed which loses its process again.

    Examples
    --------
    >>> found = {}
    >>> run_tasks(lambda task: 6 // task, [1, 0, 3], None, found.__setitem__)
    {1: ZeroDivisionError('integer division or modulo by zero')}
    >>> found
    {0: 6, 2: 2}
    """
    if executor is None:
        return _run_here(function, tasks, done)
    failed: dict[int, Exception] = {}
    attempts = dict.fromkeys(range(len(tasks)), 0)
    waiting, suspects = deque(range(len(tasks))), deque[int]()
    at_once = 2 * getattr(executor, "workers", _MANY)
    working: dict[Future[R], int] = {}
    try:
        while waiting or suspects or working:
            while not suspects and waiting and len(working) < at_once:
                number = waiting.popleft()
                working[_hand_out(executor, function, tasks[number])] = number
            if suspects and not working:
                number = suspects.popleft()
                working[_hand_out(executor, function, tasks[number])] = number
            alone = len(working) == 1
            ended = wait(working, timeout=_PATIENCE_S, return_when=FIRST_COMPLETED).done
            if not ended and getattr(executor, "is_lost", bool)():
                working.clear()
                raise BackendUnavailableError(_GONE)
            while ended:
                future = ended.pop()  # which holds the result
                number, error = working.pop(future), _error_of(future)
                if error is None:
                    done(number, future.result())
                    continue
                if not isinstance(error, Exception):
                    raise error
                lost = isinstance(error, BrokenExecutor)
                attempts[number] += not lost or alone
                if attempts[number] == _ATTEMPTS:
                    failed[number] = error
                else:
                    (suspects if lost else waiting).append(number)
    finally:
        for future in working:
            future.cancel()
    return failed


def _hand_out(executor: Executor, function: Callable[[T], R], task: T) -> "Future[R]":
    try:
        return executor.submit(function, task)
    except Exception as error:  # of any kind, as of a cluster that gave up its scheduler
        raise BackendUnavailableError(_GONE) from error


def _error_of(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:  # by the executor, as where a cluster lost its scheduler
        return error


def _run_here(function: Callable[[T], R], tasks: Sequence[T], done: Callable[[int, R], None]) -> dict[int, Exception]:
    failed: dict[int, Exception] = {}
    for number, task in enumerate(tasks):
        try:
            result = function(task)
        except Exception as error:  # noqa: BLE001  (named by the caller, as those of other processes)
            failed[number] = error
        else:
            done(number, result)
    return failed
