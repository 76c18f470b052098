"""Tasks on executors: tried again, lost with their process, named when they fail for good; processes that end."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from vfm_sdm.core.executors import ProcessWorkers, cluster_workers, run_tasks
from vfm_sdm.errors import BackendUnavailableError


def square(number):
    if number < 0:
        raise ValueError(f"no {number}")
    return number**2


def die_at(task):
    """Kills its process where the task says so, as often as it says; counts in a file how often it began."""
    folder, number, times = task
    log = Path(folder) / str(number)
    with log.open("a") as stream:
        stream.write("x")
    if log.stat().st_size <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def fail_at(task):
    """Fails as often as the task says."""
    folder, number, times = task
    log = Path(folder) / str(number)
    with log.open("a") as stream:
        stream.write("x")
    if log.stat().st_size <= times:
        raise OSError(f"try {log.stat().st_size}")
    return number


def tries(folder):
    return {int(path.name): path.stat().st_size for path in Path(folder).iterdir()}


class Here(Executor):
    """Works at once, in this process; remembers how many tasks were with it."""

    def __init__(self, workers=None):
        if workers:
            self.workers = workers
        self.submitted, self.most = [], 0

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:  # noqa: BLE001  (as executors do)
            future.set_exception(error)
        self.submitted.append(args[0])
        return future


@pytest.fixture(scope="module")
def workers():
    with ProcessWorkers(2) as found:
        yield found


@pytest.mark.parametrize("kind", ["none", "here", "threads", "processes"])
def test_the_same_with_every_executor(kind, workers):
    found = {}
    with ThreadPoolExecutor(3) as threads:
        executor = {"none": None, "here": Here(), "threads": threads, "processes": workers}[kind]
        failed = run_tasks(square, [3, -1, 0, 5, -7, *range(10, 100)], executor, found.__setitem__)
    assert {number: str(error) for number, error in failed.items()} == {1: "no -1", 4: "no -7"}
    assert found == {0: 9, 2: 0, 3: 25, **{number - 5: number**2 for number in range(10, 100)}}


def test_no_tasks_need_nobody(workers):
    assert run_tasks(square, [], workers, lambda *_: pytest.fail("done")) == {}


def test_what_fails_twice_is_done_the_third_time(tmp_path, workers):
    done = []
    failed = run_tasks(fail_at, [(tmp_path, n, 2 * (n == 1)) for n in range(3)], workers, lambda n, _: done.append(n))
    assert failed == {}
    assert sorted(done) == [0, 1, 2]
    assert tries(tmp_path) == {0: 1, 1: 3, 2: 1}


def test_what_fails_three_times_has_failed(tmp_path, workers):
    done = []
    failed = run_tasks(fail_at, [(tmp_path, n, 3 * (n == 1)) for n in range(3)], workers, lambda n, _: done.append(n))
    assert {n: str(error) for n, error in failed.items()} == {1: "try 3"}
    assert sorted(done) == [0, 2]


def test_a_task_that_always_kills_its_process_takes_no_other_with_it(tmp_path):
    done = []
    with ProcessWorkers(2) as workers:
        tasks = [(tmp_path, n, 99 * (n == 2)) for n in range(8)]
        failed = run_tasks(die_at, tasks, workers, lambda n, _: done.append(n))
        assert workers.submit(abs, -1).result() == 1  # there are workers again
    assert list(failed) == [2]
    assert "terminated abruptly" in str(failed[2])
    assert sorted(done) == [0, 1, 3, 4, 5, 6, 7]
    assert tries(tmp_path)[2] <= 4
    assert max(count for n, count in tries(tmp_path).items() if n != 2) <= 3


def test_a_task_that_kills_its_process_twice_is_done_the_third_time(tmp_path):
    done = []
    with ProcessWorkers(1) as workers:
        failed = run_tasks(
            die_at, [(tmp_path, n, 2 * (n == 1)) for n in range(3)], workers, lambda n, _: done.append(n)
        )
    assert failed == {}
    assert sorted(done) == [0, 1, 2]


def test_no_more_tasks_are_with_the_workers_than_keep_them_busy():
    class Slow(Here):
        """Hands a result out only when it is asked to wait for it."""

        def submit(self, fn, /, *args, **kwargs):
            self.open = [one for one in getattr(self, "open", []) if not one.done()]
            future = Future()
            self.open.append(future)
            self.most = max(self.most, len(self.open))
            if len(self.open) == 2 * self.workers:
                for one in self.open:
                    one.set_result(0)
            return future

    slow = Slow(workers=3)
    run_tasks(square, list(range(60)), slow, lambda *_: None)
    assert slow.most == 6


def test_an_error_in_keeping_a_result_ends_all_and_takes_back_what_waits():
    class Later(Here):
        def submit(self, fn, /, *args, **kwargs):
            future = super().submit(fn, *args, **kwargs) if args[0] == 1 else Future()
            self.futures = [*getattr(self, "futures", []), future]
            return future

    def refuse(number, result):
        raise OSError("disk full")

    later = Later(workers=2)
    with pytest.raises(OSError, match="disk full"):
        run_tasks(square, [1, 2, 3], later, refuse)
    assert [future.cancelled() for future in later.futures] == [False, True, True]


def test_results_are_not_kept():
    import gc
    import weakref

    class Result:
        pass

    seen = []

    def keep(number, result):
        gc.collect()
        assert sum(one() is not None for one in seen) <= 1  # that of the one before, at most
        seen.append(weakref.ref(result))

    gc.freeze()  # what other tests left: to look through it takes a third of a second each time
    try:
        run_tasks(lambda _: Result(), list(range(50)), ThreadPoolExecutor(1), keep)
        run_tasks(lambda _: Result(), list(range(50)), None, keep)
    finally:
        gc.unfreeze()


def test_interruptions_are_not_taken_for_failures():
    def interrupt(_):
        raise KeyboardInterrupt

    for executor in (None, Here()):
        with pytest.raises(KeyboardInterrupt):
            run_tasks(interrupt, [1, 2], executor, lambda *_: None)


def test_a_task_that_somebody_takes_back_is_one_that_failed():
    class Cancels(Here):
        def submit(self, fn, /, *args, **kwargs):
            future = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            self.submitted.append(args[0])
            return future

    cancels = Cancels()
    failed = run_tasks(square, [4], cancels, lambda *_: None)
    assert isinstance(failed[0], CancelledError)
    assert cancels.submitted == [4, 4, 4]


def test_workers_that_are_lost_for_good_are_not_waited_for(monkeypatch):
    class Lost(Here):
        def submit(self, fn, /, *args, **kwargs):
            return Future()

        def is_lost(self):
            return True

    monkeypatch.setattr("vfm_sdm.core.executors._PATIENCE_S", 0.1)
    with pytest.raises(
        BackendUnavailableError, match="workers: expected them to be there to the end, got none any more"
    ):
        run_tasks(square, [4], Lost(), lambda *_: None)


PARENT = """
import os, signal, sys, time
from vfm_sdm.core.executors import ProcessWorkers

