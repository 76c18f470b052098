"""Every example as a reader would run it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("plot_*.py"))
PNG = b"\x89PNG\r\n\x1a\n"


def run(example, *words, cwd):
    environment = {**os.environ, "MPLBACKEND": "Agg", "TMPDIR": str(cwd)}
    command = [sys.executable, "-W", "error", str(example), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env=environment)


def test_there_are_examples():
    assert {"plot_accelerometer.py", "plot_refinement.py"} <= {example.name for example in EXAMPLES}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_example_draws_its_figure_where_asked(example, tmp_path):
    done = run(example, tmp_path / "new" / "folder", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figure = tmp_path / "new" / "folder" / f"{example.stem.removeprefix('plot_')}.png"
    assert done.stdout == f"written: {figure}\n"
    assert figure.read_bytes().startswith(PNG)


def test_without_a_folder_the_figure_goes_to_a_temporary_one(tmp_path):
    done = run(EXAMPLES[0], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figure = Path(done.stdout.removeprefix("written: ").strip())
    assert figure.is_relative_to(tmp_path)
    assert figure.read_bytes().startswith(PNG)
