"""Every script in ``benchmarks/`` runs at its smallest size, and ends with its figures as one line of JSON."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SMALLEST = {
    "end_to_end": ["--frames", "12", "--repeats", "1"],
    "refinement": ["--rounds", "1"],
    "tracking": ["--frames", "4", "--slow-frames", "3", "--repeats", "1"],
    "triangulation": ["--points", "40", "--rounds", "1"],
}
SLOW = {"end_to_end", "refinement"}
ELSEWHERE = {"vggt": "test_benchmark_vggt.py", "vggt_costs": "no script, but what vggt counts with"}
UNITS = re.compile(r"_(s|ms|mb|gb|px|mm|1|hz|per_s)$|ratio|error|share|processors|frames|points|difference|count")


def test_every_script_is_here():
    scripts = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    assert scripts == {*SMALLEST, *ELSEWHERE}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in SMALLEST]
)
def test_a_benchmark_prints_a_table_and_its_figures(name, tmp_path):
    command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *SMALLEST[name]]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=os.environ, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    *table, last = done.stdout.splitlines()
    figures = json.loads(last)
    assert len(figures) >= 4
    numbers = {key: value for key, value in figures.items() if isinstance(value, int | float)}
    assert numbers
    unnamed = [key for key in numbers if not UNITS.search(key)]
    assert unnamed == [], "keys that name neither a unit nor a plain number"
    assert sum(any(char.isdigit() for char in line) for line in table) >= 3
    assert list(tmp_path.iterdir()) == []
