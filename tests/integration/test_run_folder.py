"""What a run folder promises when runs are killed, mixed, damaged, or started beside each other."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from scenes import write_scene
from vfm_sdm.core.netcdf import read_displacement, read_tracks, write_displacement
from vfm_sdm.core.run_folder import RunFolder
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.session import Session, read_session, session_hash, write_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.stages.cameras.file import read_rig, write_rig

KILLER = """
import json, os, sys
from pathlib import Path
import vfm_sdm.core.files as files
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import measure

def kill_after(count):
    whole, done = files.write_file, [0]
    def write(path, content):
        done[0] += 1
        if done[0] > count:  # in the middle of a file
            with files.replace_file(path) as temporary:
                temporary.write_bytes(b"half")
                os.kill(os.getpid(), 9)
        return whole(path, content)
    for module in list(sys.modules.values()):
        if getattr(module, "write_file", None) is whole:
            module.write_file = write

sessions, out = [read_session(path) for path in sys.argv[1:3]], Path(sys.argv[3])
for number, count in json.loads(sys.argv[4]):
    child = os.fork()
    if child == 0:
        kill_after(count)
        measure(sessions[number], out)
        os._exit(0)
    os.waitpid(child, 0)
    print("killed", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture(scope="module")
def paths(tmp_path_factory) -> list[Path]:
    """Two sessions of one recording, the second with cameras twice as far apart: everything is twice as large."""
    first = write_scene(tmp_path_factory.mktemp("scene"), injection=False)
    session = read_session(first)
    write_rig(first.with_name("twice.toml"), read_rig(first.with_name("rig.toml")).scaled(2.0))
    views = [view.model_copy(update={"camera": Path("twice.toml")}) for view in session.view]
    other = Session(**{**dict(session), "name": "twice as large", "view": tuple(views)})
    return [first, write_session(first.with_name("large.toml"), other)]


@pytest.fixture(scope="module")
def folders(paths, tmp_path_factory) -> list[Path]:
    """A run of each session, to copy."""
    made = [tmp_path_factory.mktemp("whole") for _ in paths]
    for path, folder in zip(paths, made, strict=True):
        measure(read_session(path), folder)
    return made


@pytest.fixture
def run(folders, tmp_path) -> Path:
    """A finished run of the first session, which a test may damage."""
    return Path(shutil.copytree(folders[0], tmp_path / "run"))


@pytest.fixture(scope="module")
def finished(paths, folders) -> dict[str, float]:
    """Largest displacement [mm] by name of the session."""
    sizes = {}
    for path, folder in zip(paths, folders, strict=True):
        session, found = read_session(path), read_displacement(folder)
        sizes[session.name] = float(np.abs(found["displacement"]).max())
    small, large = sizes.values()
    assert large == pytest.approx(2 * small, rel=0.01)
    return sizes


def check_no_mixture(folder: Path, sizes: dict[str, float]) -> bool:
    """Whether the folder holds a displacement that a reader is given; then it is that of the session beside it."""
    if not (folder / "displacement.nc").exists():
        return False
    displacement = read_displacement(folder)
    session = read_session(folder / "session.resolved.toml", check_files=False)
    try:
        RunFolder(folder).check_whole("displacement", displacement.attrs)
    except ResultsError:
        return False
    size = sizes[session.name]
    assert float(np.abs(displacement["displacement"]).max()) == pytest.approx(size, rel=1e-6)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["session_hash"] == displacement.attrs["session_hash"]
    for point in summary.get("points", {}).values():
        for name, axis in point["axes"].items():
            spans = displacement["displacement"].sel(axis=name)
            assert axis["peak_to_peak_mm"] <= float(spans.max() - spans.min()) * (1 + 1e-6)
    return True


def kill_runs(paths, folder, kills):
    """Runs that die in the middle of their n-th file, one after the other; yields after each."""
    words = [sys.executable, "-c", KILLER, *map(str, paths), str(folder), json.dumps(kills)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        for _ in kills:
            assert process.stdout.readline() == "killed\n"
            yield
            process.stdin.write("\n")
            process.stdin.flush()
    assert process.returncode == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("count", [3, pytest.param(30, marks=[pytest.mark.slow, pytest.mark.hundreds])])
def test_killed_runs_leave_no_mixture(paths, finished, run, count):
    rng = np.random.default_rng(count)
    folder = run
    # A run writes some 15 files; the last of these kills come at figures.
    kills = [[(k + 1) % 2, int(n)] for k, n in enumerate(rng.permutation(np.arange(count) * 16 // count))]
    for _ in kill_runs(paths, folder, kills):
        check_no_mixture(folder, finished)
    measure(read_session(paths[1]), folder)
    assert check_no_mixture(folder, finished)
    assert not list(folder.rglob(".*"))


@pytest.mark.usefixtures("undrawn")
def test_the_views_that_were_tracked_before_a_kill_are_not_tracked_again(paths, folders, tmp_path):
    class Killed(BaseException):
        pass

    def stop(what, done, total):
        if what == "tracking right" and done == total - 1:
            raise Killed

    folder, session = tmp_path / "run", read_session(paths[0])
    with pytest.raises(Killed):
        measure(session, folder, progress=stop)
    assert [path.relative_to(folder / "tracks") for path in folder.glob("tracks/*/*")] == [Path("0", "0000.npz")]
    said = []
    again = measure(session, folder, progress=lambda what, done, total: said.append(what))
    assert "tracking right" in said
    assert "tracking left" not in said
    assert again.reused == ["cameras"]
    whole = read_displacement(folders[0])
    np.testing.assert_array_equal(again.displacement["displacement"], whole["displacement"])


def test_results_of_another_session_do_not_stay(paths, run):
    folder = run
    (folder / "displacement.mat").write_bytes(b"an export")
    (folder / "figures" / "displacement_gone.png").write_bytes(b"a figure of a point that is no more")
    (folder / "my notes.txt").write_text("stay")
    other = read_session(paths[1])
    Measurement(other, folder).run("cameras")
    assert not (folder / "displacement.nc").exists()
    assert not (folder / "displacement.mat").exists()
    assert not list(folder.glob("figures/*"))
    assert (folder / "my notes.txt").exists()
    assert RunFolder(folder).record["session_hash"] == session_hash(other)
    assert RunFolder(folder).record["finished"] is False
    measure(other, folder)
    assert RunFolder(folder).record["finished"] is True


def test_figures_that_a_run_no_longer_draws_go(paths, run):
    folder, session = run, read_session(paths[0])
    (folder / "figures" / "trajectory_third.png").write_bytes(b"")
    result = measure(session, folder)
    assert sorted(folder.glob("figures/*")) == sorted(result.figures)


@pytest.mark.usefixtures("undrawn")
def test_a_folder_in_use_is_refused(paths, run):
    folder, session = run, read_session(paths[0])
    inside = RunFolder(folder)
    with (
        inside.opened({"session_hash": "a", "input_hashes": {}}),
        pytest.raises(
            ResultsError,
            match=r"expected a folder that no other run writes to, got one in use by process \d+ on .+ since .+; wait",
        ),
    ):
        measure(session, folder)
    assert measure(session, folder).displacement is not None


class TestReaders:
    def check(self, run: Path) -> tuple[str, ...]:
        return RunFolder(run).check_whole("displacement", read_displacement(run).attrs)

    def test_a_finished_run_is_read(self, run):
        assert self.check(run) == ()

    def test_a_run_that_was_cut_short_is_noted(self, run):
        RunFolder(run).add({"finished": False})
        assert "not measured to its end" in self.check(run)[0]

    def test_another_session_beside_the_results_is_refused(self, run, paths):
        write_session(run / "session.resolved.toml", read_session(paths[1]))
        with pytest.raises(
            ResultsError, match=r"expected results of one session, got another session\.resolved\.toml beside"
        ):
            self.check(run)

    def test_a_folder_in_the_place_of_the_session_is_refused(self, run):
        (run / "session.resolved.toml").unlink()
        (run / "session.resolved.toml").mkdir()
        with pytest.raises(ResultsError, match=r"expected the session that was measured, got: Is a directory; run"):
            self.check(run)

    def test_a_summary_of_another_form_is_read_as_one_without_keys(self, run):
        RunFolder(run).add({"products": "none"})
        assert self.check(run) == ()

    def test_results_that_the_summary_does_not_know_are_refused(self, run):
        displacement = read_displacement(run)
        write_displacement(run, displacement.assign_attrs(key="another"))
        with pytest.raises(ResultsError, match=r"summary.json .* does not know: .* run `vfm-sdm measure` again"):
            self.check(run)

    @pytest.mark.parametrize("file", ["displacement.nc", "tracks.nc", "points.nc"])
    def test_a_file_of_which_a_page_was_lost_is_refused_at_once(self, run, file):
        content = bytearray((run / file).read_bytes())
        content[512:1024] = bytes(512)
        (run / file).write_bytes(content)
        reader = {"displacement.nc": read_displacement, "tracks.nc": read_tracks}.get(file, read_displacement)
        with pytest.raises(ResultsError, match=r"got a damaged file \(its content is not what was written\); run"):
            reader(run / file)

    def test_a_file_that_was_cut_off_is_refused(self, run):
        (run / "tracks.nc").write_bytes((run / "tracks.nc").read_bytes()[:-4096])
        with pytest.raises(ResultsError, match=r"tracks\.nc: expected tracks, got a damaged file"):
            read_tracks(run)

    def test_what_another_program_wrote_has_no_seal_and_is_read(self, run):
        with xr.open_dataset(run / "displacement.nc", decode_times=False) as opened:
            doubled = opened.load()
        doubled["displacement"] *= 2
        before = read_displacement(run)["displacement"]
        doubled.to_netcdf(run / "displacement.nc", engine="h5netcdf")
        np.testing.assert_array_equal(read_displacement(run)["displacement"], 2 * before)
