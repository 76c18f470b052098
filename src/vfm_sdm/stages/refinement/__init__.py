"""Structural geometry refinement (SGR): knowledge of the structure's motion corrects the poorer of two views."""

from vfm_sdm.stages.refinement.model import REFINEMENT_STATUSES, Refinement, SgrSettings
from vfm_sdm.stages.refinement.objective import SgrWeights
from vfm_sdm.stages.refinement.settings import sgr_settings
from vfm_sdm.stages.refinement.sgr import refine

__all__ = ["REFINEMENT_STATUSES", "Refinement", "SgrSettings", "SgrWeights", "refine", "sgr_settings"]
