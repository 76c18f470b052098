"""The same films measured by several people: repeatability and reproducibility."""

from vfm_sdm.analysis.repeatability.anova import Spread, analyse_variance
from vfm_sdm.analysis.repeatability.compare import QUANTITIES, RepeatedRun, compare_runs
from vfm_sdm.analysis.repeatability.record import check_repeatability, read_repeatability, write_repeatability

__all__ = [
    "QUANTITIES",
    "RepeatedRun",
    "Spread",
    "analyse_variance",
    "check_repeatability",
    "compare_runs",
    "read_repeatability",
    "write_repeatability",
]
