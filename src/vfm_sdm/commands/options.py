"""Options of commands that belong together; on the command line each is an option of its own."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

from cyclopts import Parameter

from vfm_sdm.analysis.evaluation import ReferenceClock
from vfm_sdm.core.executors import ProcessWorkers, cluster_workers
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings
from vfm_sdm.inputs.sensors.outliers import HampelUse

__all__ = ["ClockOptions", "RecipeOptions", "WorkerOptions"]


@Parameter(name="*")
@dataclass(frozen=True)
class RecipeOptions:
    """Options of the recipe from acceleration to displacement."""

    onset: Annotated[float | None, Parameter(help="When the motion begins on the sensor's clock, in seconds.")] = None
    band: Annotated[tuple[float, float], Parameter(help="Lowest and highest frequency in Hz.")] = (1.0, 10.0)
    integration: Annotated[Literal["trapezoid", "spline"], Parameter(help="Rule of integration.")] = "trapezoid"

    hampel: Annotated[
        HampelUse,
        Parameter(
            help="Replace outliers: on, as in the paper; off; auto, lone samples alone where it would cut impacts."
        ),
    ] = "auto"

    def settings(self) -> RecipeSettings:
        """Settings of the recipe as the library knows them."""
        return RecipeSettings(onset_s=self.onset, band_hz=self.band, integration=self.integration, hampel=self.hampel)


@Parameter(name="*")
@dataclass(frozen=True)
class ClockOptions:
    """Options of the clock of a reference beside that of the video."""

    synchronize: Annotated[
        bool | None, Parameter(help="Estimate the lag of the reference's clock; left out, only of sensors.")
    ] = None
    search: Annotated[float, Parameter(help="Seconds around --start-lag in which the lag is searched.")] = 5.0
    start_lag: Annotated[float, Parameter(help="Lag of the reference in seconds, as far as it is known.")] = 0.0

    def settings(self) -> ReferenceClock:
        """The reference's clock as the library knows it."""
        return ReferenceClock(self.search, self.start_lag, synchronize=self.synchronize)


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
