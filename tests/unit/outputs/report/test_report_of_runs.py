"""Reports of simulated measurements: what they show is what the run folder holds, in both languages."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html import unescape
from importlib.util import find_spec

import html5lib
import numpy as np
import pytest
import xarray as xr

from fields import draw_field
from plugins import installed
from run_folders import write_run
from vfm_sdm.analysis.evaluation import Evaluation, EvaluationRow, write_evaluation
from vfm_sdm.analysis.evaluation.metrics import score as compute_score
from vfm_sdm.analysis.field import compute_field, read_field, write_field
from vfm_sdm.core.netcdf import read_displacement, write_dataset
from vfm_sdm.core.registry import part_names
from vfm_sdm.errors import BackendUnavailableError, ResultsError, SessionError
from vfm_sdm.inputs.session import write_session
from vfm_sdm.outputs.report import build_content, find_language, open_run, to_html, write_report
from vfm_sdm.outputs.report import inputs as report_inputs

NAMES = ("<script>alert(1)</script>", 'pier & "quote" #let x = $y$ *b* `c` @d')
REPORT = {
    "client": "<b>City</b> & sons #panic()",
    "project": "load test \\ {braces} $ _ *",
    "place": "Köln",
    "date": "2026-11-20",
    "measured_by": "A. B.",
    "weather": "5 °C",
    "remarks": "closed to traffic\nsecond line",
}
EXPECTED = {
    **dict.fromkeys(("random", "cameras", "synchronization", "origin"), True),
    # Nothing was refined, and there are no films.
    **dict.fromkeys(("assumption", "compression", "subset"), False),
}
"""Components that there is something to tell from."""
ELSEWHERE = {"fusion", "load-test", "passages", "repeatability"}
"""Sections of analyses that have tests of their own, and that this run has no files of."""
MOST_BYTES = 5_000_000
TAG = "{http://www.w3.org/1999/xhtml}"


def make_modes(names):
    """Two modes with complex shapes."""
    rng = np.random.default_rng(5)
    shape = rng.normal(size=(2, len(names), 3)) + 1j * rng.normal(size=(2, len(names), 3))
    return xr.Dataset(
        {
            "frequency": ("mode", [2.5, 6.125], {"units": "Hz"}),
            "frequency_std": ("mode", [0.012, 0.05], {"units": "Hz"}),
            "damping_ratio": ("mode", [0.011, 0.02], {"units": "1"}),
            "shape": (("mode", "point", "axis"), shape, {"units": "1"}),
        },
        coords={"point": names, "axis": ["lateral", "vertical", "longitudinal"]},
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder with all that a report can hold but films, in a place with blanks and letters of another kind."""
    folder = tmp_path_factory.mktemp("a rün [1]")
    write_run(folder, moving=3, names=NAMES, report=REPORT)
    displacement = read_displacement(folder)
    names = [str(name) for name in displacement["point"].values]
    rows = []
    for axis in ("lateral", "vertical"):
        values = displacement["displacement"].sel(point=names[1], axis=axis).values
        score = compute_score(values, 1.02 * values + 0.01)
        rows.append(EvaluationRow(names[1], axis, score, float(np.ptp(values)), 1.02 * float(np.ptp(values)), 0.0123))
    write_evaluation(folder, Evaluation(tuple(rows), None, (1.0, 10.0), "accelerometers <&>", ("one <note>",)))
    write_dataset(folder / "modes.nc", make_modes(names))
    field = compute_field(draw_field(2, points=60, frames=45).displacement, stations=9)
    marks = {"key": displacement.attrs["key"]} if "key" in displacement.attrs else {}
    write_field(folder, field.assign_attrs(marks), [0.5])
    return folder


