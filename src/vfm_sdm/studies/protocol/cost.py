"""Cost of a stage: its time, and the process's peak memory while it runs."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Cost", "measure_cost"]

_STATM = Path("/proc/self/statm")
_PAGE_BYTES = 4096
_INTERVAL_S = 0.02


@dataclass
class Cost:
    """Cost of one stage.

    Parameters
    ----------
    task
        Name of the stage.
    input_size
        Size of its input in words, such as ``480 frames, 3 points``.
    calls
        Number of calls.
    seconds
        Time of all calls [s].
    peak_memory_mb
        Largest resident memory of the process meanwhile [MB]; NaN where the system does not tell it.
    """

    task: str
    input_size: str
    calls: int = 1
    seconds: float = float("nan")
    peak_memory_mb: float = float("nan")


@contextmanager
def measure_cost(task: str, input_size: str, *, calls: int = 1) -> Iterator[Cost]:
    """Measures the time [s] and peak memory [MB] of a block; the cost is complete when the block ends.

    Parameters
    ----------
    task, input_size, calls
        See `Cost`.

    Examples
    --------
    >>> with measure_cost("sum", "1000 numbers") as cost:
    ...     _ = sum(range(1000))
    >>> cost.task, 0 <= cost.seconds < 60
    ('sum', True)
    """
    cost, stop = Cost(task, input_size, calls), threading.Event()
    peaks = [_resident_bytes()]

    def watch() -> None:
        while not stop.wait(_INTERVAL_S):
            peaks.append(max(peaks.pop(), _resident_bytes()))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    start = time.perf_counter()
    try:
        yield cost
    finally:
        cost.seconds = time.perf_counter() - start
        stop.set()
        watcher.join()
        cost.peak_memory_mb = max(peaks[0], _resident_bytes()) / 1e6


def _resident_bytes() -> float:
    try:
        return float(_STATM.read_text().split()[1]) * _PAGE_BYTES
    except OSError:
        return float("nan")
