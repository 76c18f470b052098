"""Parts of another package, from the session file to the run folder; the package is that of CONTRIBUTING.md."""

import json
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np
import pytest

from plugins import example_package, example_parts, example_project, installed, registry_lines
from scenes import FRAMES, motion_mm, write_scene
from vfm_sdm.commands.environment import describe_environment
from vfm_sdm.core import parts
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.parts import BUILT_IN, Part
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session, write_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.outputs.results import write_export

TRUE_MM = np.array([motion_mm(i) for i in range(FRAMES)])
SETTINGS = {"window_px": 31}


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The example, installed for all tests here."""
    with installed(tmp_path_factory.mktemp("site"), example_parts(), example_package()):
        yield


@pytest.fixture(scope="module")
def recorded(package, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    return write_scene(folder, tracker="lucas-kanade", **{"lucas-kanade": SETTINGS})


@pytest.fixture(scope="module")
def measured(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return measure(read_session(recorded), folder), folder


def test_a_tracker_runs_through_measure(measured):
    result, _ = measured
    error = result.displacement["displacement"].values - TRUE_MM[:, None]
    # A twentieth of a pixel of 12 mm; several times that along the depth.
    assert np.abs(error[..., :2]).max() < 0.6
    assert np.abs(error[..., 2]).max() < 2.0
    assert (result.displacement["status"] == Status.OK).all()
    assert result.displacement.attrs["tracker"] == "lucas-kanade"


def test_its_settings_are_those_of_the_session_with_defaults_written_out(measured):
    result, folder = measured
    tables = tomllib.loads((folder / "session.resolved.toml").read_text())["method"]
    assert tables["lucas-kanade"] == {"window_px": 31, "levels": 2, "std_px": 0.05, "way_back_px": 0.5}
    again = read_session(folder / "session.resolved.toml")
    assert again.method == result.session.method
    assert again.method.tables["lucas-kanade"].window_px == 31
    covariance = result.tracks["left"]["position_covariance"].values
    np.testing.assert_allclose(np.sqrt(covariance[1:, :, 0, 0]), 0.05, rtol=1e-6)


def test_defaults_count_as_written(recorded, tmp_path):
    said = read_session(recorded)
    fields = {**said.method.model_dump(), "lucas-kanade": {"window_px": 31, "levels": 2}}
    assert type(said)(**{**said.model_dump(), "method": fields}).method == said.method
    unsaid = write_scene(tmp_path, frames=1, tracker="lucas-kanade")
    assert read_session(unsaid).method.tables["lucas-kanade"].levels == 2
    assert read_session(write_scene(tmp_path / "icgn", frames=1)).method.tables == {}


@pytest.mark.slow
def test_its_setting_changes_the_key_of_the_tracks_and_of_nothing_before(measured):
    result, folder = measured
    session = result.session
    table = {"window_px": 25}
    changed = type(session)(**{**session.model_dump(), "folder": session.folder})
    changed = changed.model_copy(
        update={"method": type(session.method)(**{**session.method.model_dump(), "lucas-kanade": table})}
    )
    one, other = Measurement(session, folder), Measurement(changed, folder)
    assert one.key("cameras") == other.key("cameras")
    assert one.key("tracks") != other.key("tracks")
    assert Measurement(session).key("tracks") == one.key("tracks")
    assert measure(session, folder).reused == ["cameras", "tracking", "injection"]


def test_a_table_of_a_tracker_that_is_not_chosen_changes_no_tracks(measured):
    session = measured[0].session
    plain = {**session.method.model_dump(), "tracker": "icgn"}
    both = [
        session.model_copy(update={"method": type(session.method)(**{**plain, "lucas-kanade": {"window_px": size}})})
        for size in (25, 35)
    ]
    assert both[0].method != both[1].method
    assert Measurement(both[0]).key("tracks") == Measurement(both[1]).key("tracks")


def test_a_check_takes_part_in_the_audit(measured):
    result, folder = measured
    check = result.audit["duration"]
    assert (check.outcome, check.units) == ("caution", "s")
    checks = json.loads((folder / "summary.json").read_text())["audit"]["checks"]
    assert checks[-1]["sentence"].startswith("only 0.6 s were filmed")


@pytest.mark.slow
def test_a_writer_is_an_export(measured, recorded, tmp_path, command):
    result, folder = measured
    path = write_export("jsonl", tmp_path, result.displacement)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["time_s"] for line in lines] == result.displacement["time"].values.tolist()
    expected = result.displacement["displacement"].sel(point="b", axis="down").values
    np.testing.assert_allclose([line["displacement_mm"]["b"]["down"] for line in lines], expected)
    assert command("measure", recorded, "-o", folder, "--export", "jsonl")[0] == 0
    assert (folder / "displacement.jsonl").read_text() == path.read_text()
    status, _, said = command("measure", recorded, "-o", tmp_path / "none", "--export", "json")
    assert status == 1
    assert "export: expected one of" in said
    assert "did you mean 'jsonl'?" in said
    assert not (tmp_path / "none").exists()  # said before any work


def test_info_lists_what_the_package_brings(package):
    lines = describe_environment()
    assert "lucas-kanade: can run (river-tools 1.2)" in lines["trackers"]
    assert "icgn: can run" in lines["trackers"]
    assert "jsonl: can run (river-tools 1.2)" in lines["output writers"]
    assert "duration: can run (river-tools 1.2)" in lines["audit checks"]
    assert "mat: can run" in lines["output writers"]


FAULTS = {
    "unknown key": (
        {"lucas-kanade": {"windw_px": 31}},
        r"lucas-kanade\.windw_px: expected one of the keys window_px, .*",
    ),
    "misspelt key": ({"lucas-kanade": {"windw_px": 31}}, r".* did you mean 'window_px'\?"),
    "wrong type": (
        {"lucas-kanade": {"window_px": "31"}},
        r"lucas-kanade\.window_px: expected a valid integer, got '31'",
    ),
    "out of range": ({"lucas-kanade": {"levels": -1}}, r"lucas-kanade\.levels: expected greater than or equal to 0"),
    "no table": ({"lucas-kanade": 3}, r"lucas-kanade: expected .*, got 3"),
    "misspelt table": ({"lucas-kanada": {}}, r"lucas-kanada: expected one of the keys .*did you mean 'lucas-kanade'\?"),
    "misspelt name": ({"tracker": "lucas-kanada"}, r"tracker: expected one of .*; did you mean 'lucas-kanade'\?"),
    "part without settings": ({"icgn": {}}, r"icgn: expected one of the keys .*"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_told_as_those_of_the_session(package, tmp_path, fault):
    method, message = FAULTS[fault]
    with pytest.raises(SessionError, match=r"method\." + message):
        write_scene(tmp_path, frames=1, **method)


def test_faults_come_all_at_once(package, tmp_path):
    with pytest.raises(SessionError) as caught:
        write_scene(
            tmp_path, frames=1, **{"lucas-kanade": {"levels": -1, "std_px": 0.0}, "cameras": "fil", "subset_px": 40}
        )
    lines = str(caught.value).splitlines()
    starts = ["method.cameras", "method.lucas-kanade.levels", "method.lucas-kanade.std_px", "method.subset_px"]
    assert sorted(line.split(":")[0] for line in lines) == starts


def test_without_the_package_the_session_says_what_is_missing(recorded, tmp_path):
    code = """
