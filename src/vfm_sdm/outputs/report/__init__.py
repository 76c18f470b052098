"""The report on a run folder for people who did not measure: one HTML file, and PDF."""

from vfm_sdm.outputs.report.build import build_content
from vfm_sdm.outputs.report.content import Cell, Content, Facts, Figure, Listed, Paragraph, Section, Table
from vfm_sdm.outputs.report.html import to_html
from vfm_sdm.outputs.report.inputs import ReportInputs, open_run
from vfm_sdm.outputs.report.language import LANGUAGES, Language, find_language
from vfm_sdm.outputs.report.pdf import to_pdf
from vfm_sdm.outputs.report.write import write_report

__all__ = [
    "LANGUAGES",
    "Cell",
    "Content",
    "Facts",
    "Figure",
    "Language",
    "Listed",
    "Paragraph",
    "ReportInputs",
    "Section",
    "Table",
    "build_content",
    "find_language",
    "open_run",
    "to_html",
    "to_pdf",
    "write_report",
]
