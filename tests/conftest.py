"""What all tests share."""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# A worker a processor: more threads would wait for each other, and how many there are decides how sums round. Libraries
# read this when they are first imported, processes that tests start when they begin.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Numba tells all of OpenMP how many threads it takes itself: after the first rendering, PyTorch would have that many,
# too, and with a worker a processor the threads of its small networks wait twenty times as long as they compute.
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")

# The same examples in every run, on every machine, however busy it is; --hypothesis-profile=default draws new ones.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

_ROOT = Path(__file__).resolve().parents[1]


def _shared_folder() -> Path:
    return Path(os.environ.get("VFM_SDM_SHARED", _ROOT.parent / "shared"))


_DURATIONS = "vfm-sdm/durations"
"""Entry of pytest's cache: seconds of preparing and of running by the name of the test."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Order and choice of the tests."""
    parser.addoption("--backwards", action="store_true", help="run the last test first: no test may need another")
    parser.addoption(
        "--shorter-than",
        type=float,
        metavar="SECONDS",
        help="leave out tests that took longer when they last ran here; what is prepared counts for its whole file",
    )
    parser.addoption(
        "--end-by",
        type=float,
        metavar="SECONDS",
        help="skip what has not begun by then, in seconds since 1970: a run on a slow machine ends in time and says so",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Files are handed to workers as they are collected: those of whole measurements first, small ones at the end.

    Else xdist begins with the files of most tests, and one of few tests that takes a minute is left for the end.
    """
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Without those that take too long, and from the last to the first, where that was asked for."""
    longest = config.getoption("--shorter-than")
    if longest is not None:
        seconds = _expected_seconds(config)
        config.hook.pytest_deselected(items=[item for item in items if seconds.get(item.nodeid, 0.0) > longest])
        items[:] = [item for item in items if seconds.get(item.nodeid, 0.0) <= longest]
    if config.getoption("--backwards"):
        items.reverse()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Before anything is prepared for a test for which there is no time."""
    end = item.config.getoption("--end-by")
    if end is not None and time.time() > end:
        pytest.skip("there was no time left for it")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Notes how long each test took."""
    _noted.setdefault(report.nodeid, {})[report.when] = report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keeps what was noted, once: workers tell the process that started them."""
    cache = getattr(session.config, "cache", None)  # there is none with -p no:cacheprovider
    if _noted and not hasattr(session.config, "workerinput") and cache is not None:
        cache.set(_DURATIONS, cache.get(_DURATIONS, {}) | _noted)


_noted: dict[str, dict[str, float]] = {}


def _expected_seconds(config: pytest.Config) -> dict[str, float]:
    """Of a test that is run by itself: its own, and the longest that a test of its file took to prepare.

    What tests of a file share is prepared for whichever comes first.
    """
    cache = getattr(config, "cache", None)
    durations: dict[str, dict[str, float]] = {} if cache is None else cache.get(_DURATIONS, {})
    prepared: dict[str, float] = {}
    for name, seconds in durations.items():
        file = name.partition("::")[0]
        prepared[file] = max(prepared.get(file, 0.0), seconds.get("setup", 0.0))
    return {name: one.get("call", 0.0) + prepared[name.partition("::")[0]] for name, one in durations.items()}


@pytest.fixture(scope="session", autouse=True)
def no_weights_of_this_machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests see no fetched weights: what they show must not depend on who runs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VFM_SDM_WEIGHTS", str(tmp_path_factory.mktemp("no_weights")))
        yield


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Folder of a real data set by name; the test skips where the data are not at hand."""

    def find(name: str) -> Path:
        folder = _shared_folder() / "data" / name
        if not folder.is_dir():
            pytest.skip(f"real data {name!r} are not here; set VFM_SDM_SHARED to the folder that holds data/")
        return folder

    return find


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements of this test draw no figures, which take a third of the time of a small one."""
    monkeypatch.setattr("vfm_sdm.measurement.save_figures", lambda *_, **__: [])


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs a command line as if typed; returns exit status, standard output and standard error.

    Its terminal has no colours and no edge, whatever the caller's: where lines break and tables are squeezed would
    depend on the length of temporary paths.
    """
    from vfm_sdm.commands import app as cli
    from vfm_sdm.commands.terminal import ERR, OUT

    plain = {"_width": 10_000, "_height": 100, "_force_terminal": False, "_color_system": None}
    for console in (OUT, ERR):
        for name, value in plain.items():
            monkeypatch.setattr(console, name, value)

    def run(*words: object) -> tuple[int, str, str]:
        try:
            cli.main([str(word) for word in words])
            status = 0
        except SystemExit as stop:
            status = stop.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run
