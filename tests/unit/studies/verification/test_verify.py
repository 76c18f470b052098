"""A run folder verifies as it was written, and each kind of change is named; nothing is written."""

import json
import shutil
from pathlib import Path

import pytest

from scenes import write_scene
from vfm_sdm.commands.app import main
from vfm_sdm.core.files import file_hash
from vfm_sdm.core.netcdf import read_displacement, read_tracks, write_displacement, write_tracks
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.studies.verification import verify_run


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("verified")
    session = read_session(write_scene(folder / "scene", injection=False))
    Measurement(session, folder / "run").run("cameras", "points", "tracks", "displacement", "summary")
    return folder


@pytest.fixture
def folder(finished, tmp_path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "copy"))


def differing(folder: Path) -> list[str]:
    return [finding.what for finding in verify_run(folder / "run").differing]


def test_a_run_agrees_with_itself_and_stays_as_it_is(folder):
    before = {path: file_hash(path) for path in folder.rglob("*") if path.is_file()}
    found = verify_run(folder / "run")
    assert found.recomputed
    assert not found.differing
    assert any(finding.sentence == "25 of 25 compared" for finding in found.findings)
    assert {path: file_hash(path) for path in folder.rglob("*") if path.is_file()} == before


def test_inputs_that_are_gone_are_no_difference(folder):
    shutil.rmtree(folder / "scene")
    found = verify_run(folder / "run")
    assert found.recomputed
    assert not found.differing


def test_a_changed_input_is_named(folder):
    with (folder / "scene" / "left" / "003.png").open("ab") as stream:
        stream.write(b"more")
    assert [name.rsplit("/", 1)[1] for name in differing(folder)] == ["003.png"]


def test_a_changed_number_is_named_with_its_place(folder, capsys):
    data = read_displacement(folder / "run")
    data["displacement"][5, 1, 2] += 0.1
    write_displacement(folder / "run", data)
    found = {finding.what: finding.sentence for finding in verify_run(folder / "run").differing}
    assert "differs by up to 0.1 mm (at time 0.25, point b, axis forward)" in found["displacement"]
    assert set(found) >= {"displacement", "displacement.csv"}
    with pytest.raises(SystemExit, match="1"):
        main(["verify", str(folder / "run")])
    assert "differs: displacement: differs by up to 0.1 mm" in " ".join(capsys.readouterr().out.split())


def test_other_tracks_are_named(folder):
    tracks = read_tracks(folder / "run")
    tracks["left"]["position"][:] += 1.0
    write_tracks(folder / "run", tracks)
    assert "position" in differing(folder)


def test_a_changed_figure_of_the_summary_is_named(folder):
    path = folder / "run" / "summary.json"
    record = json.loads(path.read_text())
    record["points"]["a"]["axes"]["down"]["peak_to_peak_mm"] = 1.0
    path.write_text(json.dumps(record))
    assert differing(folder) == ["summary.json"]


def test_lost_tracks_leave_nothing_to_compute(folder, capsys):
    (folder / "run" / "tracks.nc").unlink()
    found = verify_run(folder / "run")
    assert not found.recomputed
    assert [finding.what for finding in found.differing] == ["key of tracks"]


def test_no_run(tmp_path):
    with pytest.raises(ResultsError, match="expected a summary, got no such file"):
        verify_run(tmp_path)


def test_acceptance_of_a_run_on_the_command_line(folder, capsys):
    run, words = folder / "run", ["accept", "budget", str(folder / "run"), "--monte-carlo", "10000"]
    with pytest.raises(SystemExit, match="0"):
        main(words)
    assert "budget: pass (9 of 9)" in capsys.readouterr().out
    assert json.loads((run / "acceptance_budget.json").read_text())["trials"] == 10000
    with pytest.raises(SystemExit, match="1"):  # the plane moves by millimetres
        main(["accept", "noise-floor", str(run), "--limit", "0.1"])
    assert "noise-floor: fail" in capsys.readouterr().out
    (folder / "lengths.csv").write_text("point_a,point_b,length_m\na,b,0.5\n")
    with pytest.raises(SystemExit, match="1"):
        main(["accept", "lengths", str(run), str(folder / "lengths.csv")])
