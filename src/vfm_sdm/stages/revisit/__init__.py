"""The same structure filmed again: change of rest position since an earlier visit, through points that stand still."""

from vfm_sdm.stages.revisit.compare import compare_to_baseline, compare_visits
from vfm_sdm.stages.revisit.result import Change, Revisit, write_revisit
from vfm_sdm.stages.revisit.visit import Visit, read_visit

__all__ = ["Change", "Revisit", "Visit", "compare_to_baseline", "compare_visits", "read_visit", "write_revisit"]
