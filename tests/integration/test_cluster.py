"""Segments on a Dask cluster, whose workers may be lost: the bytes of a run without one."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from scenes import write_scene
from vfm_sdm.commands.options import WorkerOptions
from vfm_sdm.core.executors import cluster_workers, run_tasks
from vfm_sdm.errors import BackendUnavailableError, SessionError

dask = pytest.importorskip("dask")
pytest.importorskip("distributed", reason="needs dask.distributed: pip install vfm-sdm[cluster]")

pytestmark = pytest.mark.slow

RATE = 6
_PATIENCE_S = 60


def start(stack: ExitStack, log: Path, *words: str) -> subprocess.Popen[bytes]:
    """A command of Dask in a process of its own, which ends with the block."""
    # Functions of this file are known by its name.
    known = os.pathsep.join(path for path in sys.path if path)
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words],
            stdout=stream,
            stderr=stream,
            env={**os.environ, "PYTHONPATH": known},
        )

    def end() -> None:
        process.kill()
        process.wait()

    stack.callback(end)
    return process


def wait_for(log: Path, pattern: str) -> str:
    limit = time.monotonic() + _PATIENCE_S
    while time.monotonic() < limit:
        if found := re.search(pattern, log.read_text(errors="replace")):
            return found[1]
        time.sleep(0.1)
    pytest.fail(f"no {pattern} in: {log.read_text(errors='replace')}")


class Cluster:
    """A scheduler and workers of one thread each, without nannies that would begin them anew."""

    def __init__(self, stack: ExitStack, folder: Path, workers: int) -> None:
        self._stack, self._folder = stack, folder
        log = folder / "scheduler.log"
        self.scheduler = start(
            stack, log, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show"
        )
        self.address = wait_for(log, r"Scheduler at:\s+(tcp://\S+)")
        self.workers = [self.add() for _ in range(workers)]
        for number in range(workers):
            wait_for(folder / f"worker{number}.log", r"(Registered to)")

    def add(self) -> subprocess.Popen[bytes]:
        number = len(list(self._folder.glob("worker*.log")))
        words = ["worker", self.address, "--nworkers", "1", "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        log = self._folder / f"worker{number}.log"
        return start(self._stack, log, *words, "--local-directory", str(self._folder / f"scratch{number}"))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(stack, tmp_path_factory.mktemp("cluster"), 2)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    path = write_scene(tmp_path_factory.mktemp("scene"), frames=24, injection=False, segment_s=1.0)
    path.write_text(path.read_text().replace("fps = 20.0", f"fps = {RATE}.0"))
    return path


def fail_twice(folder):
    """Fails as often as its folder has no two files yet."""
    count = len(list(Path(folder).iterdir()))
    (Path(folder) / str(count)).touch()
    if count < 2:
        raise OSError(f"try {count}")
    return count


def test_what_fails_on_a_cluster_is_truly_tried_again(cluster, tmp_path):
    done = {}
    with cluster_workers(cluster.address) as workers:
        assert run_tasks(fail_twice, [str(tmp_path)], workers, done.__setitem__) == {}
    assert done == {0: 2}


def test_a_session_on_a_cluster_that_loses_a_worker_has_the_same_bytes(cluster, scene, tmp_path, command):
    assert command("track", scene, "-o", tmp_path / "here")[0] == 0
    out, begun = tmp_path / "there", threading.Event()

    def kill_when_begun() -> None:
        limit = time.monotonic() + _PATIENCE_S
        while not list(out.glob("tracks/*/*.npz")) and time.monotonic() < limit:
            time.sleep(0.01)
        cluster.workers[0].send_signal(signal.SIGKILL)
        begun.set()

    killer = threading.Thread(target=kill_when_begun)
    killer.start()
    status, _, said = command("track", scene, "-o", out, "--scheduler", cluster.address)
    killer.join()
    assert status == 0, said
    assert begun.is_set()
    assert cluster.workers[0].wait(timeout=10) == -signal.SIGKILL
    assert cluster.workers[1].poll() is None
    assert (out / "tracks.nc").read_bytes() == (tmp_path / "here" / "tracks.nc").read_bytes()
    assert not (out / "tracks").exists()


def test_a_scheduler_that_ends_in_the_middle_is_named(tmp_path):
    with ExitStack() as stack:
        lone = Cluster(stack, tmp_path, 1)
        stack.enter_context(dask.config.set({"distributed.comm.timeouts.connect": "1s"}))
        threading.Timer(2, lone.scheduler.kill).start()
        with (
            pytest.raises(BackendUnavailableError, match="expected them to be there to the end, got none any more"),
            cluster_workers(lone.address) as workers,
        ):
            run_tasks(time.sleep, [60.0], workers, lambda *_: pytest.fail("done"))


def test_a_scheduler_that_is_not_there_is_named(scene, tmp_path, command, monkeypatch):
    monkeypatch.setattr("vfm_sdm.core.executors._PATIENCE_S", 1)
    status, _, said = command("track", scene, "-o", tmp_path, "--scheduler", "tcp://127.0.0.1:9")
    assert status == 1
    assert "scheduler: expected a Dask scheduler at tcp://127.0.0.1:9, got" in said
    assert "start one with `dask scheduler`, and workers with `dask worker`" in said


@pytest.mark.parametrize("words", [["--workers", "-1"], ["--workers", "2", "--scheduler", "tcp://127.0.0.1:9"]])
def test_workers_that_contradict_each_other_are_refused(scene, tmp_path, command, words):
    status, _, said = command("track", scene, "-o", tmp_path, *words)
    assert status == 1
    assert "--workers: expected a number of processes, or --scheduler alone, got" in said
    assert "leave one out" in said


def test_options_of_workers():
    with WorkerOptions().executor() as executor:
        assert executor is None
    with WorkerOptions(workers=1).executor() as executor:
        assert executor.submit(os.getpid).result() != os.getpid()
    with pytest.raises(SessionError, match="got 1 and tcp://x; leave one out"), WorkerOptions(1, "tcp://x").executor():
        pass
