"""The paper's protocol: field tests x methods, scored against truth and against accelerometers."""

from vfm_sdm.studies.protocol.benchmark import run_benchmark
from vfm_sdm.studies.protocol.records import Benchmark, TestResult
from vfm_sdm.studies.protocol.tables import Case, Table

__all__ = ["Benchmark", "Case", "Table", "TestResult", "run_benchmark"]