def sleep(seconds):
    time.sleep(seconds)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which is not so where the tests run in the background
    with ProcessWorkers(2) as workers:
        print(workers.submit(os.getpid).result(), flush=True)
        futures = [workers.submit(time.sleep, 600) for _ in range(4)]
        time.sleep(1)
        print("waiting", flush=True)
        futures[0].result()
"""


def children_of(process):
    """Read from /proc: `ps` cuts its lines at COLUMNS, also in a pipe."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parent = int(stat.read_text().rsplit(")", 1)[1].split()[1])
            if parent == process and b"spawn_main" in stat.with_name("cmdline").read_bytes():
                found.append(int(stat.parent.name))
    return found


def is_running(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_processes_end_with_their_parent_at_once(tmp_path, sign):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as run:
        first = int(run.stdout.readline())
        assert run.stdout.readline() == "waiting\n"
        workers = children_of(run.pid)
        assert first in workers
        assert len(workers) == 2
        run.send_signal(sign)
        try:
            run.wait(timeout=20)
        finally:
            run.kill()
    limit = time.monotonic() + 10
    while any(map(is_running, workers)) and time.monotonic() < limit:
        time.sleep(0.05)
    assert [one for one in workers if is_running(one)] == []


def test_no_scheduler_is_named():
    pytest.importorskip("distributed")
    import vfm_sdm.core.executors as executors

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executors, "_PATIENCE_S", 1)
        with (
            pytest.raises(
                BackendUnavailableError,
                match=r"scheduler: expected a Dask scheduler at tcp://127\.0\.0\.1:9, got .+; start one with `dask sch",
            ),
            cluster_workers("tcp://127.0.0.1:9"),
        ):
            pass
        with (
            pytest.raises(BackendUnavailableError, match="expected a Dask scheduler at nonsense://x, got"),
            cluster_workers("nonsense://x"),
        ):
            pass


def test_no_dask_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(
            BackendUnavailableError,
            match=r"expected dask\.distributed, got no such package; install vfm-sdm\[cluster\]",
        ),
        cluster_workers("tcp://127.0.0.1:9"),
    ):
        pass
