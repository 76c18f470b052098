"""The command ``report``: a run folder as a report for the client."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from vfm_sdm.commands.terminal import say
from vfm_sdm.outputs.report import write_report

__all__ = ["report"]


def report(
    run: Annotated[Path, Parameter(help="Run folder of `vfm-sdm measure`.")],
    *,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="File to write, .html or .pdf; report.html in the run folder else."),
    ] = None,
    language: Annotated[Literal["en", "de"], Parameter(help="Language and form of numbers.")] = "en",
    pdf: Annotated[bool, Parameter(negative="", help="Also write a PDF (extra `report`).")] = False,
    session: Annotated[
        Path | None,
        Parameter(help="Session file whose table [report] is used, where it was filled in after the measurement."),
    ] = None,
) -> None:
    """A measurement as a report for the client: one HTML file that prints on A4, and PDF."""
    for path in write_report(run, output, language=language, pdf=pdf, session=session):
        say(f"written: {path}")
