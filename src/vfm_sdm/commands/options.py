"""Options of commands that belong together; on the command line each is an option of its own."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from vfm_sdm.core.executors import ProcessWorkers, cluster_workers
from vfm_sdm.errors import DatasetError, SessionError

__all__ = ["WorkerOptions", "name_values"]


@Parameter(name="*")
@dataclass(frozen=True)
class WorkerOptions:
    """Options of who works: on the segments of recordings, or, in a batch, on whole sessions."""

    workers: Annotated[
        int, Parameter(help="Processes of this machine for segments of recordings, or sessions; 0 is this one.")
    ] = 0
    scheduler: Annotated[
        str | None, Parameter(help="Address of a Dask scheduler whose workers do it, such as tcp://10.0.0.1:8786.")
    ] = None

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """Who works, for the time of the block; ``None`` is this process.

        Raises
        ------
        SessionError
            The number of processes is negative, or both are given.
        BackendUnavailableError
            Dask is not installed, or there is no scheduler.
        """
        if self.workers < 0 or (self.workers and self.scheduler):
            raise SessionError(
                f"--workers: expected a number of processes, or --scheduler alone, got {self.workers} and "
                f"{self.scheduler}; leave one out"
            )
        if self.scheduler:
            with cluster_workers(self.scheduler) as executor:
                yield executor
        elif self.workers:
            with ProcessWorkers(self.workers) as executor:
                yield executor
        else:
            yield None


def name_values(words: Sequence[str], option: str) -> dict[str, str]:
    """Name and value of every ``name=value``.

    Parameters
    ----------
    words
        What stands behind the option, each time.
    option
        The option, for messages.

    Raises
    ------
    DatasetError
        Something else than ``name=value`` stands there, or a name twice.

    Examples
    --------
    >>> name_values(["left=rtsp://camera/1"], "--source")
    {'left': 'rtsp://camera/1'}
    """
    named: dict[str, str] = {}
    for word in words:
        name, found, value = word.partition("=")
        if not (name and found and value) or name in named:
            raise DatasetError(f"{option}: expected name=value, each name once, got {word!r}; correct it")
        named[name] = value
    return named
