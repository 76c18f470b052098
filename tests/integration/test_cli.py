"""Every command as a user would type it."""

import subprocess
import sys

import pytest

from scenes import write_scene
from vfm_sdm.cli import main
from vfm_sdm.session import Session, read_session, write_session


@pytest.fixture(scope="module")
def session_file(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"), frames=5)


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs the command; returns exit status, standard output and standard error."""
    monkeypatch.setenv("COLUMNS", "140")

    def run(*words):
        try:
            main([str(word) for word in words])
            status = 0
        except SystemExit as stop:
            status = stop.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


def test_measure(command, session_file, tmp_path):
    status, out, _ = command("measure", session_file, "-o", tmp_path / "run")
    assert status == 0
    assert "cameras: ok" in out
    assert "p-p" in out
    assert "measure site.perpendicular_distance" in out
    assert (tmp_path / "run" / "displacement.csv").exists()
    status, out, _ = command("measure", session_file, "-o", tmp_path / "run", "--export", "mat", "--export", "uff")
    assert status == 0
    assert (tmp_path / "run" / "displacement.mat").exists()
    assert (tmp_path / "run" / "displacement.uff").exists()
    assert "reused from the run folder: cameras, tracking" in out


def test_stages_one_by_one(command, session_file, tmp_path):
    status, out, _ = command("cameras", session_file, "-o", tmp_path)
    assert status == 0
    assert "focal left" in out
    assert (tmp_path / "cameras.toml").exists()
    status, out, _ = command("track", session_file, "-o", tmp_path)
    assert status == 0
    assert "[px]" in out
    assert (tmp_path / "tracks.nc").exists()
    status, out, _ = command("displacement", session_file, "-o", tmp_path)
    assert status == 0
    assert (tmp_path / "displacement.nc").exists()


def test_info(command):
    status, out, _ = command("info")
    assert status == 0
    for expected in (
        "numpy",
        "icgn: can run",
        "two-view: can run",
        "h264: yes",
        "hevc: yes",
        "vision foundation models",
    ):
        assert expected in out


def test_version_and_help(command):
    assert command("--version")[1].strip() == "0.1.0"
    status, out, _ = command("--help")
    assert status == 0
    for name in ("demo", "measure", "track", "cameras", "displacement", "info"):
        assert name in out


def test_a_missing_session_is_one_line_and_a_status(command, tmp_path):
    status, out, err = command("measure", tmp_path / "none.toml", "-o", tmp_path / "run")
    assert status == 1
    assert out == ""
    assert err.startswith("vfm-sdm: ")
    assert "none.toml" in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_a_missing_option_says_so(command, session_file):
    status, _, err = command("measure", session_file)
    assert status != 0
    assert "output" in err.lower()


def test_no_result_from_the_data_is_status_three(command, session_file, tmp_path):
    session = read_session(session_file)
    fields = {**session.model_dump(), "folder": session.folder, "view": [session.view[0].model_dump()]}
    alone = write_session(tmp_path / "alone.toml", Session(**{**fields, "method": {"cameras": "two-view"}}))
    status, _, err = command("measure", alone, "-o", tmp_path / "run")
    assert status == 3
    assert "one view" in err
    assert (tmp_path / "run" / "tracks.nc").exists()


def test_installed_as_a_command():
    done = subprocess.run([sys.executable, "-m", "vfm_sdm", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0.1.0"
