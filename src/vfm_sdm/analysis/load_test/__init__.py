"""Load tests: static levels of every step, what remains, and how both compare with what was calculated."""

from vfm_sdm.analysis.load_test.judgement import Limits, judge_load_test
from vfm_sdm.analysis.load_test.levels import Level, find_level, find_plateaus
from vfm_sdm.analysis.load_test.record import check_load_test, read_load_test, write_load_test
from vfm_sdm.analysis.load_test.steps import LoadPlan, LoadStep, read_steps

__all__ = [
    "Level",
    "Limits",
    "LoadPlan",
    "LoadStep",
    "check_load_test",
    "find_level",
    "find_plateaus",
    "judge_load_test",
    "read_load_test",
    "read_steps",
    "write_load_test",
]
