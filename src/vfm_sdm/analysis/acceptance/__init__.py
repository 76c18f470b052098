"""Acceptance in the field's own terms: noise floor, rigid steps, known lengths, and the budget by Monte Carlo."""

from vfm_sdm.analysis.acceptance.lengths import KnownLength, check_lengths, read_lengths
from vfm_sdm.analysis.acceptance.monte_carlo import BudgetModel, check_budget
from vfm_sdm.analysis.acceptance.noise_floor import check_noise_floor
from vfm_sdm.analysis.acceptance.records import Acceptance, AcceptanceRow, AcceptedRun, read_run, write_acceptance
from vfm_sdm.analysis.acceptance.rigid import StageStep, check_rigid, read_steps

__all__ = [
    "Acceptance",
    "AcceptanceRow",
    "AcceptedRun",
    "BudgetModel",
    "KnownLength",
    "StageStep",
    "check_budget",
    "check_lengths",
    "check_noise_floor",
    "check_rigid",
    "read_lengths",
    "read_run",
    "read_steps",
    "write_acceptance",
]
