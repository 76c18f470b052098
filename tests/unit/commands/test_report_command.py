"""The command that writes reports."""

from pathlib import Path

import pytest

from run_folders import write_run
from vfm_sdm.core.run_folder import RunFolder


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    write_run(folder)
    return folder


def test_a_report_is_written_beside_the_results(command, run):
    status, out, err = command("report", run)
    assert (status, err) == (0, "")
    assert out == f"written: {run / 'report.html'}\n"
    assert "Displacement measurement report" in (run / "report.html").read_text(encoding="utf-8")


def test_language_and_forms_are_chosen(command, run, tmp_path):
    pytest.importorskip("typst")
    status, out, _ = command("report", run, "-o", tmp_path / "a b.html", "--language", "de", "--pdf")
    assert status == 0
    assert [Path(line.removeprefix("written: ")).name for line in out.splitlines()] == ["a b.html", "a b.pdf"]
    assert "Messbericht" in (tmp_path / "a b.html").read_text(encoding="utf-8")


def test_a_folder_without_a_run_ends_with_one_line(command, tmp_path):
    status, out, err = command("report", tmp_path)
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    assert "expected a summary, got no such file" in err


def test_measuring_another_session_removes_the_report(tmp_path):
    (tmp_path / "report.html").touch()
    with RunFolder(tmp_path).opened({"session_hash": "another", "input_hashes": {}}):
        assert not (tmp_path / "report.html").exists()
