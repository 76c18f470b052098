"""A report as PDF, set by typst from the same content.

The template is a fixed file that reads the content as data; no text of a session ever becomes a part of a program.
"""

import json
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vfm_sdm.errors import BackendUnavailableError, ResultsError
from vfm_sdm.outputs.report.content import Block, Content, Figure, Table
from vfm_sdm.outputs.report.language import find_language

__all__ = ["check_typst", "to_pdf"]

_TEMPLATE = "report.typ"


def check_typst() -> Any:
    """The package that sets PDF files.

    Raises
    ------
    BackendUnavailableError
        It is not installed.
    """
    try:
        import typst  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise BackendUnavailableError(
            "report as PDF: expected the package typst, got none; pip install 'vfm-sdm[report]', or leave --pdf out: "
            "browsers print the HTML file"
        ) from error
    return typst


def to_pdf(content: Content) -> bytes:
    """The report as PDF.

    Parameters
    ----------
    content
        The report.

    Raises
    ------
    BackendUnavailableError
        typst is not installed.
    ResultsError
        It could not set the report.
    """
    typst = check_typst()
    try:
        with TemporaryDirectory(prefix="vfm-sdm-report-") as folder:
            template = _write_parts(Path(folder), content)
            return bytes(typst.compile(str(template), root=folder))
    except (RuntimeError, OSError) as error:
        raise ResultsError(
            f"report as PDF: expected typst to set it, got: {error}; the HTML file can be printed"
        ) from error


def _write_parts(folder: Path, content: Content) -> Path:
    """Writes the template, the content as data, and all drawings; the path of the template."""
    language, sections, number = find_language(content.language), list[dict[str, Any]](), 0
    for section in content.sections:
        blocks = []
        for block in section.blocks:
            fields = _describe(block)
            if isinstance(block, Figure):
                number += 1
                fields["svg"] = f"{number}.svg"
                (folder / fields["svg"]).write_text(block.svg, encoding="utf-8")
            blocks.append(fields)
        sections.append({"title": section.title, "blocks": blocks})
    words = {key: language.say(key) for key in ("page", "signature")}
    report = {**asdict(content), "sections": sections, "words": words}
    (folder / "report.json").write_text(json.dumps(report, ensure_ascii=False), encoding="utf-8")
    template = folder / _TEMPLATE
    template.write_bytes((files("vfm_sdm.outputs.report") / "templates" / _TEMPLATE).read_bytes())
    return template


def _describe(block: Block) -> dict[str, Any]:
    """Fields of a block as plain tables."""
    fields = {"kind": block.kind, **asdict(block)}
    if isinstance(block, Table):
        rows = [[cell["text"] for cell in row] for row in fields["rows"]]
        # Columns of numbers share their room by the longest cell, or word at the head, of each.
        heads = [max(map(len, name.split()), default=1) for name in block.columns]
        longest = [max([head, *(len(row[n]) for row in rows)]) for n, head in enumerate(heads)]
        fields |= {"rows": rows, "weights": longest}
    elif "rows" in fields:
        fields["rows"] = [[name, cell["text"]] for name, cell in fields["rows"]]
    return fields
