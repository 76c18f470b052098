"""The paper's protocol: field tests x methods, scored against truth and against accelerometers."""

from vfm_sdm.protocol.benchmark import Benchmark, TestResult, run_benchmark
from vfm_sdm.protocol.tables import Case, Table

__all__ = ["Benchmark", "Case", "Table", "TestResult", "run_benchmark"]
