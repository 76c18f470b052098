"""Evaluation of a measurement: against sensors, or against another displacement such as the truth."""

from vfm_sdm.analysis.evaluation.comparison import ReferenceClock, evaluate
from vfm_sdm.analysis.evaluation.records import (
    COVERAGE_FACTOR,
    NOMINAL_COVERAGE,
    Evaluation,
    EvaluationRow,
    write_evaluation,
)
from vfm_sdm.analysis.evaluation.sources import evaluate_run, read_sensors
from vfm_sdm.inputs.sensors.netcdf import join_sensors, read_comparison, write_reference

__all__ = [
    "COVERAGE_FACTOR",
    "NOMINAL_COVERAGE",
    "Evaluation",
    "EvaluationRow",
    "ReferenceClock",
    "evaluate",
    "evaluate_run",
    "join_sensors",
    "read_comparison",
    "read_sensors",
    "write_evaluation",
    "write_reference",
]
