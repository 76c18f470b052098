"""Load tests and passages in a report: what it shows is what their files hold, in both languages."""

import re

import html5lib
import numpy as np
import pytest

from run_folders import write_run
from vfm_sdm.analysis.load_test import (
    LoadPlan,
    LoadStep,
    Passage,
    judge_load_test,
    judge_passages,
    read_axles,
    read_load_test,
    read_passages_of_run,
    write_load_test,
    write_passages,
)
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.outputs.report import write_report

TAG = "{http://www.w3.org/1999/xhtml}"
LEVELS = [(0.0, 4.0), (5.0, 9.0), (10.0, 14.0)]
PASSAGE = Passage(20.0, 24.0, 8.0)


def history(seconds):
    """A level that comes and goes, and a half sine with a vibration on it that dies away."""
    level = np.interp(seconds, [4, 5, 9, 10], [0, 1, 1, 0.05])
    share = np.clip((seconds - PASSAGE.begin_s) / (PASSAGE.end_s - PASSAGE.begin_s), 0, 1)
    since = np.clip(seconds - PASSAGE.begin_s, 0, None)
    return level + 0.8 * np.sin(np.pi * share) + 0.08 * np.sin(2 * np.pi * 4 * since) * np.exp(-0.15 * since)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("load test")
    write_run(folder, moving=3, duration_s=32.0, motion=history, names=("mid & <span>",))
    displacement = read_displacement(folder)
    loads = zip((0.0, 240.0, 0.0), (0.0, 2.5, 0.0), LEVELS, strict=True)
    steps = tuple(LoadStep(load, *times, {("p1", "vertical"): value}) for load, value, times in loads)
    write_load_test(folder, judge_load_test(displacement, LoadPlan(steps, "kN")))
    write_passages(folder, judge_passages(displacement, [PASSAGE], axles=read_axles("0:60,3.2:100")))
    return folder


@pytest.fixture(scope="module", params=["en", "de"])
def page(run, request, tmp_path_factory):
    path, *_ = write_report(run, tmp_path_factory.mktemp("out") / "r.html", language=request.param)
    text = path.read_text(encoding="utf-8")
    return html5lib.HTMLParser(strict=True).parse(text), request.param == "de", text


def rows_under(root, words):
    """Cells (text, value or None) of the table whose caption begins with these words."""
    for table in root.iter(f"{TAG}table"):
        if "".join(table.find(f"{TAG}caption").itertext()).startswith(words):
            return [
                [
                    ("".join(cell.itertext()), None if (one := cell.find(f"{TAG}data")) is None else one.get("value"))
                    for cell in row
                ]
                for row in table.find(f"{TAG}tbody")
            ]
    raise AssertionError(words)


def test_steps_are_those_of_the_file(run, page):
    root, german, _ = page
    rows = rows_under(root, "Laststufen, vertikal" if german else "Steps along vertical")
    result = read_load_test(run).sel(axis="vertical")
    assert len(rows) == 3 * 3  # static points stand in the file
    first = next(n for n, row in enumerate(rows) if row[0][0] == "p1")
    for number, row in enumerate(rows[first : first + 3]):
        one = result.sel(point="p1").isel(step=number)
        assert float(row[3][1]) == pytest.approx(float(one["deflection"]))
        assert float(row[4][1]) == pytest.approx(float(one["calculated"]))
    ratio = float(result["ratio"].sel(point="p1", step=2))
    assert float(rows[first + 1][5][1]) == pytest.approx(ratio)
    assert rows[first + 1][5][0] == f"{ratio:.3f}".replace(".", "," if german else ".")


def test_what_remains_is_that_of_the_file(run, page):
    root, german, _ = page
    rows = rows_under(root, "Bleibende" if german else "What remains")
    (row,) = [row for row in rows if row[0][0] == "p1"]
    one = read_load_test(run).sel(point="p1", axis="vertical")
    assert float(row[3][1]) == pytest.approx(100 * float(one["residual_share"]))
    assert float(one["residual_share"]) == pytest.approx(0.05, abs=2 * float(one["share_high"] - one["share_low"]))


def test_passages_are_those_of_the_file(run, page):
    root, german, text = page
    rows = rows_under(root, "Überfahrten, vertikal" if german else "Passages along vertical")
    (row,) = [row for row in rows if row[0][0] == "p1"]
    one = read_passages_of_run(run).sel(point="p1", axis="vertical").isel(passage=0)
    assert float(row[5][1]) == pytest.approx(float(one["amplification"]))
    assert float(one["amplification"]) == pytest.approx(1.08, abs=0.04)
    assert float(row[2][1]) == pytest.approx(28.8)
    assert ("Einflusslinien" if german else "Influence lines") in text
    # A drawing for the loads, one for the lines.
    assert len(re.findall('aria-label="(?:Durchbiegung|deflection|Verschiebung über|displacement against)', text)) == 2


def test_static_points_are_left_out_and_told_where_they_moved(page):
    _, german, text = page
    assert text.count("Festpunkte sind weggelassen: 3" if german else "Points that must not move are left out: 3") == 2
    assert ("hat sich in Stufe" if german else "mm along vertical in step") not in text


def test_the_frequency_and_where_it_is_from_are_told(run, page):
    _, german, text = page
    known = read_passages_of_run(run)["frequency"].sel(axis="vertical", point=["mid & <span>", "p1", "p2"]).values
    assert known == pytest.approx(4.0, abs=0.1)
    words = "Eigenfrequenz, vertikal: " if german else "Natural frequency along vertical: "
    (told,) = re.findall(re.escape(words) + "([0-9.,]+)", text)
    assert float(told.replace(",", ".")) == pytest.approx(known.min(), abs=0.005)
    assert ("gefunden als" if german else "found as the strongest") in text


def test_without_their_files_nothing_is_said(run, page, tmp_path):
    write_run(tmp_path / "plain", moving=2)
    path, *_ = write_report(tmp_path / "plain", tmp_path / "plain.html")
    assert "Load test" not in path.read_text(encoding="utf-8")
