"""Tables of text as instruments write them: encodings, separators, decimal marks, lines of words before the numbers.

What a file is follows from its numbers, never from its name: the separator is the one that leaves numbers, the first
row of nothing but numbers begins the data, and the names stand in the last line of words before it. Where two readings
remain, the file is refused.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.numbers import find_decimal_mark, is_clock_time, is_value
from vfm_sdm.inputs.sensors.units import find_units, split_name

__all__ = ["Table", "read_table"]

_COMMENTS = ("#", "%", "//", "!", "*")
_SAMPLE = 200
"""Rows of the middle of a file from which its separator is found."""
_BYTE_ORDER_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)
_BINARIES = {b"PK\x03\x04": "an Excel workbook or another archive", b"\xd0\xcf\x11\xe0": "an old Excel workbook"}
_SEPARATORS = ("\t", ";", "|", None, ",")
"""In the order of preference among those that leave equally many numbers; ``None`` are blanks."""

_WHOLE_AND_PART = 2
_FEWEST_ROWS = 2

_Row = tuple[int, list[str]]
"""Line of the file, counted from 1, and the cells in it."""


@dataclass(frozen=True)
class Table:
    """Cells of a file, under names.

    Parameters
    ----------
    path
        The file.
    names, units
        Text above each column, as written; and the unit that it, or a row of units, states in the package's spelling.
    rows
        Cells of every row.
    lines
        Line of each row in the file, counted from 1.
    decimal
        Decimal mark, a point or a comma.
    notes
        What was left out, or assumed, a sentence each.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    rows: list[list[str]]
    lines: list[int]
    decimal: str
    notes: tuple[str, ...] = ()

    def bare_names(self) -> list[str]:
        """The names without units, in lower case."""
        return [split_name(name)[0].casefold() for name in self.names]


def read_table(path: Path | str, *, fewest: int = _FEWEST_ROWS) -> Table:
    r"""The table in a text file of any usual dialect.

    Parameters
    ----------
    path
        File in UTF-8, UTF-16 or Windows-1252; columns parted by commas, semicolons, tabulators, bars or blanks.
    fewest
        Rows without which it is no such table.

    Returns
    -------
    table
        Names and cells; no cell is turned into a number yet.

    Raises
    ------
    DatasetError
        The file cannot be read, or is no table; names are repeated; a row has another number of cells; separator or
        decimal mark cannot be told.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "logger.csv")
    ...     _ = file.write_text("Serial: 12\nTime (s);ax (g)\n0,00;-1,02\n0,01;-1,01\n")
    ...     table = read_table(file)
    >>> table.names, table.units, table.rows[0], table.decimal
    (('Time (s)', 'ax (g)'), ('s', 'g'), ['0,00', '-1,02'], ',')
    """
    path = Path(path)
    text, notes = _decode(path)
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip(" \t\0")]
    stated = None
    if lines and lines[0][1].casefold().startswith("sep=") and len(lines[0][1]) > len("sep="):
        stated = lines.pop(0)[1][len("sep=")]
    plain = [(number, line) for number, line in lines if not line.lstrip().startswith(_COMMENTS)]
    separator = stated if stated is not None else _find_separator([line for _, line in plain])
    split = _splitter(separator)
    rows = [(number, split(line)) for number, line in plain]
    while rows and not any(rows[-1][1]):
        rows.pop()
    first = _first_of_data([row for _, row in rows])
    if (
        separator == ","
        and first
        and len(rows[first - 1][1]) == 1
        and all(len(row) == _WHOLE_AND_PART for _, row in rows[first:])
    ):
        # One name above two cells: the comma is the decimal mark of the only column.
        separator, rows = "\0", [(number, [line.strip()]) for number, line in plain]
        first = _first_of_data([row for _, row in rows])
    if first is None or len(rows) - first < fewest:
        such = f", such as {plain[-1][1].strip()[:60]!r}, which is not of numbers" if plain and first is None else ""
        raise DatasetError(
            f"{path}: expected a line of names and at least {fewest} below it, got {len(rows)} lines{such}; "
            "export numbers alone"
        )
    header, units = _find_header([row for _, row in rows[:first]], len(rows[first][1]))
    if not header:
        comments = [(n, line) for n, line in lines if line.lstrip().startswith(_COMMENTS) and n < rows[first][0]]
        header = _commented_header(comments, split, rows[first][1])
    data = _strip_footer(rows[first:], header, notes)
    if not header:
        header = [str(number + 1) for number in range(len(data[0][1]))]
        notes.append("no line of names above the numbers: the columns are called 1, 2, ... in their order")
    header = _check_rows(path, header, data, separator)
    stated_units = [find_units(units[n]) if n < len(units) else None for n in range(len(header))]
    cells = [row for _, row in data]
    return Table(
        path,
        tuple(header),
        tuple(split_name(name)[1] or unit for name, unit in zip(header, stated_units, strict=True)),
        cells,
        [number for number, _ in data],
        find_decimal_mark(path, (c for row in cells for c in row), commas_part=separator == ","),
        tuple(notes),
    )


