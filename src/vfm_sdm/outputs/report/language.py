"""The language of a report: its texts, and how it writes numbers and dates."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np

from vfm_sdm.errors import ResultsError
from vfm_sdm.outputs.report.content import Cell, Listed
from vfm_sdm.outputs.report.sentences import Forms, Told
from vfm_sdm.outputs.report.texts import CATALOGUE
from vfm_sdm.outputs.report.texts_of_checks import CHECK_FORMS, THING_FORMS
from vfm_sdm.outputs.report.texts_of_fusion import FUSION_FORMS, FUSION_THINGS
from vfm_sdm.outputs.report.texts_of_notes import NOTE_FORMS

__all__ = ["LANGUAGES", "UNKNOWN", "Language", "count_decimals", "find_language"]

UNKNOWN = "–"
"""Stands where nothing is known."""
_GROUP = "\u202f"
"""Between groups of three digits; a comma or a dot is a decimal sign to readers of the other language."""
_MINUS = "\u2212"
_MOST_DECIMALS = 9
_FIRST_GROUPED = 10_000


@dataclass(frozen=True)
class Language:
    """A language.

    Parameters
    ----------
    code
        As in HTML, such as ``en``.
    place
        Its place in the catalogue's texts.
    decimal_sign
        Between the whole and the parts of a number.
    months
        Names of the months.
    day_form
        How day, month and year stand together.
    """

    code: str
    place: int
    decimal_sign: str
    months: tuple[str, ...]
    day_form: str

    def say(self, key: str, **values: object) -> str:
        """The text of a key, with values in its gaps.

        Parameters
        ----------
        key
            Key in the catalogue.
        values
            What the gaps hold.
        """
        return CATALOGUE[key][self.place].format(**values)

    def word(self, prefix: str, name: str) -> str:
        """A word that stands in the catalogue under ``prefix name``; others, such as of other packages, as they are.

        Parameters
        ----------
        prefix
            What the words belong to, such as ``check``.
        name
            The word.
        """
        texts = CATALOGUE.get(f"{prefix} {name}")
        return name if texts is None else texts[self.place]

    def tell(self, sentence: str) -> Told:
        """A sentence of the program, which writes English; clauses that no form fits stay as they are.

        Parameters
        ----------
        sentence
            The sentence, such as that of a check.

        Examples
        --------
        >>> find_language("de").tell("known to 2.5 % (k = 2); as a check of mine says")
        Told(text='bekannt auf 2,5 % (k = 2); as a check of mine says', left=('as a check of mine says',))
        """
        return Told(sentence) if self.code == "en" else _german_forms().tell(sentence)

    def name(self, things: str) -> str:
        """Places and things, as sentences of the program name them.

        Parameters
        ----------
        things
            Their names, with commas between.

        Examples
        --------
        >>> find_language("de").name("lateral of mid, focal left")
        'quer von mid, Brennweite left'
        """
        return things if self.code == "en" else _german_forms().name(things)

    def listed(self, told: Iterable[Told]) -> Iterator[Listed]:
        """Sentences as lists, those that stay English in lists of their own.

        Parameters
        ----------
        told
            The sentences.
        """
        for foreign, some in groupby(told, lambda one: bool(one.left)):
            yield Listed(tuple(one.text for one in some), foreign=foreign)

    def write(self, value: float | None, decimals: int) -> str:
        """A number with so many decimals, in this language.

        Parameters
        ----------
        value
            The number.
        decimals
            Decimals.

        Examples
        --------
        >>> find_language("de").write(-0.5, 2), find_language("en").write(None, 2)
        ('−0,50', '–')
        """
        if value is None or not np.isfinite(value):
            return UNKNOWN
        shown = round(float(value), decimals)
        grouping = "," if abs(shown) >= _FIRST_GROUPED else ""
        text = f"{shown:{grouping}.{max(decimals, 0)}f}".replace(",", _GROUP).replace(".", self.decimal_sign)
        # What is rounded to nothing has no sign.
        return text.replace("-", _MINUS if shown else "")

    def cell(self, value: float | None, decimals: int, units: str = "") -> Cell:
        """A number as a cell of a table.

        Parameters
        ----------
        value
            The number; ``None`` or NaN where it is not known.
        decimals
            As in `write`.
        units
            Its unit, where the column does not name it.
        """
        if value is None or not np.isfinite(value):
            return Cell(UNKNOWN)
        return Cell(self.write(value, decimals) + (f" {units}" if units else ""), float(value))

    def digits(self, value: float | None, digits: int = 3, units: str = "") -> Cell:
        """A number with so many significant digits.

        Parameters
        ----------
        value
            The number.
        digits
            Significant digits.
        units
            Its unit, where the column does not name it.

        Examples
        --------
        >>> find_language("de").digits(0.01234, 2, "mm").text
        '0,012 mm'
        """
        return self.cell(value, count_decimals(value, digits), units)

    def day(self, day: date) -> str:
        """A date in words.

        Parameters
        ----------
        day
            The date.

        Examples
        --------
        >>> find_language("en").day(date(2026, 11, 20)), find_language("de").day(date(2026, 11, 20))
        ('20 November 2026', '20. November 2026')
        """
        return self.day_form.format(day=day.day, month=self.months[day.month - 1], year=day.year)


def count_decimals(value: float | None, digits: int = 2) -> int:
    """Decimals with which a number has so many significant digits.

    Parameters
    ----------
    value
        The number; of what is not known or zero, two decimals.
    digits
        Significant digits.

    Examples
    --------
    >>> count_decimals(0.146), count_decimals(146.0), count_decimals(0.0)
    (2, 0, 2)
    """
    if value is None or not np.isfinite(value) or value == 0:
        return 2
    places = digits - 1 - int(np.floor(np.log10(abs(value))))
    # 0.0996 with two digits is 0.10 and not 0.100.
    if round(abs(value), places) >= 10 ** (digits - places):
        places -= 1
    return min(max(places, 0), _MOST_DECIMALS)


@cache
def _german_forms() -> Forms:
    """Forms of all sentences; many patterns, made when they are first needed."""
    return Forms(
        {**CHECK_FORMS, **NOTE_FORMS, **FUSION_FORMS}, {**THING_FORMS, **FUSION_THINGS}, LANGUAGES["de"].decimal_sign
    )


_MONTHS: Mapping[str, tuple[str, ...]] = {
    "en": (
        *("January", "February", "March", "April", "May", "June", "July"),
        *("August", "September", "October", "November", "December"),
    ),
    "de": (
        *("Januar", "Februar", "März", "April", "Mai", "Juni", "Juli"),
        *("August", "September", "Oktober", "November", "Dezember"),
    ),
}
LANGUAGES: Mapping[str, Language] = {
    "en": Language("en", 0, ".", _MONTHS["en"], "{day} {month} {year}"),
    "de": Language("de", 1, ",", _MONTHS["de"], "{day}. {month} {year}"),
}


def find_language(code: Any) -> Language:
    """The language of a code.

    Parameters
    ----------
    code
        ``en`` or ``de``.

    Raises
    ------
    ResultsError
        There is no such language.
    """
    if code not in LANGUAGES:
        raise ResultsError(f"language: expected one of {', '.join(LANGUAGES)}, got {code!r}; choose one")
    return LANGUAGES[code]