@pytest.fixture
def copied(run, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(run, tmp_path / "run")


@pytest.fixture(scope="module", params=["en", "de"])
def page(run, request, tmp_path_factory):
    """The report as read by a strict parser of HTML, its language, and its text."""
    path, *_ = write_report(run, tmp_path_factory.mktemp("out") / "r.html", language=request.param)
    text = path.read_text(encoding="utf-8")
    return html5lib.HTMLParser(strict=True).parse(text), request.param, text


def read_number(text, language):
    """A number as people read it, and the value of its last digit."""
    digits = text.replace("\u202f", "").replace("\u2212", "-")
    digits = digits.replace(",", ".") if language == "de" else digits
    found = re.search(r"-?\d+(\.\d*)?", digits)
    decimals = len(found.group(1) or ".") - 1
    return float(found.group()), 10.0**-decimals


def tables(root):
    """Rows of cells (text, value or None) by the words of each table's caption."""
    found = {}
    for table in root.iter(f"{TAG}table"):
        rows = []
        for row in table.find(f"{TAG}tbody"):
            data = [cell.find(f"{TAG}data") for cell in row]
            rows.append(
                [
                    ("".join(cell.itertext()), None if one is None else float(one.get("value")))
                    for cell, one in zip(row, data, strict=True)
                ]
            )
        found["".join(table.find(f"{TAG}caption").itertext())] = rows
    return found


def table_of(page, english, german):
    root, language, _ = page
    begin = {"en": english, "de": german}[language]
    return next(rows for caption, rows in tables(root).items() if caption.startswith(begin))


def uncertainty(text, language):
    """The number behind the sign."""
    return read_number(text.split("±")[1], language)


def test_every_shown_number_is_the_one_it_was_rounded_from(page):
    root, language, _ = page
    checked = 0
    for data in root.iter(f"{TAG}data"):
        shown, last = read_number("".join(data.itertext()), language)
        assert abs(shown - float(data.get("value"))) <= 0.5 * last + 1e-12, "".join(data.itertext())
        checked += 1
    assert checked > 250


def test_results_are_those_of_the_dataset(run, page):
    """By NumPy alone, from the file."""
    data, language = read_displacement(run), page[1]
    summary = json.loads((run / "summary.json").read_text())["points"]
    rows = iter(table_of(page, "Displacement in mm", "Verschiebung in mm"))
    time_s = data["time"].values
    for point in data["point"].values:
        for axis in data["axis"].values:
            one = data.sel(point=point, axis=axis)
            values, half = one["displacement"].values, one["expanded_uncertainty"].values
            kept = summary[str(point)]["axes"][str(axis)]
            name, _, span, top, top_s, low, low_s, rms, _, hertz = next(rows)
            assert name[0].removesuffix(" *") == point
            assert span[1] == pytest.approx(np.ptp(values), rel=1e-12) == kept["peak_to_peak_mm"]
            assert top[1] == values.max()
            assert low[1] == values.min()
            assert top_s[1] == time_s[values.argmax()]
            assert low_s[1] == time_s[values.argmin()]
            assert rms[1] == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-12)
            assert hertz[1] == kept["dominant_frequency_hz"]
            stated = (
                (span, kept["expanded_uncertainty_mm"]),
                (top, half[values.argmax()]),
                (low, half[values.argmin()]),
            )
            for cell, expanded in stated:
                shown, last = uncertainty(cell[0], language)
                assert abs(shown - expanded) <= 0.5 * last + 1e-12
    assert next(rows, None) is None


def test_quality_and_budget_are_those_of_the_dataset(run, page):
    data = read_displacement(run)
    axes, points = data["axis"].values, data["point"].values
    for cells, point in zip(table_of(page, "Quality", "Güte"), points, strict=True):
        one = data.sel(point=point)
        values = [cell[1] for cell in cells]
        assert values[1] == 100
        assert values[2:5] == pytest.approx([float(one["displacement_std"].sel(axis=a).median()) for a in axes])
        assert values[8:11] == pytest.approx([200 * float(one["scale_std"].sel(axis=a)) for a in axes])
    rms = np.sqrt((data["uncertainty"] ** 2).mean("time"))
    for cells, (point, axis) in zip(
        table_of(page, "Components", "Anteile"), [(p, a) for p in points for a in axes], strict=True
    ):
        budget = rms.sel(point=point, axis=axis).values
        told = data["uncertainty_estimated"].sel(point=point).values
        shown = [value if known else None for value, known in zip(budget, told, strict=True)]
        assert [cell[1] for cell in cells[2:9]] == pytest.approx(shown)
        assert dict(zip(data["component"].values.tolist(), told.tolist(), strict=True)) == EXPECTED
        combined = float(np.sqrt(np.sum(budget**2)))
        assert [cell[1] for cell in cells[9:]] == pytest.approx([combined, 2 * combined])


