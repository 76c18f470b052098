"""Records of a benchmark: all methods on one field test, and all field tests."""

from dataclasses import dataclass, field
from pathlib import Path

from vfm_sdm.analysis.evaluation import Evaluation
from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.studies.protocol.cost import Cost
from vfm_sdm.studies.protocol.methods import ComparedMethod
from vfm_sdm.studies.protocol.runs import FieldTest, MethodRun
from vfm_sdm.studies.protocol.tables import Case, Table

__all__ = ["AGAINST", "Benchmark", "TestResult"]

AGAINST = {
    "truth": "the exact displacement",
    "accelerometers": "displacement from the accelerometers, both at 1 to 10 Hz",
}
"""Data that the methods are compared with."""


@dataclass(eq=False)
class TestResult:
    """Results of all methods on one field test.

    Parameters
    ----------
    test
        The field test.
    runs
        Run of each method.
    evaluations
        Evaluations by the data of the comparison and by method.
    reference
        Evaluation of the accelerometers' own displacement against the truth.
    costs
        Costs of the stages of the default method.
    """

    test: FieldTest
    runs: dict[ComparedMethod, MethodRun] = field(default_factory=dict)
    evaluations: dict[str, dict[ComparedMethod, Evaluation]] = field(
        default_factory=lambda: {name: {} for name in AGAINST}
    )
    reference: Evaluation | None = None
    costs: list[Cost] = field(default_factory=list)

    def score(self, against: str, method: ComparedMethod, case: Case) -> Score | None:
        """Metrics of a method in a case; ``None`` where it has none.

        Parameters
        ----------
        against
            Key of `AGAINST`.
        method
            The method.
        case
            Field test, point and axis.
        """
        evaluation = self.evaluations[against].get(method)
        if evaluation is None:
            return None
        found = [row.score for row in evaluation.rows if (row.point, row.axis) == (case.point, case.axis)]
        return found[0] if found else None

    @property
    def cases(self) -> list[Case]:
        """The monitored points along both axes, in the paper's order."""
        return [Case(self.test.plan.name, p, axis) for p in self.test.monitored for axis in ("vertical", "lateral")]


@dataclass(eq=False)
class Benchmark:
    """Result of `run_benchmark`.

    Parameters
    ----------
    folder
        Folder of the tables and figures.
    tables
        All tables by name.
    results
        Results by field test.
    figures
        Paths of the figures.
    seconds
        Time that the run took [s].
    """

    folder: Path
    tables: dict[str, Table]
    results: dict[str, TestResult]
    figures: list[Path]
    seconds: float
