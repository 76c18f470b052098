"""What commands print, as text for people or, with ``--json``, as one JSON object; and how they end."""

import io
import json
import math
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from enum import IntEnum
from typing import Any, NoReturn

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vfm_sdm.errors import ResultsError

__all__ = [
    "ERR",
    "OUT",
    "Ending",
    "Terminal",
    "add_name_column",
    "as_json",
    "fail",
    "note",
    "number_text",
    "plain_table",
    "say",
    "say_json",
    "say_rest",
    "show_all_letters",
    "shown_rows",
    "table_rows",
]


class Ending(IntEnum):
    """Exit statuses of all commands."""

    DONE = 0
    ERROR = 1
    """The input cannot be used, or a test was not passed; a message says what to do."""
    MISTYPED = 2
    """The command line has words that cannot be understood, or lacks some."""
    NO_RESULT = 3
    """The input was right, and the data did not allow a result."""
    REFUSED = 4
    """There is a result, and the audit says not to use it."""
    INTERRUPTED = 130
    """By Ctrl-C, as shells have it."""


_MOST_POINTS = 20
"""Points that a table shows: a screen and a half, with three axes each."""
_NAME_WIDTH = 16
"""Letters of a name that tables have room for; most are shorter."""
_COLLECTED: ContextVar[dict[str, list[Any]] | None] = ContextVar("collected", default=None)