def test_the_stated_limit_of_the_scale_is_that_of_all_points_and_axes(copied):
    file = copied / "summary.json"
    summary = json.loads(file.read_text(encoding="utf-8"))
    with open_run(copied) as inputs:
        moving = [point for point in inputs.point_names if point not in inputs.static]
        stds = inputs.displacement["scale_std"].sel(point=moving)
        worst = stds.where(stds == stds.max(), drop=True)
        # The audit leaves axes out that nobody judges, and its worst may be a better one.
        judged = {**summary["scale"], "expanded_uncertainty": float(stds.min())}
        language = find_language("en")
        said = language.digits(200 * float(stds.max()), 2, "%").text
        spoiled = replace(inputs, summary={**summary, "scale": judged})
        page = to_html(build_content(spoiled, language))
    assert f"known to {said} (k = 2, {worst['axis'].item()} of {worst['point'].item()}" in unescape(page)


def test_value_times_sensitivity_is_the_contribution(page):
    root, language, _ = page
    checked = 0
    captions = ("vertical displacement of", "Verschiebung vertikal von")
    rows = next(rows for caption, rows in tables(root).items() if caption.startswith(captions))
    for _, value, _, sensitivity, contribution in rows[:-2]:
        if value[1] is not None and sensitivity[1] is not None:
            assert value[1] * sensitivity[1] == pytest.approx(contribution[1], abs=1e-12)
            checked += value[1] > 0
    assert checked >= 3
    total = np.sqrt(sum((row[4][1] or 0.0) ** 2 for row in rows[:-2]))
    assert rows[-2][4][1] == pytest.approx(total)
    assert rows[-1][4][1] == pytest.approx(2 * total)
    assert language in ("en", "de")


def test_audit_comparison_and_modes_are_those_of_the_files(run, page):
    summary = json.loads((run / "summary.json").read_text())
    for cells, check in zip(
        table_of(page, "Checks that need", "Prüfungen, die"), summary["audit"]["checks"], strict=True
    ):
        assert cells[3][1] == check["figure"]
        assert cells[4][1] == (check["limit"] if (check["limit"] or 0) > 1e-6 else None)
    evaluation = json.loads((run / "evaluation.json").read_text())
    for cells, row in zip(table_of(page, "NRMSE", "NRMSE"), evaluation["rows"], strict=True):
        score = row["score"]
        assert cells[0][0] == row["point"]
        assert [cell[1] for cell in cells[2:5]] == [
            *(row[f"{side}_peak_to_peak_mm"] for side in ("estimate", "reference")),
            row["rms_error_mm"],
        ]
        assert [cell[1] for cell in cells[5:9]] == [score[n] for n in ("nrmse_range", "correlation", "rppae", "gain")]
    modes = table_of(page, "Natural", "Eigenfrequenzen")
    assert [row[1][1] for row in modes] == [2.5, 6.125]
    assert [row[2][1] for row in modes] == pytest.approx([1.1, 2.0])
    assert uncertainty(modes[0][1][0], page[1])[0] == 0.024
    shapes = table_of(page, "Shapes", "Eigenformen:")
    expected = np.abs(make_modes(["a"] * 6)["shape"].values).reshape(2, -1).T
    assert np.array([[cell[1] for cell in row[2:]] for row in shapes]) == pytest.approx(expected)


def test_hashes_and_settings_stand_in_it(run, page):
    summary = json.loads((run / "summary.json").read_text())
    text = page[2]
    for stated in (summary["session_hash"], summary["session_file"], summary["system"]["platform"]):
        assert stated in text
    assert all(f"{name} {version}" in text for name, version in summary["versions"].items())


def test_names_stay_text(page):
    root, _, text = page
    assert "<script" not in text
    assert "<b>City" not in text
    words = "".join(root.find(f"{TAG}body").itertext())
    for said in (*NAMES, REPORT["client"], REPORT["project"], "accelerometers <&>", "one <note>", "second line"):
        assert said in words
    assert ("20 November 2026" in words) or ("20. November 2026" in words)


def test_nothing_is_fetched_or_run(page):
    _, _, text = page
    assert set(re.findall(r"https?://[^\s\"'<)]*", text)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"\bsrc=|@import|url\(|<link|<iframe|<object|<form|\bon\w+=", text)
    assert len(text.encode()) < MOST_BYTES


