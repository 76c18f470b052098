"""Sections of a report: each a function of `ReportInputs` and a `Language`, listed in `vfm_sdm.core.parts`."""
