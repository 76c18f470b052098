"""Runs that are killed at any moment and begun again end with the very bytes of one that nobody disturbed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from scenes import write_scene
from vfm_sdm.core.netcdf import read_tracks
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement

FRAMES, RATE = 18, 6
FILES = ("tracks.nc", "displacement.nc", "displacement.csv", "points.nc", "cameras.toml")
KILLER = """
import json, os, sys
from contextlib import nullcontext
from pathlib import Path
import vfm_sdm.core.block_files as blocks
import vfm_sdm.core.files as files
from vfm_sdm.core.executors import ProcessWorkers
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement

def run(session, out, workers, moment):
    done = [0]
    def count(*_, half=None):
        done[0] += 1
        if done[0] == moment:
            if half is not None:  # in the middle of a file
                half.with_name(f".{half.stem}-0123abcd{half.suffix}").write_bytes(b"half")
            os.kill(os.getpid(), 9)
    append = blocks.BlockFile.append
    def append_counted(self, block):
        count()
        append(self, block)
    blocks.BlockFile.append = append_counted
    whole = files.write_file
    def write(path, content):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        count(half=Path(path))
        return whole(path, content)
    for module in list(sys.modules.values()):
        if getattr(module, "write_file", None) is whole:
            module.write_file = write
    with ProcessWorkers(workers) if workers else nullcontext() as executor:
        Measurement(session, out, executor=executor, progress=count).run("displacement")
    return done[0]

if __name__ == "__main__":
    session, out, workers = read_session(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    if sys.argv[4] == "long":  # nothing is whole in memory
        for module in list(sys.modules.values()):
            if hasattr(module, "LONG_BYTES"):
                module.LONG_BYTES = 1
    for line in sys.stdin:
        moment = json.loads(line)
        if moment is None:
            print(json.dumps(run(session, out, workers, None)), flush=True)
            continue
        child = os.fork()
        if child == 0:
            run(session, out, workers, moment)
            os._exit(0)
        print(json.dumps(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])), flush=True)
