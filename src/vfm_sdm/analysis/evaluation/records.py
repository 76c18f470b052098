"""Records of an evaluation, and its file."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.core.files import write_json
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR
from vfm_sdm.stages.synchronize import Synchronization

__all__ = ["COVERAGE_FACTOR", "NOMINAL_COVERAGE", "Evaluation", "EvaluationRow", "write_evaluation"]

NOMINAL_COVERAGE = 0.9545
"""Share of a normal distribution within `COVERAGE_FACTOR`: what `Score.coverage` should be near."""

_PAPER_METRICS = ("nrmse_range", "correlation", "rppae")


@dataclass(frozen=True)
class EvaluationRow:
    """One point and axis of a measurement beside its reference, over the samples known in both.

    Parameters
    ----------
    point, axis
        Names in the measurement.
    score
        All metrics; NaN where they could not be computed (`Evaluation.notes` say why).
    estimate_peak_to_peak_mm, reference_peak_to_peak_mm
        Peak-to-peak amplitudes in the band of the comparison [mm].
    rms_error_mm
        Root mean square difference, after the offset was removed if it was [mm].
    """

    point: str
    axis: str
    score: Score
    estimate_peak_to_peak_mm: float
    reference_peak_to_peak_mm: float
    rms_error_mm: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Result of `evaluate`.

    Parameters
    ----------
    rows
        One row for each compared point and axis.
    synchronization
        Lag of the reference's clock, where it was estimated; ``None`` where it was known.
    band_hz
        Band that both sides were filtered to [Hz]; ``None`` when they were not.
    reference_name
        What the measurement was compared with.
    notes
        Sentences that a reader must know: why metrics are missing, what was left out.
    """

    rows: tuple[EvaluationRow, ...]
    synchronization: Synchronization | None
    band_hz: tuple[float, float] | None
    reference_name: str
    notes: tuple[str, ...] = ()

    def row(self, point: str, axis: str) -> EvaluationRow:
        """The row of a point and axis.

        Parameters
        ----------
        point, axis
            Names in the measurement.

        Raises
        ------
        DatasetError
            There is no such row.
        """
        for row in self.rows:
            if (row.point, row.axis) == (point, axis):
                return row
        known = [(row.point, row.axis) for row in self.rows]
        raise DatasetError(f"row: expected one of {known}, got {(point, axis)}; see the notes for what was left out")

    @property
    def scored_rows(self) -> tuple[EvaluationRow, ...]:
        """Rows with metrics, because the reference and enough samples were there."""
        return tuple(row for row in self.rows if np.isfinite(row.score.nrmse_range))

    def mean_and_std(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of the paper's three metrics over the rows that have them, by metric [1].

        Notes
        -----
        The standard deviation is that of the rows themselves (divided by their number): the paper's tables agree with
        it in two of three columns. Rows without metrics do not count; compare the length of `scored_rows`.
        """
        result = {}
        for name in _PAPER_METRICS:
            values = np.array([getattr(row.score, name) for row in self.rows], dtype=np.float64)
            known = values[np.isfinite(values)]
            result[name] = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
        return result


def write_evaluation(folder: Path | str, evaluation: Evaluation) -> Path:
    """Writes ``evaluation.json``, with null for what is not known; returns its path.

    Parameters
    ----------
    folder
        Folder of the file.
    evaluation
        Metrics of all rows; lengths in mm, times in seconds.

    Raises
    ------
    ResultsError
        The file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     print(write_evaluation(folder, Evaluation((), None, None, "truth")).name)
    evaluation.json
    """
    lag = evaluation.synchronization
    contents = {
        "reference": evaluation.reference_name,
        "band_hz": evaluation.band_hz,
        "synchronization": None if lag is None else {**asdict(lag), "offset_s": lag.offset_s},
        "nominal_coverage": NOMINAL_COVERAGE,
        "rows": [asdict(row) for row in evaluation.rows],
        "rows_with_figures": len(evaluation.scored_rows),
        "mean": {name: mean for name, (mean, _) in evaluation.mean_and_std().items()},
        "std": {name: std for name, (_, std) in evaluation.mean_and_std().items()},
        "notes": evaluation.notes,
    }
    return write_json(Path(folder) / "evaluation.json", contents, label="evaluation")
