"""Content of a report, whatever it is written as: sections of blocks, whose texts are in the reader's language."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

__all__ = ["Block", "Cell", "Content", "Facts", "Figure", "Listed", "Paragraph", "Section", "Table", "Tone"]

Tone = Literal["", "good", "care", "bad", "quiet", "strong", "code"]
"""How a paragraph or a row of a table looks: as the verdicts of an audit, in grey, bold, or as code."""


@dataclass(frozen=True)
class Cell:
    """Text of a table, and the number that it shows.

    Parameters
    ----------
    text
        Text as it is shown.
    value
        The number before it was rounded, in the unit that the text is in; ``None`` where the text is none, or the
        number is not known.
    """

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Paragraph:
    """Sentences that stand together.

    Parameters
    ----------
    text
        The sentences.
    tone
        How they look.
    foreign
        Whether they are in English, whatever the report's language.
    """

    kind: ClassVar[str] = "paragraph"
    text: str
    tone: Tone = ""
    foreign: bool = False


@dataclass(frozen=True)
class Listed:
    """Sentences with a dot before each.

    Parameters
    ----------
    items
        The sentences.
    foreign
        Whether they are in English, whatever the report's language.
    """

    kind: ClassVar[str] = "listed"
    items: tuple[str, ...]
    foreign: bool = False


@dataclass(frozen=True)
class Facts:
    """What something is, line by line.

    Parameters
    ----------
    rows
        Name and value of each line.
    """

    kind: ClassVar[str] = "facts"
    rows: tuple[tuple[str, Cell], ...]


@dataclass(frozen=True)
class Table:
    """Rows under names of columns, which are repeated on every page.

    Parameters
    ----------
    caption
        What it shows, and how to read it.
    columns
        Names of the columns, with units.
    rows
        As many cells as columns, each.
    words
        How many columns, from the first, hold words; the others hold numbers, which are set to the right.
    tones
        How each row looks; none where they look alike.
    """

    kind: ClassVar[str] = "table"
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    words: int = 1
    tones: tuple[Tone, ...] = ()


@dataclass(frozen=True)
class Figure:
    """A drawing as SVG.

    Parameters
    ----------
    caption
        What it shows.
    svg
        The element ``<svg>``, with all its text escaped.
    """

    kind: ClassVar[str] = "figure"
    caption: str
    svg: str


Block = Paragraph | Listed | Facts | Table | Figure


@dataclass(frozen=True)
class Section:
    """A part of a report under a title.

    Parameters
    ----------
    title
        Its title.
    blocks
        What stands in it.
    """

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Content:
    """A report.

    Parameters
    ----------
    language
        Code of the language, such as ``en``.
    title, subtitle
        What stands on the first page, above all sections.
    sections
        In the order in which they are read.
    footer
        Words at the foot of every page.
    """

    language: str
    title: str
    subtitle: str
    sections: tuple[Section, ...] = field(default=())
    footer: str = ""
