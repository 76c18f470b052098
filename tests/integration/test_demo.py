"""The demonstration: a rendered recording, measured without calibration, against its truth."""

import numpy as np
import pytest

from vfm_sdm.commands.demo import run_demo
from vfm_sdm.core.netcdf import read_displacement


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return run_demo(tmp_path_factory.mktemp("demo"))


def test_within_a_tenth_of_a_millimetre_in_every_axis(demo):
    rows = demo.evaluation.rows
    assert {row.axis for row in rows} == {"lateral", "vertical", "longitudinal"}
    assert max(row.rms_error_mm for row in rows) <= 0.1
    assert max(row.reference_peak_to_peak_mm for row in rows) > 5


def test_cameras_are_solved_without_calibration(demo):
    assert demo.measurement.cameras.status == "ok"
    assert demo.measurement.session.method.cameras == "two-view"
    assert demo.measurement.displacement.attrs["frame"] == "structure"


def test_gains_lie_within_their_stated_uncertainty(demo):
    scale_std = demo.measurement.displacement["scale_std"]
    checked = 0
    for row in demo.evaluation.rows:
        if row.reference_peak_to_peak_mm > 2:
            assert abs(row.score.gain - 1) <= 3 * float(scale_std.sel(point=row.point, axis=row.axis))
            checked += 1
    assert checked >= 6


def test_the_stated_random_part_is_the_scatter(demo):
    truth = read_displacement(demo.run_folder.parent / "recording" / "truth.nc")
    measured = demo.measurement.displacement
    error = measured["displacement"].values - truth["displacement"].values
    static = [i for i, name in enumerate(measured["point"].values) if "abutment" in str(name)]
    ratio = error[:, static].std(axis=0) / np.median(measured["displacement_std"].values[:, static], axis=0)
    assert 0.4 < ratio.min() <= ratio.max() < 1.6