import sys
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session
try:
    read_session(sys.argv[1])
except SessionError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code, str(recorded)], capture_output=True, text=True, check=True)
    assert "method.tracker: expected one of ['file', 'icgn', " in done.stdout
    assert "got 'lucas-kanade'; choose one of these, or install the package that brings it" in done.stdout


@pytest.mark.parametrize("table", sorted(registry_lines()))
def test_the_lines_of_the_registry_are_right(package, table, monkeypatch, tmp_path):
    """Inside this package the same code has a line; here its module is the example's."""
    line = eval("{" + registry_lines()[table] + "}", {"Part": Part})
    ((name, part),) = line.items()
    target = part.target.rpartition(".")[2]
    own = replace(
        part, target=f"river_tools.{target}", settings=f"river_tools.{target}.Settings" if part.settings else ""
    )
    kind = next(kind for kind, parts_of_kind in BUILT_IN.items() if parts_of_kind is getattr(parts, table))
    monkeypatch.setitem(BUILT_IN[kind], f"own-{name}", own)
    assert callable(own.load())
    model = own.settings_model()
    if kind == "trackers":
        session = read_session(write_scene(tmp_path, frames=2, tracker=f"own-{name}"))
        assert session.method.tables == {f"own-{name}": model()}
        assert Measurement(session).tracks["left"].attrs["tracker"] == name
    else:
        assert model is None


def test_a_package_installed_by_pip_is_found(tmp_path):
    if find_spec("pip") is None or find_spec("setuptools") is None or int(version("setuptools").split(".")[0]) < 77:
        pytest.skip("needs pip and setuptools >= 77")
    project, target = example_project(tmp_path / "project"), tmp_path / "target"
    words = ["install", "--quiet", "--no-deps", "--no-build-isolation", "--target", str(target), str(project)]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True, capture_output=True)
    code = """
import sys
sys.path.insert(0, sys.argv[1])
from vfm_sdm import find_tracker
from vfm_sdm.commands.environment import describe_environment
print(find_tracker("lucas-kanade").settings.window_px)
print("lucas-kanade: can run (river-tools 1.2)" in describe_environment()["trackers"])
"""
    done = subprocess.run([sys.executable, "-c", code, str(target)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["21", "True"]


def test_paths_in_its_settings_start_at_the_sessions_folder(tmp_path):
    text = """
from pathlib import Path
from vfm_sdm.core.parts import PartSettings
class Tracker:
    class Settings(PartSettings):
        model: Path
    def __init__(self, *, settings):
        self.settings = settings
    def track(self, *args, **options): ...
"""
    with installed(tmp_path / "site", {"vfm_sdm.trackers": {"mine": "paths:Tracker"}}, {"paths": text}):
        (tmp_path / "weights.bin").write_bytes(b"weights")
        file = write_scene(tmp_path, frames=1, tracker="mine", mine={"model": "weights.bin"})
        session = read_session(file)
        assert session.resolved_method.tables["mine"].model == tmp_path / "weights.bin"
        moved = read_session(write_session(tmp_path / "run" / "session.toml", session), check_files=False)
        assert moved.resolve(moved.method.tables["mine"].model).resolve() == tmp_path / "weights.bin"
        before = Measurement(session).key("tracks")
        (tmp_path / "weights.bin").write_bytes(b"other weights")
        assert Measurement(session).key("tracks") != before
        with pytest.raises(
            SessionError, match=r"method\.mine\.model: expected a value, got nothing; add model = \.\.\."
        ):
            write_scene(tmp_path / "other", frames=1, tracker="mine")


def test_another_version_of_the_package_makes_other_keys(recorded, tmp_path):
    keys = set()
    for number in ("1.2", "1.3"):
        with installed(tmp_path / number, example_parts(), example_package(), version=number):
            keys.add(Measurement(read_session(recorded)).key("tracks"))
    assert len(keys) == 2
