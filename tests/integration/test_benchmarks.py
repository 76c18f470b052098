"""Every script in ``benchmarks/`` runs at its smallest size, and ends with its figures as one line of JSON."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark_lines import read_last_line, without_unit

ROOT = Path(__file__).parents[2]
SMALLEST = {
    "end_to_end": ["--frames", "20", "--repeats", "1"],
    "drone": ["--frames", "12", "--width", "640", "--whole-squares"],
    "drone_points": ["--frames", "40"],
    "field": ["--draws", "1", "--points", "60"],
    "injection": ["--frames", "70", "--seeds", "1", "--contrasts", "20", "--crf", "24", "--preset", "ultrafast"],
    "fusion": ["--records", "1", "--duration", "15", "--cases", "good sensor", "phone"],
    "plan": ["--simulated", "2", "--rendered", "1", "--optimised", "1", "--tries", "4"],
    "lines": ["--draws", "1", "--readings", "level alone", "--rectangles", "1"],
    "page": ["--height", "360", "--repeats", "1"],
    "pairs": ["--width", "640", "--only", "wall", "--most", "3"],
    "lens": ["--draws", "1", "--views", "40"],
    "load_test": ["--tests", "3"],
    "long": ["--height", "360", "--minutes", "0.1", "0.2"],
    "long, a day": ["--day", "0.1"],
    "scale": ["--draws", "1", "--priors", "2 %", "5 %"],
    "profiles": ["--kinds", "drone", "--sites", "1"],
    "references": ["--frames", "40", "--minutes", "4", "--segment-s", "60", "--seeds", "1"],
    "modes": ["--runs", "1", "--seconds", "16"],
    "refinement": ["--rounds", "1", "--frames", "60", "--longest", "1000", "--points", "10"],
    "tracking": ["--frames", "4", "--slow-frames", "3", "--repeats", "1"],
    "posediffusion": ["--iterations", "1", "--matches", "50"],
    "verdicts": ["--runs", "1", "--seeds", "1", "--faults", "both views drop frames", "a clipped reference"],
    "triangulation": ["--points", "40", "--rounds", "1"],
}
SLOW = {
    "drone",
    "drone_points",
    "end_to_end",
    "fusion",
    "injection",
    "lens",
    "lines",
    "long",
    "long, a day",
    "page",
    "pairs",
    "plan",
    "profiles",
    "references",
    "scale",
    "verdicts",
}
NEEDS = {"profiles": "lens_profiles"}
"""Real data without which a script has nothing to do."""
NEEDS_TORCH = {"posediffusion"}
ELSEWHERE = {"vggt": "test_benchmark_vggt.py", "vggt_costs": "no script, but what vggt counts with"}
COLUMN = re.compile(r"(?<=\S)(?:  +|: +)(?=\S)")


def script_of(name):
    """Script of a way through it, named behind a comma where there are several."""
    return name.partition(",")[0]


def test_every_script_is_here():
    scripts = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    assert scripts == {*map(script_of, SMALLEST), *ELSEWHERE}


@pytest.mark.parametrize("name", sorted({*map(script_of, SMALLEST)}))
def test_a_script_says_how_to_use_it(name, monkeypatch, capsys):
    script = ROOT / "benchmarks" / f"{name}.py"
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    monkeypatch.setattr(sys, "argv", [str(script), "--help"])
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(script), run_name="__main__")
    assert left.value.code == 0
    assert "usage" in capsys.readouterr().out


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in SMALLEST]
)
def test_a_benchmark_prints_a_table_and_its_figures(name, tmp_path, shared_data):
    if name in NEEDS:
        shared_data(NEEDS[name])
    if name in NEEDS_TORCH:
        pytest.importorskip("torch")
    command = [sys.executable, str(ROOT / "benchmarks" / f"{script_of(name)}.py"), *SMALLEST[name]]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env=os.environ, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    table, quantities = read_last_line(done.stdout)
    assert len(quantities) >= 4
    assert list(without_unit(quantities)) == []
    # A table: rows of a name and numbers in columns, a heading among them or before them.
    rows = [row for row in table if COLUMN.search(row)]
    assert len(rows) >= 3, table
    assert sum(bool(re.search(r"\d", row)) for row in rows) >= 2, table
    assert max(map(len, table)) <= 140
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("quantities", "missing"),
    [
        ({"tracking_s": 1.0, "error_px": 0.1, "ratio": 2.0, "frames": 3}, []),
        ({"tracking": 1.0}, ["tracking"]),
        ({"paper": {"peak_memory": 4.0, "floor_s": 1.0}}, ["paper.peak_memory"]),
        ({"frames_lost": 3, "reduced": True, "device": "CPU"}, ["frames_lost"]),
    ],
)
def test_a_key_without_a_unit_is_noticed(quantities, missing):
    assert list(without_unit(quantities)) == missing
