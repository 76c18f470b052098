"""`benchmarks/modes.py`: which poles count as right, whatever they say of themselves."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

FREQUENCY, DAMPING = np.array([1.2, 8.1]), np.array([0.015, 0.015])
SHAPES = np.eye(2)[:, :, None]


@pytest.fixture(scope="module")
def benchmark():
    return runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "modes.py"), run_name="modes")


def poles(*hertz):
    """Poles of the first shape at these frequencies, with intervals that hold everything."""
    count = len(hertz)
    everything = {
        f"{name}{end}": ("mode", np.full(count, value))
        for name in ("frequency", "damping_ratio")
        for end, value in (("_low", 0.0), ("_high", np.inf))
    }
    shape = np.zeros((count, 2, 1), complex)
    shape[:, 0] = 1
    shapes = {"shape": shape, "shape_std": np.full(shape.shape, 0.01)}
    everything |= {name: (("mode", "point", "axis"), values) for name, values in shapes.items()}
    return xr.Dataset({"frequency": ("mode", list(hertz)), **everything})


@pytest.mark.parametrize(
    ("off", "duration_s", "right"),
    [(0.01, 300.0, True), (0.03, 300.0, False), (0.03, 16.0, True), (0.06, 16.0, False)],
)
def test_a_pole_is_right_within_the_peak_or_what_the_record_tells(benchmark, off, duration_s, right):
    found = poles(1.2 * (1 + off))
    (row,) = benchmark["score"](found, FREQUENCY, DAMPING, SHAPES, duration_s=duration_s)
    assert row[0] is right


def test_of_two_poles_at_one_mode_one_is_wrong(benchmark):
    rows = benchmark["score"](poles(1.2, 1.201), FREQUENCY, DAMPING, SHAPES, duration_s=60.0)
    assert [row[0] for row in rows] == [True, False]