def _decode(path: Path) -> tuple[str, list[str]]:
    """Text of the file, and what had to be assumed."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: expected a CSV file in UTF-8, got: {error}; check the path and export") from error
    for start, what in _BINARIES.items():
        if raw.startswith(start):
            raise DatasetError(f"{path}: expected a CSV file in UTF-8, got {what}; export the sheet as CSV")
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS if raw.startswith(mark)), None)
    if encoding is None and b"\0" in raw[:200]:
        encoding = "utf-16-le" if raw[1:2] == b"\0" else "utf-16-be"
    try:
        return raw.decode(encoding or "utf-8"), []
    except UnicodeDecodeError as error:
        if encoding is not None or b"\0" in raw:
            raise DatasetError(
                f"{path}: expected a CSV file in UTF-8 or UTF-16, got: {error}; export as text in UTF-8"
            ) from error
    return raw.decode("cp1252", errors="replace"), ["text is not in UTF-8: letters are read as those of Windows-1252"]


def _splitter(separator: str | None) -> Callable[[str], list[str]]:
    """How a line becomes cells: stripped, quotes taken off."""

    def split(line: str) -> list[str]:
        if separator is None:
            return line.split()
        cells = next(csv.reader([line], delimiter=separator)) if '"' in line else line.split(separator)
        return [cell.strip(" \t\0\ufeff") for cell in cells]

    return split


def _find_separator(lines: Sequence[str]) -> str | None:
    """The separator that leaves the most numbers, in rows of one length."""
    middle = max(len(lines) // 2 - _SAMPLE // 2, 0)
    sample = lines[middle : middle + _SAMPLE]
    best, chosen = 0.0, ","
    result: str | None = chosen
    for separator in _SEPARATORS:
        rows = [_splitter(separator)(line) for line in sample]
        rows = [row for row in rows if len(row) > 1]
        if not rows:
            continue
        width = Counter(len(row) for row in rows).most_common(1)[0][0]
        score = sum(
            sum(_is_number(cell) for cell in row) / len([c for c in row if c])
            for row in rows
            if len(row) == width and any(row)
        )
        if score > best * (1 + 1e-9):
            best, result = score, separator
    return result


def _is_number(cell: str) -> bool:
    return is_value(cell) or is_clock_time(cell)


def _all_numbers(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell]
    return bool(filled) and all(map(_is_number, filled)) and any(c.isdigit() for c in "".join(filled))


def _mostly_numbers(row: Sequence[str]) -> bool:
    return len(row) > 1 and _is_number(row[0]) and 2 * sum(map(_is_number, row)) > len(row)


def _first_of_data(rows: Sequence[list[str]]) -> int | None:
    """The first row of nothing but numbers that is as long as those in the middle of the file."""
    middle = max(len(rows) // 2 - _SAMPLE // 2, 0)
    for is_data in (_all_numbers, _mostly_numbers):
        widths = Counter(len(row) for row in rows[middle : middle + _SAMPLE] if is_data(row))
        if widths:
            width = widths.most_common(1)[0][0]
            return next((n for n, row in enumerate(rows) if len(row) == width and is_data(row)), None)
    return None


def _find_header(above: Sequence[list[str]], width: int) -> tuple[list[str], list[str]]:
    """Names of columns, and their units where a row of its own, the last before the numbers, states them."""
    wide = [row for row in above if sum(map(bool, row)) > 1]
    candidates = [row for row in wide if width in (len(row), sum(map(bool, row)))] or wide
    if width == 1:
        candidates = list(above)
    if not candidates:
        return [], []
    last = candidates[-1]
    if len(candidates) > 1 and all(find_units(cell) or _is_bracketed(cell) for cell in last if cell):
        return list(candidates[-2]), list(last)
    return list(last), []


def _is_bracketed(cell: str) -> bool:
    return re.fullmatch(r"[(\[{].*[)\]}]|[-%°]", cell) is not None


def _commented_header(
    comments: Sequence[tuple[int, str]], split: Callable[[str], list[str]], row: list[str]
) -> list[str]:
    """Names in the last comment before the numbers, where it has as many words as they have cells."""
    if not comments:
        return []
    cells = split(comments[-1][1].lstrip().lstrip("".join({mark[0] for mark in _COMMENTS})).strip())
    return cells if len(cells) == len(row) and not any(map(_is_number, cells)) else []


def _strip_footer(data: list[_Row], header: Sequence[str], notes: list[str]) -> list[_Row]:
    """The rows without lines of words at the end, such as "end of file"."""
    end = len(data)
    while end > 1 and len(data[end - 1][1]) < len(data[0][1]) and not any(map(_is_number, data[end - 1][1])):
        end -= 1
    if end == len(data) > 1 and len(data[-1][1]) < len(data[-2][1]) and data[-2][1]:
        notes.append(f"left out: row {data[-1][0]}, the last one, which is cut short")
        return data[:-1]
    if end < len(data):
        notes.append(f"left out: {len(data) - end} lines of words after the last sample, row {data[end][0]} on")
    return data[:end]


def _check_rows(path: Path, header: list[str], data: Sequence[_Row], separator: str | None) -> list[str]:
    """The names, after checking that every row has one cell for each; a separator at a row's end is taken off."""
    if len(header) > 1 and not header[-1] and all(len(row) < len(header) or not row[-1] for _, row in data):
        header = header[:-1]
    width = len(header)
    for number, row in data:
        if len(row) == width + 1 and not row[-1]:
            row.pop()
        if len(row) == width:
            if row == header:
                raise DatasetError(
                    f"{path}: expected one recording, got a second line of names in row {number}; cut the file there"
                )
            continue
        remedy = "complete the row, or export again with one separator between columns"
        if separator == "," and len(row) > width:
            remedy = (
                "where commas are decimal marks, too, export with semicolons between columns or with decimal points"
            )
        raise DatasetError(f"{path}: expected {width} cells in row {number}, got {len(row)}; {remedy}")
    repeated = sorted({name for name in header if name and header.count(name) > 1})
    if repeated:
        raise DatasetError(f"{path}: expected column names once each, got {repeated} more than once; rename them")
    return header
