"""Every example as a reader would run it.

Those that measure the demonstration share one recording and one run folder, as they do on a reader's machine.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples"
EXAMPLES = sorted(FOLDER.glob("plot_*.py"))
ON_THE_DEMO = {name for name in EXAMPLES if "demo_session" in name.read_text(encoding="utf-8")}
QUICKEST = FOLDER / "plot_refinement.py"
PNG = b"\x89PNG\r\n\x1a\n"


def example_cases():
    """Filming and measuring the demonstration takes longer than the default run allows."""
    for path in EXAMPLES:
        yield pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path in ON_THE_DEMO else [])


@pytest.fixture(scope="module")
def shared_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("examples")


def run(example, *words, cwd, shared):
    environment = {**os.environ, "MPLBACKEND": "Agg", "TMPDIR": str(cwd), "VFM_SDM_EXAMPLES": str(shared)}
    command = [sys.executable, "-W", "error", str(example), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env=environment)


def test_there_are_examples():
    names = {example.stem.removeprefix("plot_") for example in EXAMPLES}
    assert {"measure", "uncertainty_budget", "audit", "synchronization", "refinement", "camera_motion"} <= names
    assert {"accelerometer", "tracker_by_hand", "three_views", "load_test", "repeat", "field"} <= names
    assert ON_THE_DEMO
    listed = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert [example.name for example in EXAMPLES if f"| `{example.name}` |" not in listed] == []


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_an_example_says_what_it_shows_and_how_to_run_it(example):
    text = example.read_text(encoding="utf-8")
    assert f"\n    python examples/{example.name} [FOLDER]\n" in text.split('"""')[1]


@pytest.mark.parametrize("example", list(example_cases()))
def test_example_draws_its_figure_where_asked(example, tmp_path, shared_folder):
    done = run(example, tmp_path / "new" / "folder", cwd=tmp_path, shared=shared_folder)
    assert done.returncode == 0, done.stderr
    figure = tmp_path / "new" / "folder" / f"{example.stem.removeprefix('plot_')}.png"
    assert done.stdout == f"written: {figure}\n"
    assert figure.read_bytes().startswith(PNG)
    assert [path.name for path in figure.parent.iterdir()] == [figure.name]


def test_without_a_folder_the_figure_goes_to_a_temporary_one(tmp_path, shared_folder):
    done = run(QUICKEST, cwd=tmp_path, shared=shared_folder)
    assert done.returncode == 0, done.stderr
    figure = Path(done.stdout.removeprefix("written: ").strip())
    assert figure.is_relative_to(tmp_path)
    assert figure.read_bytes().startswith(PNG)