def test_the_field_is_that_of_its_file(run, page):
    field = read_field(run).sel(axis="vertical")
    line = table_of(page, "Line at the times", "Linie zu den Zeiten")
    assert [row[0][1] for row in line] == pytest.approx(field["station"].values.tolist())
    row = int(np.nanargmax(field["displacement"].values) // field.sizes["station"])
    column = 1 + int(row > np.nanargmin(field["displacement"].values) // field.sizes["station"])
    assert [cells[column][1] for cells in line] == pytest.approx(field["displacement"].values[row].tolist())


def test_headings_and_drawings_are_named(page):
    root, language, _ = page
    assert root.get("lang") == language
    assert len(list(root.iter(f"{TAG}h2"))) == len({*part_names("sections")} - ELSEWHERE)
    drawings = list(root.iter("{http://www.w3.org/2000/svg}svg"))
    assert len(drawings) >= 8
    assert all(one.get("aria-label") for one in drawings)


def test_pdf_has_all_sections_and_keeps_names_as_text(run, tmp_path):
    pytest.importorskip("typst")
    html, pdf = write_report(run, tmp_path / "r.html", pdf=True, language="de")
    content = pdf.read_bytes()
    assert html.exists()
    assert content.startswith(b"%PDF")
    assert 20_000 < len(content) < MOST_BYTES
    if (reader := shutil.which("pdftotext")) is None:
        return
    text = subprocess.run([reader, "-layout", pdf, "-"], capture_output=True, check=True).stdout.decode()
    pages = text.split("\f")[:-1]
    assert len(pages) >= 6
    assert all(f"Seite {n} / {len(pages)}" in page for n, page in enumerate(pages, start=1))
    for said in (NAMES[0], REPORT["client"], "11 Eigenformen", "12 Rückverfolgbarkeit"):
        assert said in text


def test_pdf_alone_where_the_file_is_called_so(run, tmp_path):
    pytest.importorskip("typst")
    assert [path.name for path in write_report(run, tmp_path / "only.pdf")] == ["only.pdf"]
    assert [path.name for path in tmp_path.iterdir()] == ["only.pdf"]


def test_without_typst_the_error_says_what_to_install(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(BackendUnavailableError, match=r"expected the package typst, got none; pip install 'vfm-sdm"):
        write_report(run, tmp_path / "r.html", pdf=True)
    assert list(tmp_path.iterdir()) == []
    assert write_report(run, tmp_path / "r.html")


def test_missing_pieces_are_left_out_or_said(copied):
    (copied / "evaluation.json").unlink()
    (copied / "modes.nc").unlink()
    text = write_report(copied)[0].read_text(encoding="utf-8")
    assert "Comparison with a reference" not in text
    assert "Modes" not in text
    assert "the recording was not at hand when this report was written" in text


def test_series_read_one_by_one_give_the_same_report(run, tmp_path, monkeypatch):
    first = write_report(run, tmp_path / "1.html")[0].read_bytes()
    monkeypatch.setattr(report_inputs, "LONG_BYTES", 1)
    assert write_report(run, tmp_path / "2.html")[0].read_bytes() == first


def test_many_points_have_overviews_and_stay_small(tmp_path):
    write_run(tmp_path, moving=37, duration_s=20.0)
    pages = write_report(tmp_path, pdf=find_spec("typst") is not None)
    text = pages[0].read_text(encoding="utf-8")
    html5lib.HTMLParser(strict=True).parse(text)
    assert max(path.stat().st_size for path in pages) < MOST_BYTES
    assert text.count("<svg") == 2 + 1 + 3
    assert text.count(">p36<") >= 6


# What is damaged, foreign or misused.


def spoil(name, content):
    def change(folder):
        (folder / name).write_bytes(content)

    return change


def change_summary(**entries):
    def change(folder):
        path = folder / "summary.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))

    return change


def cut_displacement(folder):
    path = folder / "displacement.nc"
    path.write_bytes(path.read_bytes()[:-1000])


def change_modes(change):
    """Modes that a reader takes for modes, and that lack what the section shows."""
    return lambda folder: write_dataset(folder / "modes.nc", change(make_modes([f"p{n}" for n in range(6)])))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (change_modes(lambda modes: modes.assign_attrs(band_hz=[1.0])), "modes.nc: expected files as this version"),
        (change_modes(lambda modes: modes.assign_attrs(band_hz=[1.0, 2.0])), "run `vfm-sdm modes` again"),
        (shutil.rmtree, "expected a run folder, got no such folder; run `vfm-sdm measure`"),
        (lambda folder: (folder / "summary.json").unlink(), "expected a summary, got no such file"),
        (spoil("summary.json", b"{"), "expected a summary, got: "),
        (spoil("summary.json", b"{}"), "expected the summary of a finished measurement, got none of points, audit"),
        (change_summary(audit=None), "expected the summary of a finished measurement, got none of audit"),
        (change_summary(audit={"verdict": "fit to use"}), "expected files as this version of vfm-sdm writes them"),
        (change_summary(session_hash="0" * 64), "expected results of one run"),
        (lambda folder: (folder / "displacement.nc").unlink(), "expected displacement, got no such file"),
        (cut_displacement, "expected displacement, got a damaged file"),
        (spoil("displacement.nc", b"no netCDF"), "expected displacement, got a damaged file"),
        (
            lambda folder: (folder / "session.resolved.toml").unlink(),
            "expected the session that was measured, got none",
        ),
        (spoil("session.resolved.toml", b"name = 1"), "run `vfm-sdm measure` again"),
        (lambda folder: (folder / "points.nc").unlink(), "expected points, got no such file"),
        (spoil("cameras.toml", b"="), "cameras.toml"),
        (spoil("evaluation.json", b"[]"), "expected a comparison with rows, got something else"),
        (spoil("evaluation.json", b"{"), "expected a comparison, got: "),
        (spoil("evaluation.json", b'{"rows": [{}]}'), "expected files as this version of vfm-sdm writes them"),
        (spoil("evaluation.json", b'{"rows": [{}]}'), "run `vfm-sdm evaluate` again"),
        (spoil("modes.nc", b"no netCDF"), "expected modes, got a damaged file"),
        (lambda folder: write_dataset(folder / "modes.nc", xr.Dataset({"f": ("mode", [1.0])})), "expected modes, got"),
    ],
)
def test_a_folder_that_is_no_whole_run_is_one_clear_error(copied, change, message):
    change(copied)
    with pytest.raises(ResultsError) as caught:
        write_report(copied, copied.parent / "r.html")
    assert message in str(caught.value)
    assert not (copied.parent / "r.html").exists()


def test_points_of_another_session_are_refused(copied, tmp_path):
    write_run(tmp_path / "other", moving=2)
    shutil.copy(tmp_path / "other" / "displacement.nc", copied)
    with pytest.raises(ResultsError, match="expected results of one run"):
        write_report(copied)


def test_wrong_names_of_files_and_languages_are_refused(run, tmp_path):
    with pytest.raises(ResultsError, match=r"expected a file that ends in \.html or \.pdf, got '\.txt'; rename it"):
        write_report(run, tmp_path / "r.txt")
    with pytest.raises(ResultsError, match="language: expected one of en, de, got 'fr'; choose one"):
        write_report(run, tmp_path / "r.html", language="fr")


def test_what_is_filled_in_later_is_taken_from_the_session_file(tmp_path):
    measurement, _ = write_run(tmp_path / "run", folder=tmp_path)
    later = write_session(tmp_path / "session.toml", measurement.session)
    assert "Client, project and place are not stated" in write_report(tmp_path / "run")[0].read_text(encoding="utf-8")
    noted = later.read_text(encoding="utf-8")
    later.write_text(f'{noted}\n[report]\nplace = "Bonn"\n', encoding="utf-8")
    page = write_report(tmp_path / "run", session=later)[0].read_text(encoding="utf-8")
    assert "<dd>Bonn</dd>" in page
    assert "not stated" not in page
    later.write_text(noted.replace("simulated", "another"), encoding="utf-8")
    with pytest.raises(SessionError, match="expected the session of this run, got another one"):
        write_report(tmp_path / "run", session=later)


# Sections of other packages.

SECTIONS = """
from vfm_sdm.outputs.report import Paragraph, Section


def polite(inputs, language):
    return Section("Traffic", (Paragraph(f"{len(inputs.point_names)} points in {language.code}"),))


def silent(inputs, language):
    return None


def failing(inputs, language):
    raise RuntimeError("no <data>")


def wrong(inputs, language):
    return "text"
"""


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("polite", "6 points in en"),
        ("silent", None),
        ("failing", "the section of river-tools 1.2 failed: RuntimeError: no &lt;data&gt;"),
        ("wrong", "expected the section of river-tools 1.2 to be a Section, got &#39;text&#39;"),
        ("absent", "expected to import traffic_report:absent, got AttributeError"),
    ],
)
def test_sections_of_other_packages_stand_at_the_end(run, tmp_path, section, said):
    parts = {"vfm_sdm.sections": {"traffic": f"traffic_report:{section}"}}
    with installed(tmp_path, parts, {"traffic_report": SECTIONS}), open_run(run) as inputs:
        page = to_html(build_content(inputs, find_language("en")))
    assert said is None or said in page
    assert ("<h2>13 Traffic</h2>" in page) == (section == "polite")
