"""Load tests: static levels of every step, what remains, and vehicles that pass; beside what was calculated."""

from vfm_sdm.analysis.load_test.amplification import judge_passages
from vfm_sdm.analysis.load_test.judgement import Limits, judge_load_test
from vfm_sdm.analysis.load_test.levels import Level, find_level, find_plateaus
from vfm_sdm.analysis.load_test.passages import Axle, Passage, read_axles, read_passages
from vfm_sdm.analysis.load_test.record import (
    check_load_test,
    check_passages,
    read_load_test,
    read_passages_of_run,
    write_load_test,
    write_passages,
)
from vfm_sdm.analysis.load_test.static_points import MovedPoint, drop_static, find_moved_static
from vfm_sdm.analysis.load_test.steps import LoadPlan, LoadStep, read_steps

__all__ = [
    "Axle",
    "Level",
    "Limits",
    "LoadPlan",
    "LoadStep",
    "MovedPoint",
    "Passage",
    "check_load_test",
    "check_passages",
    "drop_static",
    "find_level",
    "find_moved_static",
    "find_plateaus",
    "judge_load_test",
    "judge_passages",
    "read_axles",
    "read_load_test",
    "read_passages",
    "read_passages_of_run",
    "read_steps",
    "write_load_test",
    "write_passages",
]
