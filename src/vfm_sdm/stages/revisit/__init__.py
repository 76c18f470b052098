"""The same structure filmed again: change of rest position since an earlier visit, through points that stand still."""

from vfm_sdm.stages.revisit.compare import Revisit, compare_visits, write_revisit

__all__ = ["Revisit", "compare_visits", "write_revisit"]
