"""Tables of the protocol: figures, mean and standard deviation by hand, and what is written."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.studies.protocol.tables import METRICS, Case, Table, comparison_table, write_table

NAN = float("nan")
CASES = [Case("data-1", "mid", "vertical"), Case("data-1", "mid", "lateral"), Case("data-2", "mid", "vertical")]


def make_score(nrmse=0.1, correlation=0.9, rppae=0.2, gain=1.0, skill=0.8):
    return Score(nrmse, correlation, rppae, gain, 0.01, skill, 0.95, 0.0, 0.0, 100, None, False)


def make_table(scores, **options):
    return comparison_table("name", "title", scores, cases=CASES, **options)


def test_mean_and_std_are_those_of_the_cases():
    scores = {case: make_score(nrmse=value) for case, value in zip(CASES, (0.1, 0.2, 0.6), strict=True)}
    table = make_table({"a": scores})
    column = table.columns.index("NRMSE range: a")
    assert [row[column] for row in table.rows[:3]] == [0.1, 0.2, 0.6]
    assert [row[:3] for row in table.rows[:3]] == [(c.dataset, c.point, c.axis) for c in CASES]
    assert [row[:3] for row in table.rows[3:]] == [("mean", "", ""), ("std", "", "")]
    assert table.rows[3][column] == pytest.approx(0.3)
    # sqrt((0.2^2 + 0.1^2 + 0.3^2) / 3): divided by the number of cases, as in the paper.
    assert table.rows[4][column] == pytest.approx(np.sqrt(0.14 / 3))


def test_every_metric_has_a_column_of_its_own_for_every_method():
    first = {CASES[0]: make_score(0.11, 0.12, 0.13, 0.14, 0.15)}
    second = {CASES[0]: make_score(0.21, 0.22, 0.23, 0.24, 0.25)}
    table = make_table({"a": first, "b": second})
    assert list(METRICS) == ["NRMSE range", "correlation", "RPPAE", "gain", "skill"]
    assert table.columns[3:] == tuple(f"{metric}: {method}" for metric in METRICS for method in "ab")
    assert table.rows[0][3:] == (0.11, 0.21, 0.12, 0.22, 0.13, 0.23, 0.14, 0.24, 0.15, 0.25)
    for row in table.rows:
        assert len(row) == len(table.columns)


def test_what_is_not_defined_or_not_there_is_left_out_of_mean_and_std():
    scores = {CASES[0]: make_score(nrmse=0.1), CASES[1]: make_score(nrmse=NAN, rppae=0.4)}
    table = make_table({"a": scores, "never": {}})
    nrmse, rppae = table.columns.index("NRMSE range: a"), table.columns.index("RPPAE: a")
    assert np.isnan([table.rows[1][nrmse], table.rows[2][nrmse]]).all()
    assert (table.rows[3][nrmse], table.rows[4][nrmse]) == (0.1, 0.0)
    assert table.rows[3][rppae] == pytest.approx(0.3)
    never = table.columns.index("skill: never")
    assert np.isnan([row[never] for row in table.rows]).all()


def test_methods_that_could_not_run_have_empty_columns_and_a_note():
    scores = {"a": {case: make_score() for case in CASES}}
    table = make_table(scores, missing={"b": "no weights"}, notes=("first",))
    assert table.notes == ("first", "b could not run: no weights")
    assert table.columns[3:5] == ("NRMSE range: a", "NRMSE range: b")
    assert np.isnan([row[4] for row in table.rows]).all()
    assert table.rows[0][3] == 0.1


def test_cases_with_few_samples_are_named():
    scores = {case: make_score() for case in CASES}
    assert make_table({"a": scores}).notes == ()
    few = replace(make_score(), samples=94)
    note = make_table({"a": scores, "b": {**scores, CASES[1]: few}}).notes
    assert note == ("data-1, mid, lateral: b on 94 of 100 samples only",)
    # Another field test may be shorter.
    assert make_table({"a": {CASES[0]: make_score(), CASES[2]: few}}).notes == ()


def test_without_cases_there_are_mean_and_std_of_nothing():
    table = comparison_table("name", "title", {"a": {}}, cases=[])
    assert [row[0] for row in table.rows] == ["mean", "std"]
    assert np.isnan([cell for row in table.rows for cell in row[3:]]).all()


def test_csv_holds_all_digits_and_nothing_for_what_is_not_known(tmp_path):
    values = (1 / 3, NAN, -2.5e-7)
    table = Table("t", "title", ("name", "x"), tuple((f"a,{n}", value) for n, value in enumerate(values)))
    path, _ = write_table(tmp_path, table)
    assert path == tmp_path / "t.csv"
    assert b"\r" not in path.read_bytes()
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["name", "x"]
    assert [row[0] for row in rows[1:]] == ["a,0", "a,1", "a,2"]
    assert [row[1] for row in rows[1:]] == [repr(1 / 3), "", repr(-2.5e-7)]


def test_markdown_is_a_table_of_three_digits(tmp_path):
    table = Table("t", "The title", ("a|b", "x"), (("p|q", 1 / 3), ("r", NAN)), ("one note", "another"))
    _, path = write_table(tmp_path, table)
    assert path == tmp_path / "t.md"
    assert path.read_text(encoding="utf-8").splitlines() == [
        "# The title",
        "",
        "| a\\|b | x |",
        "| --- | --- |",
        "| p\\|q | 0.333 |",
        "| r | - |",
        "",
        "- one note",
        "- another",
    ]


def test_an_earlier_table_is_replaced_and_nothing_else_is_left(tmp_path):
    table = Table("t", "title", ("x",), ((1.0,),))
    write_table(tmp_path, table)
    csv_path, md_path = write_table(tmp_path, replace(table, rows=((2.0,),)))
    assert csv_path.read_text() == "x\n2.0\n"
    assert md_path.read_text().endswith("| 2.000 |\n")
    assert {path.name for path in tmp_path.iterdir()} == {"t.csv", "t.md"}


def test_a_folder_that_cannot_be_written_to_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        write_table(tmp_path / "file", Table("t", "title", ("x",), ((1.0,),)))
