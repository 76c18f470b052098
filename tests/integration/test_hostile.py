"""Bad days from films to millimetres: what is stated as measured is right, or said not to be fit to use."""

import numpy as np
import pytest

from vfm_sdm.core.datasets import Status
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.statuses import Verdict
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import measure
from vfm_sdm.studies.synthetic.field_test import make_field_test
from vfm_sdm.studies.synthetic.presets import HOSTILE, preset

FEWEST = 10
"""Samples with which a series counts."""
MOVES_MM = 1.0


# Those of which no sample can be trusted take five minutes of a processor, and only name what is wrong.
LONGEST = ("hostile-2", "hostile-4")


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.hundreds] * (name in LONGEST)) for name in HOSTILE],
)
def measured(request, tmp_path_factory):
    """Plan, result and truth of a hostile day."""
    plan = preset(request.param, "small")
    folder = make_field_test(tmp_path_factory.mktemp(request.param), plan).parent
    result = measure(read_session(folder / "session_further.toml"), tmp_path_factory.mktemp("run"))
    return plan, result, read_displacement(folder / "truth.nc")


def compare(result, truth):
    """Of every series with samples: NRMSE, NaN for what hardly moves, correlation, coverage, largest error over std."""
    figures = []
    if result.displacement is None:
        return np.empty((0, 4))
    for point in result.displacement["point"].values:
        for axis in result.displacement["axis"].values:
            seen = result.displacement.sel(point=point, axis=axis)
            ok = ((seen["status"] == Status.OK) & np.isfinite(seen["displacement"])).values
            if ok.sum() < FEWEST:
                continue
            known = truth["displacement"].sel(point=point, axis=axis)
            known = np.interp(seen["time"], known["time"], known)
            error, std = (seen["displacement"].values - known)[ok], seen["combined_std"].values[ok]
            swing = np.ptp(known)
            moves = swing > MOVES_MM
            nrmse = np.sqrt(np.mean(error**2)) / swing if moves else np.nan
            correlation = np.corrcoef(seen["displacement"].values[ok], known[ok])[0, 1] if moves else np.nan
            figures.append((nrmse, correlation, np.mean(np.abs(error) < 1.96 * std), np.max(np.abs(error) / std)))
    return np.reshape(figures, (-1, 4))


@pytest.mark.slow
def test_no_sample_of_a_hostile_day_is_ok_and_wrong(measured):
    _, result, truth = measured
    figures = compare(result, truth)
    assert (figures[:, 3] < 5).all(), figures.round(3).tolist()


@pytest.mark.slow
def test_a_hostile_day_is_fit_to_use_only_where_it_is_right(measured):
    _, result, truth = measured
    audit = result.summary["audit"]
    if audit is not None and audit["verdict"] == Verdict.FIT:
        figures = compare(result, truth)
        assert np.nanmean(figures[:, 0]) < 0.03
        assert np.nanmin(figures[:, 1]) > 0.95
        assert (figures[:, 2] > 0.93).all()


@pytest.mark.slow
def test_blunders_and_lost_frames_are_named(measured):
    plan, result, _ = measured
    audit = result.summary["audit"]
    if plan.blunders and audit is not None:
        assert {check["name"]: check["outcome"] for check in audit["checks"]}["site and lenses"] == "fail"
    if any(recording.disturbances.timing and recording.disturbances.timing.dropped for recording in plan.recordings):
        assert any("dropped frames" in note for note in result.summary["notes"])
