"""`vfm-sdm batch` as it is typed: results, what goes wrong, going on after a kill, and exit status."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from rich.console import Console

from scenes import write_scene
from vfm_sdm.commands import batch as command_module
from vfm_sdm.core.statuses import SessionOutcome
from vfm_sdm.studies.batch import BatchRow


@pytest.fixture(scope="module")
def sites(tmp_path_factory):
    """Ten sessions, of which one is broken."""
    folder = tmp_path_factory.mktemp("sites")
    first = write_scene(folder / "bridge 0", frames=5).parent
    for number in range(1, 10):
        shutil.copytree(first, folder / f"bridge {number}")
    broken = folder / "bridge 3" / "session.toml"
    broken.write_text(f"metod = 1\n{broken.read_text()}")
    return folder


@pytest.mark.slow
def test_ten_sessions_with_one_broken(command, sites, tmp_path):
    runs = tmp_path / "runs"
    status, out, err = command("batch", f"{sites}/*/session.toml", "-o", runs)
    assert status == 1
    with (runs / "batch.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["session"] for row in rows] == [f"bridge {number}" for number in range(10)]
    assert [row["outcome"] == "measured" for row in rows] == [number != 3 for number in range(10)]
    summary = json.loads((runs / "bridge 0" / "summary.json").read_text())
    worst = max(axis["expanded_uncertainty_mm"] for p in summary["points"].values() for axis in p["axes"].values())
    for row in rows[:3] + rows[4:]:
        assert (row["verdict"], row["measured_points"], row["points"]) == ("use with care", "3", "3")
        assert float(row["uncertainty_mm"]) == pytest.approx(worst, rel=1e-5)
        assert (row["point"], row["axis"]) == ("c", "forward")
    why = [line for line in out.splitlines() if line.startswith("bridge 3: ")]
    assert len(why) == 1
    assert "session.toml: metod: expected one of the keys name, view, " in why[0]
    assert "did you mean 'method'? Rename it" in why[0]
    assert "10/10 bridge 9: use with care" in err
    # What is finished is not done again, and the table is the same but for the time.
    status, out, _ = command("batch", sites / "bridge 0" / "session.toml", "-o", runs, "--json")
    (row,) = json.loads(out)["sessions"]
    assert status == 0
    assert (row["session"], row["uncertainty_mm"], row["reason"]) == ("bridge 0", worst, "")
    assert json.loads((runs / "bridge 0" / "summary.json").read_text())["reused_stages"][:2] == ["cameras", "tracking"]


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL on Windows")
@pytest.mark.slow
def test_a_killed_batch_goes_on(sites, tmp_path):
    names = ("bridge 0", "bridge 1", "bridge 2")
    words = [
        *(str(sites / name / "session.toml") for name in names),
        "-o",
        str(tmp_path / "runs"),
        "--json",
        "--workers",
        "1",
    ]
    line = [sys.executable, "-m", "vfm_sdm", "batch", *words]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    tracks = tmp_path / "runs" / "bridge 1" / "tracks.nc"
    with subprocess.Popen(line, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as one:
        end = time.monotonic() + 300
        while not tracks.exists():
            assert one.poll() is None
            assert time.monotonic() < end
            time.sleep(0.02)
        one.send_signal(signal.SIGKILL)
    finished = tmp_path / "runs" / "bridge 0" / "tracks.nc"
    made = finished.stat().st_mtime_ns
    with (tmp_path / "runs" / "batch.csv").open(encoding="utf-8") as stream:
        assert [row["session"] for row in csv.DictReader(stream)] == ["bridge 0"]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
    rows = json.loads(done.stdout)["sessions"]
    assert [row["outcome"] for row in rows] == ["measured"] * 3
    assert len({row["uncertainty_mm"] for row in rows}) == 1
    assert finished.stat().st_mtime_ns == made


OUTCOMES = {
    (SessionOutcome.MEASURED,): 0,
    (SessionOutcome.MEASURED, SessionOutcome.NO_RESULT): 3,
    (SessionOutcome.NO_RESULT, SessionOutcome.FAILED, SessionOutcome.MEASURED): 1,
}


def make_rows(outcomes):
    return [
        BatchRow(
            session=f"a bridge with a long name {number}",
            file="sites/session.toml",
            outcome=outcome,
            verdict="fit to use" if outcome is SessionOutcome.MEASURED else "",
            measured_points=3,
            points=4,
            uncertainty_mm=1.23456 if outcome is SessionOutcome.MEASURED else float("nan"),
            point="1/2 span",
            axis="longitudinal",
            time_s=75.2,
            reason="" if outcome is SessionOutcome.MEASURED else "cameras: too few matches",
        )
        for number, outcome in enumerate(outcomes)
    ]


@pytest.mark.parametrize("outcomes", OUTCOMES)
def test_exit_status_is_that_of_the_worst(outcomes, command, monkeypatch, tmp_path):
    (tmp_path / "s.toml").touch()
    monkeypatch.setattr(command_module, "batch", lambda *a, **k: make_rows(outcomes))
    status, out, _ = command("batch", tmp_path / "s.toml", "-o", tmp_path)
    assert status == OUTCOMES[outcomes]
    assert out.count("cameras: too few matches") == len(outcomes) - 1
    status, out, _ = command("batch", tmp_path / "s.toml", "-o", tmp_path, "--json")
    assert status == OUTCOMES[outcomes]
    assert [row["uncertainty_mm"] for row in json.loads(out)["sessions"]] == [
        1.23456 if outcome is SessionOutcome.MEASURED else None for outcome in outcomes
    ]


@pytest.mark.parametrize("width", [50, 80])
def test_the_table_says_all_on_narrow_terminals(width, capsys):
    outcomes = (SessionOutcome.MEASURED, SessionOutcome.FAILED)
    Console(width=width, markup=False).print(command_module._tabulate(make_rows(outcomes)))
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= width
    letters = "".join(out.split())
    for word in ("1.235", "3/4", "failed", "75"):
        assert word in letters, word


def test_misuse(command, tmp_path):
    status, _, err = command("batch", tmp_path / "none" / "*.toml", "-o", tmp_path)
    assert (status, "expected session files, got no match" in err) == (1, True)
    status, _, err = command("batch", "-o", tmp_path)
    assert (status, "expected session files, got none" in err) == (1, True)
    (tmp_path / "s.toml").touch()
    status, _, err = command("batch", tmp_path / "s.toml", "-o", tmp_path, "--defaults", tmp_path / "none.toml")
    assert (status, "expected a file of defaults" in err) == (1, True)
    assert command("batch", tmp_path / "s.toml", "-o", tmp_path, "--workers", "-1")[0] == 1