class Terminal(Console):
    """Standard output, without markup: names in square brackets are names. Inside `as_json` what is printed is kept."""

    def __init__(self) -> None:
        super().__init__(markup=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """Prints, or keeps for the JSON object.

        Parameters
        ----------
        objects, options
            As of rich's console.

        Raises
        ------
        ResultsError
            Where it goes to takes no more, such as a file on a disk that is full.
        """
        collected = _COLLECTED.get()
        if collected is None:
            try:
                super().print(*objects, **options)
            except OSError as error:
                raise ResultsError(
                    f"standard output: expected to write to it, got: {error.strerror}; free space, or send it elsewhere"
                ) from error
            return
        for one in objects:
            if isinstance(one, Table):
                collected["tables"].append({"title": _plain(one.title), "rows": table_rows(one)})
                # What stands below a table says why, or what it leaves out.
                collected["lines"] += [line for line in _plain(one.caption).splitlines() if line]
            else:
                collected["lines"].append(_plain(one).strip())


OUT = Terminal()
"""Standard output of all commands."""
ERR = Console(stderr=True, markup=False)
"""Where commands say what is wrong, and ask."""


def say(line: str) -> None:
    """Prints a line as it is: the terminal's edge breaks no path.

    Parameters
    ----------
    line
        The line.
    """
    OUT.print(line, highlight=False, soft_wrap=True)


def say_json(content: Any, *, indent: int | None = None) -> None:
    """Prints JSON in letters of ASCII, which every terminal and file has.

    Parameters
    ----------
    content
        Tables, lists, text, finite numbers, truth values and ``None``.
    indent
        Blanks before each level; one line when ``None``.
    """
    OUT.print(json.dumps(content, indent=indent, allow_nan=False), highlight=False, soft_wrap=True)


def note(notes: Iterable[str], console: Console = OUT) -> None:
    """Prints what a reader must know.

    Parameters
    ----------
    notes
        Sentences.
    console
        Where to; standard error where there is no result.
    """
    for one in notes:
        console.print(f"note: {one}", style="yellow", highlight=False)


def fail(reason: object) -> NoReturn:
    """Ends with status 3: the input was right, the data did not allow a result.

    Parameters
    ----------
    reason
        Why.
    """
    ERR.print(f"vfm-sdm: {reason}", style="red", highlight=False, soft_wrap=True)
    sys.exit(Ending.NO_RESULT)


@contextmanager
def as_json() -> Iterator[None]:
    """Prints, at the end of the block, everything that was printed in it as one JSON object: ``tables`` and ``lines``.

    Commands end by an exception, too, which passes; its status is ``exit_status``. What anything else writes to
    standard output, such as help, goes to standard error: a program finds one object and nothing beside it.
    """
    token = _COLLECTED.set({"tables": [], "lines": []})
    status: object = Ending.DONE
    try:
        with redirect_stdout(sys.stderr):
            yield
    except SystemExit as stop:
        status = stop.code or Ending.DONE
        raise
    except BaseException as error:
        status = Ending.INTERRUPTED if isinstance(error, KeyboardInterrupt) else Ending.ERROR
        raise
    finally:
        collected = {"exit_status": status, **(_COLLECTED.get() or {})}
        _COLLECTED.reset(token)
        say_json(collected, indent=1)


def show_all_letters() -> None:
    """Lets output hold what its encoding does not have, as codes: names may have any letters, terminals not."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def shown_rows(count: int) -> int:
    """How many of so many points a table has room for: all of them in JSON.

    Parameters
    ----------
    count
        How many there are.

    Examples
    --------
    >>> shown_rows(8), shown_rows(400)
    (8, 20)
    """
    return count if _COLLECTED.get() is not None else min(count, _MOST_POINTS)


def say_rest(table: Table, count: int, where: str) -> Table:
    """The table with a line below that says how many points it leaves out, and where they are.

    Parameters
    ----------
    table
        The table, with `shown_rows` of them.
    count
        How many there are.
    where
        File that has them all.
    """
    left = count - shown_rows(count)
    if left > 0:
        table.caption, table.caption_justify = Text(f"... and {left} more points; all in {where}"), "left"
    return table


def plain_table(title: str | Text = "", *, dense: bool = False) -> Table:
    """A table as all commands print them: a rule below the headings and no other lines, columns yet to be added.

    Parameters
    ----------
    title
        What stands above it, as it is; nothing when empty.
    dense
        Whether nothing is left between columns, where many have to stand in a line.

    Examples
    --------
    >>> table = plain_table("Points [1]")
    >>> table.title.plain, table.columns
    ('Points [1]', [])
    """
    above = Text(title) if isinstance(title, str) else title
    padding = 0 if dense else (0, 1, 0, 0)
    return Table(title=above or None, title_justify="left", box=box.SIMPLE_HEAD, padding=padding, show_edge=False)


def add_name_column(table: Table, title: str, names: Iterable[str], *, room: int = _NAME_WIDTH) -> None:
    """Adds a column that shows names whole: those longer than its room go on in the next line.

    Parameters
    ----------
    table, title
        The table, and the column's heading.
    names
        The names.
    room
        Letters that the table has room for.
    """
    longest = max((len(str(name)) for name in names), default=0)
    table.add_column(Text(title), min_width=min(max(longest, len(title)), room), overflow="fold")


def number_text(value: float | None, form: str, factor: float = 1.0) -> str:
    """A number of a table; a dash where there is none.

    Parameters
    ----------
    value
        The number.
    form
        How it is written.
    factor
        What it is multiplied by before.

    Examples
    --------
    >>> number_text(0.00123, "{:.2f}", 1000.0), number_text(None, "{:.2f}")
    ('1.23', '-')
    """
    return "-" if value is None or not math.isfinite(value) else form.format(value * factor)


def table_rows(table: Table) -> list[dict[str, Any]]:
    """Rows of a table by the names of its columns: numbers where they are numbers, ``None`` where there is no value.

    Parameters
    ----------
    table
        The table, whose numbers stand at the right of their columns. A first cell that is empty says the same as the
        one above; a column without a name is ``note``, and of two of one name the second is ``NAME 2``.

    Examples
    --------
    >>> table = Table("point")
    >>> table.add_column("p-p", justify="right")
    >>> table.add_row("mid", "1.50"), table.add_row("", "-")
    (None, None)
    >>> table_rows(table)
    [{'point': 'mid', 'p-p': 1.5}, {'point': 'mid', 'p-p': None}]
    """
    names: list[str] = []
    for column in table.columns:
        name = _plain(column.header) or "note"
        names.append(f"{name} {names.count(name) + 1}" if name in names else name)
    rows: list[dict[str, Any]] = []
    numbers = [column.justify == "right" for column in table.columns]
    for cells in zip(*(column.cells for column in table.columns), strict=True):
        texts = [_plain(cell) for cell in cells]
        row = {
            name: _value(text) if is_number else text
            for name, text, is_number in zip(names, texts, numbers, strict=True)
        }
        if rows and row[names[0]] == "":
            row[names[0]] = rows[-1][names[0]]
        rows.append(row)
    return rows


def _plain(shown: Any) -> str:
    return "" if shown is None else shown.plain if isinstance(shown, Text) else str(shown)


def _value(cell: str) -> float | str | None:
    if cell == "-":
        return None
    try:
        number = float(cell)
    except ValueError:
        return cell
    return number if math.isfinite(number) else None  # JSON has no others
