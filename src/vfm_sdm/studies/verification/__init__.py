"""Verification of a run folder: whether its displacement follows from what it keeps."""

from vfm_sdm.studies.verification.kept_run import read_budget_model, read_measurement
from vfm_sdm.studies.verification.verify import Finding, Verification, verify_run

__all__ = ["Finding", "Verification", "read_budget_model", "read_measurement", "verify_run"]
