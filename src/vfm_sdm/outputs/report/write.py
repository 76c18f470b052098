"""Files of a report: HTML, and PDF where it is asked for."""

from collections.abc import Callable
from pathlib import Path

from vfm_sdm.core.files import write_file
from vfm_sdm.errors import ResultsError
from vfm_sdm.outputs.report.build import build_content
from vfm_sdm.outputs.report.content import Content
from vfm_sdm.outputs.report.html import to_html
from vfm_sdm.outputs.report.inputs import open_run
from vfm_sdm.outputs.report.language import find_language
from vfm_sdm.outputs.report.pdf import check_typst, to_pdf

__all__ = ["write_report"]

_FORMS: dict[str, Callable[[Content], str | bytes]] = {".html": to_html, ".pdf": to_pdf}


def write_report(
    run: Path | str,
    output: Path | str | None = None,
    *,
    language: str = "en",
    pdf: bool = False,
    session: Path | str | None = None,
) -> list[Path]:
    """Writes the report on a run folder; returns the paths of its files.

    Parameters
    ----------
    run
        The run folder.
    output
        File to write, ending in ``.html`` or ``.pdf``; ``report.html`` in the run folder when ``None``.
    language
        ``en`` or ``de``.
    pdf
        Whether to write a PDF file beside the HTML file.
    session
        Session file whose table ``[report]`` is taken in place of the one that was measured.

    Raises
    ------
    ResultsError
        The folder holds no whole run, or a file cannot be written.
    SessionError
        The session file cannot be read, or is not the one that was measured.
    BackendUnavailableError
        A PDF was asked for, and typst is not installed.
    """
    target = Path(run) / "report.html" if output is None else Path(output)
    if target.suffix.lower() not in _FORMS:
        raise ResultsError(f"{target}: expected a file that ends in .html or .pdf, got {target.suffix!r}; rename it")
    wanted = [target]
    if pdf and target.suffix.lower() != ".pdf":
        wanted.append(target.with_suffix(".pdf"))
    words = find_language(language)
    if any(path.suffix.lower() == ".pdf" for path in wanted):
        check_typst()  # before any work is done
    with open_run(run, session=session) as inputs:
        content = build_content(inputs, words)
    return [write_file(path, _FORMS[path.suffix.lower()](content)) for path in wanted]