"""


def write_slow_scene(folder: Path, frames: int) -> Path:
    """The scene at so few frames a second that it has several segments of a second, the shortest there are."""
    path = write_scene(folder, frames=frames, injection=False, segment_s=1.0)
    text = path.read_text()
    assert "fps = 20.0" in text
    path.write_text(text.replace("fps = 20.0", f"fps = {RATE}.0"))
    return path


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    return write_slow_scene(tmp_path_factory.mktemp("scene"), FRAMES)


@pytest.fixture(scope="module")
def undisturbed(scene, tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("undisturbed")
    result = Measurement(read_session(scene), folder).run("displacement")
    assert {tracks.attrs["recording"]["segments"] for tracks in result.tracks.values()} == {3}
    assert not (folder / "tracks").exists()
    return contents(folder)


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


class Runner:
    """A process that runs the session again and again, in children that are killed at a moment."""

    def __init__(self, folder: Path, scene: Path, out: Path, workers: int, length: str = "short") -> None:
        script = folder / "killer.py"
        script.write_text(KILLER)
        words = [sys.executable, str(script), str(scene), str(out), str(workers), length]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, moment: int | None) -> int:
        """Exit status of a run that is killed at an event; the number of events of one that is not."""
        self.process.stdin.write(json.dumps(moment) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def __enter__(self) -> "Runner":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("kills", [5, pytest.param(50, marks=pytest.mark.hundreds)])
def test_killed_runs_end_with_the_bytes_of_an_undisturbed_one(scene, undisturbed, tmp_path, command, workers, kills):
    rng = np.random.default_rng(kills + workers)
    with Runner(tmp_path, scene, tmp_path / "whole", workers) as whole:
        events = whole.run(None)
    assert contents(tmp_path / "whole") == undisturbed
    out, killed, pieces = tmp_path / "run", 0, 0
    with Runner(tmp_path, scene, out, workers) as runner:
        for number in range(kills):
            # Events are frames or segments, and files; a run that goes on has fewer than one from the beginning.
            # The first kill is in the middle of tracking.
            moment = int(rng.integers(1, events + 1)) if number else events // 2
            if rng.random() < 0.15:
                (out / "tracks.nc").unlink(missing_ok=True)  # so that there is something to do to the last kill
            status = runner.run(moment)
            assert status in (0, -9)
            killed += status == -9
            pieces = max(pieces, len(list(out.glob("tracks/*/*.npz"))))
    assert killed >= min(kills // 2, 3)
    words = ["displacement", scene, "-o", out, *(["--workers", workers] if workers else [])]
    assert command(*words)[0] == 0
    assert contents(out) == undisturbed
    assert not (out / "tracks").exists()
    assert not [path.name for path in out.rglob(".*")]
    assert not (out / "run.owner").exists()
    assert pieces > 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.slow
@pytest.mark.parametrize("kills", [5, pytest.param(50, marks=pytest.mark.hundreds)])
def test_killed_runs_of_tracks_that_lie_in_files_end_alike(scene, undisturbed, tmp_path, kills):
    """Nothing of them is left, and values are those of a run in memory."""
    rng, out = np.random.default_rng(kills), tmp_path / "run"
    with Runner(tmp_path, scene, tmp_path / "whole", 0, "long") as whole:
        events = whole.run(None)
    written, in_memory = contents(tmp_path / "whole"), tmp_path / "in memory"
    assert written["displacement.csv"] == undisturbed["displacement.csv"]
    in_memory.mkdir()
    (in_memory / "tracks.nc").write_bytes(undisturbed["tracks.nc"])
    for view, tracks in read_tracks(tmp_path / "whole").items():
        xr.testing.assert_identical(
            tracks.drop_attrs(), read_tracks(in_memory)[view][list(tracks.variables)].drop_attrs()
        )
    with Runner(tmp_path, scene, out, 0, "long") as runner:
        for _ in range(kills):
            if rng.random() < 0.3:
                (out / "tracks.nc").unlink(missing_ok=True)
            runner.run(int(rng.integers(1, events + 1)))
        runner.run(None)
    assert contents(out) == written
    assert not [path.name for path in out.rglob(".*")]


def test_a_run_goes_on_where_it_was_killed(scene, undisturbed, tmp_path, monkeypatch):
    """Segments that were tracked before are not tracked again."""
    monkeypatch.setattr("vfm_sdm.stages.tracking.segments._MOST_AT_ONCE", 1)  # in their order

    class Killed(BaseException):
        pass

    def stop(what, done, total):
        if what == "tracking right" and done == 15:
            raise Killed

    session, out, said = read_session(scene), tmp_path / "run", []
    with pytest.raises(Killed):
        Measurement(session, out, progress=stop).run("displacement")
    assert sorted(str(path.relative_to(out)) for path in out.glob("tracks/*/*")) == [
        str(Path("tracks", group, f"000{number}.npz"))
        for group, count in (("0", 3), ("1", 2))
        for number in range(count)
    ]
    Measurement(session, out, progress=lambda what, done, total: said.append((what, done))).run("displacement")
    assert [done for what, done in said if what == "tracking right"] == list(range(13, FRAMES + 1))
    assert "tracking left" not in {what for what, _ in said}
    assert contents(out) == undisturbed


def test_inputs_beside_the_results_stay(tmp_path):
    """Folders of the session that are called like a product are nobody's pieces."""
    scene = write_slow_scene(tmp_path, 12)
    text = scene.read_text()
    for name in ("left", "right"):
        (tmp_path / "tracks").mkdir(exist_ok=True)
        (tmp_path / name).rename(tmp_path / "tracks" / name)
        text = text.replace(f'"{name}/*.png"', f'"tracks/{name}/*.png"')
    scene.write_text(text)
    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras" / "board.png").write_bytes(b"mine")
    Measurement(read_session(scene), tmp_path).run("displacement")
    assert len(list(tmp_path.glob("tracks/*/*.png"))) == 24
    assert (tmp_path / "cameras" / "board.png").exists()
