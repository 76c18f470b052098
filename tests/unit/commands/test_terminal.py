"""Tables as JSON, tables that end, exit statuses, and Ctrl-C."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands import app as cli
from vfm_sdm.commands import measuring, tables
from vfm_sdm.commands.terminal import Ending, Terminal, as_json
from vfm_sdm.commands.weights import weights_table
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.core.statuses import SessionOutcome, Verdict
from vfm_sdm.studies.batch import BatchRow


def printed(capsys):
    return json.loads(capsys.readouterr().out)


def example(points, frames=5):
    rng = np.random.default_rng(0)
    shape = (frames, points, 3)
    return make_displacement(
        np.arange(frames) / 50,
        [f"p{number}" for number in range(points)],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=rng.normal(size=shape),
            displacement_std_mm=np.full(shape, 0.1),
            scale_std=np.full(shape[1:], 0.01),
            position_m=rng.normal(size=shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2]),
        ),
        attrs={"frame": "structure"},
    )


def test_what_is_printed_becomes_one_object(capsys):
    table = Table("point", "", title=Text("Title [mm]"), caption="below")
    table.add_column("value", justify="right")
    table.add_row("1", "", "1.50")
    table.add_row(Text(""), "a [b]", "-")
    terminal = Terminal()
    with as_json():
        terminal.print(table, Text("a line", style="red"))
        terminal.print("another [line]", highlight=False)
    rows = [{"point": "1", "note": "", "value": 1.5}, {"point": "1", "note": "a [b]", "value": None}]
    assert printed(capsys) == {
        "exit_status": 0,
        "tables": [{"title": "Title [mm]", "rows": rows}],
        "lines": ["below", "a line", "another [line]"],
    }
    terminal.print("text again")
    assert capsys.readouterr().out == "text again\n"


@pytest.mark.parametrize(("error", "status"), [(SystemExit(3), 3), (KeyboardInterrupt(), 130), (ValueError(), 1)])
def test_the_object_says_how_it_ended(capsys, error, status):
    with pytest.raises(type(error)), as_json():
        raise error
    assert printed(capsys)["exit_status"] == status


def test_every_command_takes_json(capsys):
    with pytest.raises(SystemExit):
        cli.main(["weights", "list", "--json"])
    (table,) = printed(capsys)["tables"]
    assert {"name", "network", "size", "licence", "here"} == {*table["rows"][0]}
    with pytest.raises(SystemExit):
        cli.main(["measure", "none.toml", "-o", "run", "--json"])
    assert printed(capsys) == {"exit_status": 1, "tables": [], "lines": []}


def test_tables_of_many_points_end(capsys):
    many = tables.displacement_table(example(400))
    assert many.row_count == 3 * 20
    assert str(many.caption) == "... and 380 more points; all in summary.json"
    assert tables.displacement_table(example(20)).caption is None
    with as_json():
        assert tables.displacement_table(example(400)).row_count == 3 * 400


def test_tables_fit_eighty_columns():
    for table in (tables.displacement_table(example(3)), weights_table()):
        console = Console(width=200, file=io.StringIO())
        assert console.measure(table).maximum <= 80


@pytest.mark.parametrize(
    "words", [["measure"], ["reference"], ["evaluate"], ["track"], ["batch"], ["accept", "budget"]]
)
def test_help_has_no_words_for_empty_lists(words, capsys):
    cli.app([*words, "--help"], result_action="return_value")
    assert "--empty" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rows", "status"),
    [
        ([("measured", Verdict.FIT), ("measured", Verdict.CARE)], Ending.DONE),
        ([("measured", Verdict.FIT), ("measured", Verdict.REFUSED)], Ending.REFUSED),
        ([("no result", ""), ("measured", Verdict.REFUSED)], Ending.NO_RESULT),
        ([("failed", ""), ("no result", ""), ("measured", Verdict.REFUSED)], Ending.ERROR),
    ],
)
def test_a_batch_ends_with_the_worst(monkeypatch, tmp_path, command, rows, status):
    made = [
        BatchRow(str(n), "f", SessionOutcome(outcome), verdict=str(verdict))
        for n, (outcome, verdict) in enumerate(rows)
    ]
    monkeypatch.setattr("vfm_sdm.commands.batch.find_sessions", lambda _: {})
    monkeypatch.setattr("vfm_sdm.commands.batch.batch", lambda *_, **__: made)
    assert command("batch", "x", "-o", tmp_path)[0] == status


@pytest.mark.parametrize(("verdict", "status"), [(Verdict.REFUSED, 4), (Verdict.CARE, 0), (Verdict.NOT_JUDGED, 0)])
def test_a_refused_result_has_a_status_of_its_own(monkeypatch, command, tmp_path, verdict, status):
    result = SimpleNamespace(
        cameras=None, tracks={}, displacement=None, audit=SimpleNamespace(verdict=verdict), summary={}
    )
    for name, value in {"read_session": None, "measure": result, "first_cause": ""}.items():
        monkeypatch.setattr(measuring, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(measuring.tables, "measurement_report", lambda _: [])
    assert command("measure", "session.toml", "-o", tmp_path)[0] == status


@pytest.mark.parametrize(("cause", "written", "status"), [("", ["uff"], 1), ("every point was lost", [], 3)])
def test_exports_are_there_before_anything_is_printed(monkeypatch, command, tmp_path, cause, written, status):
    """Whoever reads may stop; and where no sample is ok, that is said, not what a format needs."""
    found, events = SimpleNamespace(cameras=None, tracks={}, displacement=example(1), audit=None, summary={}), []
    for name, value in {"read_session": None, "measure": found, "first_cause": cause}.items():
        monkeypatch.setattr(measuring, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(measuring, "write_export", lambda form, *_: events.append(form))
    monkeypatch.setattr(measuring.tables, "measurement_report", lambda _: ["table"])
    monkeypatch.setattr(measuring, "OUT", SimpleNamespace(print=lambda _: None if cause else sys.exit(1)))
    assert command("measure", "session.toml", "-o", tmp_path, "--export", "uff")[0] == status
    assert events == written


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_says_what_becomes_of_the_work(tmp_path):
    """In a process of its own, as a terminal sends it, in the middle of the demonstration."""
    process = subprocess.Popen(
        [sys.executable, "-m", "vfm_sdm", "demo", str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 60
    while not (tmp_path / "out" / "recording").exists() and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; finished stages are kept" in said
    assert "Traceback" not in said


def run_typed(*words, code="", **options):
    """The command line in a process of its own."""
    start = [sys.executable, "-c", f"{code}\nfrom vfm_sdm.commands.app import main\nmain({list(map(str, words))!r})"]
    return subprocess.run(start, capture_output="stdout" not in options, check=False, **options)


@pytest.mark.parametrize("words", [["weights", "--json"], ["measure", "--help", "--json"], ["--json"]])
def test_help_is_no_part_of_the_object(capsys, words):
    with suppress(SystemExit):
        cli.main(words)
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"exit_status": 0, "tables": [], "lines": []}
    assert "Usage: vfm-sdm" in captured.err


def test_a_run_folder_may_be_called_as_a_command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        cli.main(["report", "batch", "--json"])
    assert printed(capsys)["exit_status"] == Ending.ERROR


def test_json_has_no_numbers_that_are_none(capsys):
    table = Table("point")
    table.add_column("value", justify="right")
    for cell in ("nan", "inf", "-inf", "-"):
        table.add_row("nan", cell)
    with as_json():
        Terminal().print(table)
    (found,) = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["tables"]
    assert found["rows"] == [{"point": "nan", "value": None}] * 4


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_names_may_have_letters_that_the_terminal_lacks(encoding):
    code = """
from vfm_sdm.commands import report
report.write_report = lambda *_, **__: ["brücke 🌉 \\udcff.html"]
"""
    env = {**os.environ, "PYTHONIOENCODING": encoding}
    done = run_typed("report", "run", code=code, env=env)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"written: br")
    done = run_typed("report", "run", "--json", code=code, env=env)
    assert json.loads(done.stdout)["lines"] == ["written: brücke 🌉 \udcff.html"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
@pytest.mark.parametrize("words", [["weights", "list"], ["weights", "list", "--json"]])
def test_output_that_takes_no_more_is_one_clear_error(words):
    with Path("/dev/full").open("w") as full:
        done = run_typed(*words, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == Ending.ERROR
    assert b"standard output: expected to write to it, got: No space left on device" in done.stderr
    assert b"Traceback" not in done.stderr
