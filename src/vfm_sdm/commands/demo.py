"""The command ``demo``: make a synthetic recording with known motion, measure it, compare."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vfm_sdm.analysis.evaluation import Evaluation, evaluate_run
from vfm_sdm.commands.evaluation import evaluation_table
from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.tables import measurement_report
from vfm_sdm.commands.terminal import OUT, say
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.studies.synthetic.field_test import make_demo

__all__ = ["DemoResult", "demo", "run_demo"]


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


def demo(output: Annotated[Path, Parameter(help="Folder to write to.")] = Path("vfm-sdm-demo")) -> None:
    """Make a synthetic recording of a footbridge, measure it, and compare with the truth."""
    with show_progress() as progress:
        result = run_demo(output, progress=progress)
    for part in measurement_report(result.measurement):
        OUT.print(part)
    if result.evaluation is not None:
        OUT.print(evaluation_table(result.evaluation))
    say(f"written: {result.run_folder} (figures in {result.run_folder / 'figures'})")


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
