"""Batches: names of run folders, and a line for whatever becomes of a session."""

import csv
import os
import signal
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest

from scenes import write_scene
from vfm_sdm.core.executors import ProcessWorkers
from vfm_sdm.core.statuses import SessionOutcome
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import Method, read_defaults
from vfm_sdm.studies.batch import BatchRow, batch, find_sessions, write_rows
from vfm_sdm.studies.batch import run as module


def place(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_run_folders_are_called_as_the_sessions(tmp_path):
    place(tmp_path, "b/session.toml", "a/session.toml", "a/night.toml", "deep/er/c/session.toml", "d[1]/session.toml")
    found = find_sessions([f"{tmp_path}/*/*.toml", f"{tmp_path}/a/session.toml", tmp_path / "d[1]" / "session.toml"])
    assert list(found) == ["night", "a", "b", "d[1]"]
    assert found["night"] == tmp_path / "a" / "night.toml"
    assert "c" in find_sessions([f"{tmp_path}/**/session.toml"])


def test_a_session_here_is_called_as_this_folder(tmp_path, monkeypatch):
    place(tmp_path, "bridge/session.toml")
    monkeypatch.chdir(tmp_path / "bridge")
    assert list(find_sessions(["session.toml"])) == ["bridge"]


@pytest.mark.parametrize("names", [("x/a/session.toml", "y/a/session.toml"), ("x/A.toml", "y/a/session.toml")])
def test_two_sessions_of_one_name_are_refused(names, tmp_path):
    place(tmp_path, *names)
    with pytest.raises(SessionError, match=r"expected a run folder of its own, got 'a', which .* has, too; rename"):
        find_sessions([f"{tmp_path}/**/*.toml"])


def test_patterns_without_a_match_are_refused(tmp_path):
    with pytest.raises(SessionError, match=r"none.toml: expected session files, got no match"):
        find_sessions([tmp_path / "none.toml"])


def test_rows_as_csv(tmp_path):
    rows = [
        BatchRow("a", "a.toml", SessionOutcome.MEASURED, "fit to use", 1, 2, 0.1234567, "mid", "lateral", 2.0),
        BatchRow("b", "b.toml", SessionOutcome.FAILED, reason="wrong, in two ways"),
    ]
    with write_rows(tmp_path / "batch.csv", rows).open(encoding="utf-8") as stream:
        first, second = csv.DictReader(stream)
    assert (first["outcome"], first["uncertainty_mm"], first["axis"], first["time_s"]) == (
        *("measured", "0.123457", "lateral", "2"),
    )
    assert (second["uncertainty_mm"], second["reason"]) == ("", "wrong, in two ways")


def die(task):
    if task.name == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    return BatchRow(task.name, str(task.file), SessionOutcome.MEASURED, str(os.getpid()))


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL on Windows")
@pytest.mark.slow
def test_a_process_that_dies_takes_no_other_along(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_measure_one", die)
    reported = []
    with ProcessWorkers(2) as executor:
        sessions = dict.fromkeys(("one", "dies", "two"), Path("s.toml"))
        rows = batch(sessions, tmp_path, executor=executor, report=reported.append)
    assert [row.session for row in rows] == ["one", "dies", "two"]
    assert [row.outcome for row in rows] == [SessionOutcome.MEASURED, SessionOutcome.FAILED, SessionOutcome.MEASURED]
    assert str(os.getpid()) not in (rows[0].verdict, rows[2].verdict)
    assert rows[0].file == str(Path("s.toml").absolute())
    assert "got it killed or out of memory; run the batch again" in rows[1].reason
    assert sorted(row.session for row in reported) == ["dies", "one", "two"]


def test_segments_of_long_sessions_are_shared_by_all_workers(tmp_path, monkeypatch):
    durations_s = {"short": 60.0, "long": 100.0, "short too": 80.0}

    def read(file, **_):
        return SimpleNamespace(name=file.parent.name, method=Method(segment_s=60.0))

    def open_them(session):
        info = SimpleNamespace(duration_s=durations_s[session.name])
        return {"left": SimpleNamespace(info=info)}

    begun = []

    def note(session, run, *, executor=None):
        begun.append((session.name, executor))
        raise SessionError("enough")

    monkeypatch.setattr(module, "read_session", read)
    monkeypatch.setattr(module, "open_views", open_them)
    monkeypatch.setattr(module, "measure", note)
    with ThreadPoolExecutor(1) as executor:
        sessions = {name: tmp_path / name / "session.toml" for name in durations_s}
        rows = batch(sessions, tmp_path / "runs", executor=executor)
        assert begun == [("short", None), ("short too", None), ("long", executor)]
    assert [row.session for row in rows] == list(durations_s)


def test_whatever_goes_wrong_is_one_line(tmp_path, monkeypatch):
    errors = {
        "session": SessionError("s.toml: 2 faults\n  a: wrong\n  b: wrong"),
        "bug": KeyError("x"),
        "pool": BrokenExecutor("gone"),
    }
    monkeypatch.setattr(module, "read_session", lambda file, **_: file.name)

    def fail(session, run, executor=None):
        raise errors[run.name]

    monkeypatch.setattr(module, "measure", fail)
    rows = batch(dict.fromkeys(errors, Path("s.toml")), tmp_path)
    assert [row.reason for row in rows[:2]] == [
        "s.toml: 2 faults; a: wrong; b: wrong",
        "KeyError: 'x'; measure it alone to see where",
    ]
    assert rows[2].reason.startswith("expected its process to end by itself")
    assert {row.outcome for row in rows} == {SessionOutcome.FAILED}


def test_an_interruption_leaves_a_table_and_begins_nothing_more(tmp_path, monkeypatch):
    begun = []

    def note(task):
        begun.append(task.name)
        return BatchRow(task.name, str(task.file), SessionOutcome.MEASURED)

    def interrupt(row):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "_measure_one", note)
    with pytest.raises(KeyboardInterrupt):
        batch(dict.fromkeys("abcdef", Path("s.toml")), tmp_path, report=interrupt)
    assert begun == ["a"]
    assert (tmp_path / "batch.csv").read_text().splitlines()[1].startswith("a,")


def test_a_table_that_cannot_be_written_is_known_before_any_work(tmp_path):
    (tmp_path / "batch.csv").mkdir()
    with pytest.raises(ResultsError, match=r"batch.csv: expected to write it"):
        batch({"a": Path("s.toml")}, tmp_path)
    assert not (tmp_path / "a").exists()


def test_defaults_reach_the_run_folder(tmp_path):
    file = write_scene(tmp_path / "plane", frames=5)
    (tmp_path / "defaults.toml").write_text('[method]\nscale_limit = 0.2\n[[point]]\nname = "b"\nstatic = true\n')
    text = file.read_text().replace("scale_limit = 0.05\n", "").replace('name = "b"\nview = "left"', 'name = "b"')
    file.write_text(text.replace("static = false\n", ""))
    (row,) = batch({"plane": file}, tmp_path / "runs", defaults=read_defaults(tmp_path / "defaults.toml"))
    assert "point[b].view: expected a value, got nothing" in row.reason  # the default has none either
    (tmp_path / "defaults.toml").write_text(
        '[method]\nscale_limit = 0.2\n[[point]]\nname = "b"\nview = "left"\nstatic = true\n'
    )
    (row,) = batch({"plane": file}, tmp_path / "runs", defaults=read_defaults(tmp_path / "defaults.toml"))
    assert row.outcome is SessionOutcome.MEASURED
    assert (row.measured_points, row.points) == (2, 2)  # the static one does not count
    resolved = (tmp_path / "runs" / "plane" / "session.resolved.toml").read_text()
    assert "scale_limit = 0.2" in resolved
