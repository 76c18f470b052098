"""A report as one HTML file: no script, nothing that is fetched, and a layout for A4 when it is printed."""

from importlib.resources import files
from typing import Final

from jinja2 import DictLoader, Environment, StrictUndefined

from vfm_sdm.outputs.report.content import Content
from vfm_sdm.outputs.report.language import find_language

__all__ = ["to_html"]

_TEMPLATE: Final = "report.html.jinja"


def to_html(content: Content) -> str:
    """The report as HTML; all text is escaped.

    Parameters
    ----------
    content
        The report.

    Examples
    --------
    >>> from vfm_sdm.outputs.report.content import Paragraph, Section
    >>> page = to_html(Content("en", "report", "bridge", (Section("task", (Paragraph("a <b"),)),)))
    >>> page[:15], "a &lt;b" in page
    ('<!DOCTYPE html>', True)
    """
    text = (files("vfm_sdm.outputs.report") / "templates" / _TEMPLATE).read_text(encoding="utf-8")
    environment = Environment(
        loader=DictLoader({_TEMPLATE: text}),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    language = find_language(content.language)
    return environment.get_template(_TEMPLATE).render(content=content, say=language.say) + "\n"
