"""Sentences of the program in a report's language: a sentence is found by its form, clause by clause."""

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from string import Formatter
from typing import NamedTuple

__all__ = ["Forms", "Told"]

_CUT = re.compile(r"; |: |\. |, | \(|\)")
"""Where clauses are joined."""
_GAPS = {
    # Names, and lists of places, are parts of one clause; a number is one; what is said may be anything.
    "": r"((?:(?!; |: ).)+?)",
    "what": r"((?:(?!; |: ).)+?)",
    "n": r"([+-]?(?:\d[\d.]*(?:e[+-]?\d+)?|inf|nan))",
    "say": r"(.+?)",
}


class Told(NamedTuple):
    """A sentence in a reader's language.

    Parameters
    ----------
    text
        The sentence.
    left
        Clauses of it that no form fits, and that stay as they were.
    """

    text: str
    left: tuple[str, ...] = ()

    def after(self, words: str) -> "Told":
        """The sentence after words that are in the reader's language already.

        Parameters
        ----------
        words
            The words.
        """
        return Told(words + self.text, self.left)


class _Form(NamedTuple):
    """Pattern of a form, name and kind of its gaps, and its translation."""

    pattern: re.Pattern[str]
    gaps: tuple[tuple[str, str], ...]
    text: str


class Forms:
    """Forms of sentences, and of places and things in their gaps, with their translations.

    Parameters
    ----------
    sentences
        Translation by form. Gaps of a form are ``{name}`` for names, which stay as they are, ``{name:n}`` for numbers,
        ``{name:what}`` for places and things, and ``{name:say}`` for further clauses; the translation has ``{name}``.
    things
        Translation by form of places and things, such as ``focal {view}``.
    decimal_sign
        Between the whole and the parts of a number.

    Examples
    --------
    >>> forms = Forms({"{point} lacks {share:n} %": "{point} fehlen {share} %"}, {}, ",")
    >>> forms.tell("'a' lacks 2.5 %; look there")
    Told(text="'a' fehlen 2,5 %; look there", left=('look there',))
    """

    def __init__(self, sentences: Mapping[str, str], things: Mapping[str, str], decimal_sign: str) -> None:
        self._sentences, self._things = _compile(sentences), _compile(things)
        self._decimal_sign = decimal_sign

    def tell(self, text: str) -> Told:
        """A sentence: the longest form that fits from its beginning, and then the rest of it.

        Parameters
        ----------
        text
            The sentence.
        """
        if (whole := self._fit(text, self._sentences)) is not None:
            return whole
        cuts = list(_CUT.finditer(text))
        for cut in reversed(cuts):
            if (head := self._fit(text[: cut.start()], self._sentences)) is not None:
                return _join(head, cut.group(), self.tell(text[cut.end() :]))
        end, begin = cuts[0].span() if cuts else (len(text), len(text))
        head = self._fit(text[:end], self._things) or Told(text[:end], _list_words(text[:end]))
        return _join(head, text[end:begin], self.tell(text[begin:]) if cuts else Told(""))

    def name(self, text: str) -> str:
        """Places and things, as they stand in gaps.

        Parameters
        ----------
        text
            Their names, with commas between; what no form fits stays as it is.
        """
        first, _, rest = text.partition(", ")
        # A comma may also be a part of a name.
        if any(self._fit(rest.partition(", ")[0], forms) is not None for forms in (self._things, self._sentences)):
            return f"{self.name(first)}, {self.name(rest)}"
        if (whole := self._fit(text, self._things)) is not None:
            return whole.text
        if rest:
            return f"{self.name(first)}, {self.name(rest)}"
        if text[:1].isupper() and (small := text[:1].lower() + text[1:]) != (said := self.name(small)):
            return said[:1].upper() + said[1:]
        return self.tell(text).text

    def _fit(self, text: str, forms: Sequence[_Form]) -> Told | None:
        """A text of which a form fits the whole; ``None`` where none does."""
        for form in forms:
            if (found := form.pattern.fullmatch(text)) is not None:
                told = [self._fill(kind, value) for (_, kind), value in zip(form.gaps, found.groups(), strict=True)]
                filled = {name: one.text for (name, _), one in zip(form.gaps, told, strict=True)}
                return Told(form.text.format(**filled), sum((one.left for one in told), ()))
        return None

    def _fill(self, kind: str, value: str) -> Told:
        """What stands in a gap."""
        if kind == "say":
            return self.tell(value)
        if kind == "what":
            return Told(self.name(value))
        if kind == "n" and value.strip("+-")[:1].isdigit():
            return Told(format(Decimal(value), "f").replace(".", self._decimal_sign))
        return Told(value)


def _list_words(clause: str) -> tuple[str, ...]:
    """A clause, unless it is a number or the name of something."""
    return (clause,) if re.search("[A-Za-z]", clause) and not re.fullmatch("(['\"]).*\\1", clause) else ()


def _join(head: Told, between: str, rest: Told) -> Told:
    return Told(head.text + between + rest.text, head.left + rest.left)


def _compile(forms: Mapping[str, str]) -> tuple[_Form, ...]:
    """Forms as patterns, those with the most words of their own first."""
    found = []
    for english, text in forms.items():
        parts = list(Formatter().parse(english))
        pattern = "".join(
            re.escape(words) + ("" if name is None else _GAPS[kind or ""]) for words, name, kind, _ in parts
        )
        gaps = tuple((name, kind or "") for _, name, kind, _ in parts if name is not None)
        found.append((sum(len(words) for words, *_ in parts), _Form(re.compile(pattern, re.DOTALL), gaps, text)))
    return tuple(form for _, form in sorted(found, key=lambda pair: -pair[0]))
