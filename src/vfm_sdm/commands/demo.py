"""The demonstration: make a synthetic recording with known motion, measure it, compare."""

from dataclasses import dataclass
from pathlib import Path

from vfm_sdm.analysis.evaluation import Evaluation, evaluate_run
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.studies.synthetic.field_test import make_demo

__all__ = ["DemoResult", "run_demo"]


@dataclass(frozen=True, eq=False)
class DemoResult:
    """What the demonstration yields.

    Parameters
    ----------
    measurement
        All products of the run.
    evaluation
        Displacement against the truth; ``None`` where there is no displacement.
    run_folder
        Where the run is.
    """

    measurement: Measurement
    evaluation: Evaluation | None
    run_folder: Path


def run_demo(folder: Path | str, *, seed: int = 1, progress: Progress | None = None) -> DemoResult:
    """Makes a field test in ``folder/recording``, measures it into ``folder/run``, and compares it with the truth.

    Parameters
    ----------
    folder
        Where to write.
    seed
        Seed of everything random.
    progress
        Called with each step's description.
    """
    recording, run_folder = Path(folder) / "recording", Path(folder) / "run"
    session = make_demo(recording, seed=seed, progress=progress)
    measurement = measure(read_session(session), run_folder, progress=progress)
    evaluation = None
    if measurement.displacement is not None:
        evaluation = evaluate_run(run_folder, session.parent / "truth.nc", axes=STRUCTURE_AXES)
    return DemoResult(measurement, evaluation, run_folder)
