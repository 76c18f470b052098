"""Catalogue, numbers and drawings of reports."""

import re
from datetime import date
from pathlib import Path
from string import Formatter

import html5lib
import numpy as np
import pytest

from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.outputs.report import LANGUAGES, find_language
from vfm_sdm.outputs.report.drawing import Drawing, Panel, nice_ticks, shorten, span_of
from vfm_sdm.outputs.report.language import count_decimals
from vfm_sdm.outputs.report.texts import CATALOGUE
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS

ROOT = Path(__file__).parents[4]


def gaps(text):
    return sorted(name for _, name, _, _ in Formatter().parse(text) if name is not None)


def test_every_text_is_there_in_both_languages_with_the_same_gaps():
    for key, texts in CATALOGUE.items():
        assert len(texts) == len(LANGUAGES), key
        assert gaps(texts[0]) == gaps(texts[1]), key
        assert all(texts), key


def test_every_text_that_is_asked_for_is_there():
    source = "".join(path.read_text() for path in (ROOT / "src/vfm_sdm/outputs/report").rglob("*.py"))
    asked = set(re.findall(r'\.say\(\s*"([^"]+)"', source))
    assert len(asked) > 60
    assert asked - CATALOGUE.keys() == set()


def test_words_of_results_are_known():
    known = [f"verdict {one}" for one in Verdict] + [f"advice {one}" for one in Verdict]
    known += [f"outcome {one}" for one in Outcome]
    known += [f"component{short} {one}" for one in COMPONENTS for short in ("", " short")]
    # The manual lists the checks.
    table = (ROOT / "docs" / "audit.md").read_text(encoding="utf-8").split("## The checks")[1].split("## What the")[0]
    checks = re.findall(r"^\| ([a-z -]+) \| ", table, re.MULTILINE)[1:]
    assert len(checks) > 20
    known += [f"{kind} {check}" for check in checks for kind in ("check", "todo")]
    assert [key for key in known if key not in CATALOGUE] == []


def test_an_unknown_word_stays_as_it_is():
    assert find_language("de").word("check", "my own check") == "my own check"


@pytest.mark.parametrize(
    ("value", "decimals", "english", "german"),
    [
        (1234.5, 1, "1234.5", "1234,5"),
        (-12345.678, 2, "−12\u202f345.68", "−12\u202f345,68"),
        (-0.001, 2, "0.00", "0,00"),
        (0.0, 0, "0", "0"),
        (float("nan"), 2, "–", "–"),
        (None, 2, "–", "–"),
        (float("inf"), 2, "–", "–"),
    ],
)
def test_numbers_are_written_as_the_language_does(value, decimals, english, german):
    assert (find_language("en").write(value, decimals), find_language("de").write(value, decimals)) == (english, german)


@pytest.mark.parametrize(
    ("value", "decimals"),
    [(0.146, 2), (0.0123, 3), (0.0996, 2), (9.96, 0), (1234.0, 0), (-0.5, 2), (1e-12, 9), (0.0, 2), (np.nan, 2)],
)
def test_decimals_follow_significant_digits(value, decimals):
    assert count_decimals(value, 2) == decimals


def test_dates_are_written_as_the_language_does():
    assert find_language("de").day(date(2026, 3, 1)) == "1. März 2026"


def test_texts_in_drawings_are_escaped():
    drawing = Drawing(40, 'a "label" <b>')
    drawing.text(1, 2, "<script>&'\"", halo="white")
    drawing.text(1, 2, "a\ufffeb")
    page = f'<!DOCTYPE html><html lang="en"><head><title>x</title></head><body>{drawing.svg()}</body></html>'
    root = html5lib.HTMLParser(strict=True).parse(page)
    assert "<script" not in page
    texts = ["".join(one.itertext()) for one in root.iter("{http://www.w3.org/2000/svg}text")]
    assert texts == ["<script>&'\""] * 2 + ["a\ufffdb"]


def test_panels_place_values_and_break_lines_at_gaps():
    drawing = Drawing(100, "line")
    panel = Panel(drawing, (10, 10, 110, 90), (0.0, 1.0), (-1.0, 1.0), find_language("en"))
    assert panel.place([0.0, 1.0], [-1.0, 1.0]).tolist() == [[10, 90], [110, 10]]
    values = np.array([0.0, 1.0, np.nan, 0.5, np.nan, 0.0, 0.2])
    panel.curve(np.linspace(0, 1, 7), values, values, "#000000")
    assert (drawing.svg().count("<polyline"), drawing.svg().count("<circle")) == (2, 1)


@pytest.mark.parametrize("span", [(0, 1), (-3.3, 7.9), (1e-6, 2e-6), (0, 86400), (99.9, 100.1)])
def test_ticks_are_round_and_few(span):
    ticks = nice_ticks(*span, about=4)
    assert 2 <= len(ticks) <= 8
    assert span[0] <= ticks[0] < ticks[-1] <= span[1] * (1 + 1e-9)


def test_spans_of_nothing_and_of_a_constant_can_be_drawn():
    assert span_of([np.full(3, np.nan)]) == (-0.5, 0.5)
    low, high = span_of([np.full(3, 2.0)])
    assert low < 2 < high
    assert nice_ticks(1.0, 1.0) == [1.0]
    assert shorten("short", 100) == "short"
