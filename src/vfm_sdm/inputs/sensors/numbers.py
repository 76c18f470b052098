"""Numbers as instruments write them: decimal commas, thousands separators, texts for "no value" and for "too much"."""

import math
import re
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError

__all__ = ["find_decimal_mark", "is_clock_time", "is_value", "parse_numbers"]

_MISSING = frozenset(
    [
        "nan",
        "na",
        "n/a",
        "n.a.",
        "null",
        "none",
        "nil",
        "nul",
        "-",
        "--",
        "---",
        "?",
        "#n/a",
        "#nv",
        "#na",
        "missing",
        "invalid",
        "-nan",
        "1.#qnan",
        "1.#ind",
    ]
)
_OVERLOAD = frozenset(
    [
        "inf",
        "-inf",
        "+inf",
        "infinity",
        "-infinity",
        "ovl",
        "ol",
        "o.l.",
        "0l",
        "over",
        "overload",
        "overrange",
        "overflow",
        "over-range",
        "clip",
        "clipped",
        "sat",
    ]
)
_NUMBER = re.compile(
    r"[+\-−]?(?:\d{1,3}(?:[ '’\u00a0\u202f]\d{3})+(?:[.,]\d*)?|\d(?:[\d.,]*\d)?\.?|[.,]\d+)(?:[eEdD][+\-−]?\d+)?"
)
_DAY = (
    r"(?:\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}\.?|\d{1,2}[-/. ][A-Za-z]{3,9}\.?[-/. ,]+\d{2,4}"
    r"|(?:[A-Za-z]{3,9},? )?[A-Za-z]{3,9}\.? \d{1,2},? \d{4})"
)
_CLOCK = re.compile(
    rf"(?:{_DAY},?[T _]?\s*)?\d{{1,2}}:\d{{2}}(?::\d{{2}})?(?:[.,:]\d+)?"
    r"\s*(?:[AaPp]\.?[Mm]\.?)?\s*(?:Z|UTC|GMT|[+-]\d{2}:?\d{2})?"
)
_DATE = re.compile(_DAY)
_SPACES = str.maketrans("−", "-", " '’\u00a0\u202f")
_GROUP = 3
"""Digits between two thousands separators."""
_LOOKED_AT = 200_000
"""Cells that decide on the decimal mark."""


def is_value(cell: str) -> bool:
    """Whether a cell holds a number, or a text that instruments write in place of one.

    Examples
    --------
    >>> [is_value(cell) for cell in ("-1,5e-3", "1 234.5", "NaN", "OVL", "ax", "")]
    [True, True, True, True, False, False]
    """
    return _NUMBER.fullmatch(cell) is not None or cell.casefold() in _MISSING or cell.casefold() in _OVERLOAD


def is_clock_time(cell: str) -> bool:
    """Whether a cell holds a date, a time of day or both.

    Examples
    --------
    >>> [is_clock_time(cell) for cell in ("2026-05-14T10:22:31.005Z", "14.05.2026 10:22:31,005", "10:22", "10.22")]
    [True, True, True, False]
    """
    return _CLOCK.fullmatch(cell) is not None or _DATE.fullmatch(cell) is not None


def find_decimal_mark(path: Path | str, cells: Iterable[str], *, commas_part: bool = False) -> str:
    """The decimal mark of a file, a point or a comma.

    Parameters
    ----------
    path
        The file, for messages.
    cells
        Its cells.
    commas_part
        Whether commas separate the columns; a comma inside a cell is then one inside quotes.

    Raises
    ------
    DatasetError
        Some cells say one and some the other, or none says which it is, because all could be thousands.

    Examples
    --------
    >>> find_decimal_mark("a.csv", ["0,005", "1.234,5"]), find_decimal_mark("a.csv", ["1,234.5", "17"])
    (',', '.')
    """
    seen: dict[str, str] = {}
    unsure = ""
    for cell in islice(cells, _LOOKED_AT):
        if not ("," in cell or "." in cell) or _NUMBER.fullmatch(cell) is None or is_clock_time(cell):
            continue
        mark = _decimal_mark_of(cell)
        if mark:
            seen.setdefault(mark, cell)
        elif "," in cell:
            unsure = unsure or cell
        if len(seen) > 1:
            raise DatasetError(
                f"{path}: expected one decimal mark, got {seen['.']!r} and {seen[',']!r}; export with decimal points"
            )
    if not seen and unsure:
        raise DatasetError(
            f"{path}: expected numbers that say whether a comma is the decimal mark, got only such as {unsure!r}; "
            "export with decimal points or with more digits"
        )
    return next(iter(seen), ".")


def _decimal_mark_of(cell: str) -> str | None:
    """Which mark a number proves to be the decimal one; ``None`` where it could be that of thousands."""
    exponent = "e" in cell.casefold()
    digits = re.split(r"[eEdD]", cell.translate(_SPACES).lstrip("+-"))[0]
    points, commas = digits.count("."), digits.count(",")
    if points and commas:
        return "." if digits.rindex(".") > digits.rindex(",") else ","
    mark, other = (".", ",") if points else (",", ".")
    if points + commas > 1:
        return other
    whole, rest = digits.split(mark)
    sure = exponent or len(rest) != _GROUP or len(whole) > _GROUP or whole.startswith("0") or not whole
    return mark if sure else None


def parse_numbers(cells: Sequence[str], decimal: str) -> tuple[FloatArray, int | None]:
    """Numbers in cells; NaN where there is none, infinity where the instrument says that it was too much.

    Parameters
    ----------
    cells
        Cells of a column, length T.
    decimal
        Decimal mark; the other mark, blanks and apostrophes between digits are thousands separators.

    Returns
    -------
    values
        Shape (T,), in the unit of the column.
    wrong
        Place of the first cell that is neither a number nor a text for none; ``None`` where all are.

    Examples
    --------
    >>> parse_numbers(["1.234,5", "", "NaN", "OL"], ",")[0].tolist()
    [1234.5, nan, nan, inf]
    """
    if decimal == ".":
        try:
            return np.asarray([float(cell) if cell else math.nan for cell in cells]), None
        except ValueError:
            pass
    values = np.empty(len(cells))
    thousands = "," if decimal == "." else "."
    grouped = re.compile(rf"[+-]?\d{{1,3}}(?:\{thousands}\d{{3}})+(?:\{decimal}\d*)?")
    for number, cell in enumerate(cells):
        plain = cell.casefold()
        if not cell or plain in _MISSING:
            values[number] = math.nan
        elif plain in _OVERLOAD:
            values[number] = -math.inf if plain.startswith("-") else math.inf
        else:
            text = plain.translate(_SPACES)
            if thousands in text and not grouped.fullmatch(text):
                return values, number
            try:
                values[number] = float(text.replace(thousands, "").replace(decimal, ".").replace("d", "e"))
            except ValueError:
                return values, number
    return values, None
