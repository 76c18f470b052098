import json

import numpy as np
import pytest

from vfm_sdm.analysis.evaluation import ReferenceClock, evaluate, write_evaluation
from vfm_sdm.analysis.evaluation.metrics import nrmse_range
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.core.sensor_datasets import ReferenceFacts, make_reference
from vfm_sdm.errors import DatasetError, ResultsError
from vfm_sdm.signals.filters import band_pass

TIME = np.arange(480) / 30
POINTS = ("mid", "quarter", "abutment")
FIGURES = ("nrmse_range", "correlation", "rppae", "gain", "skill", "lag_s")


def motion(time_s, point=0, axis=0):
    """Displacement [mm] of a footbridge that is walked on; in closed form, nothing repeats."""
    phase = 0.9 * point + 1.7 * axis
    walk = np.sin(2 * np.pi * 2.31 * time_s + phase + 0.8 * np.sin(0.7 * time_s)) * (1 + 0.6 * np.sin(0.45 * time_s))
    return (4 - axis) * walk + 0.8 * np.sin(2 * np.pi * 4.4 * time_s + phase + 1.1 * np.sin(0.9 * time_s))


def measured(time_s=TIME, *, change=lambda values: values, std=0.05, scale_std=0.0, **attrs):
    """Displacement of two moving points and a static one; ``change`` says what the measurement makes of it."""
    shape = (len(time_s), len(POINTS), 3)
    values = np.stack([[motion(time_s, p, a) * (p < 2) for a in range(3)] for p in range(3)]).transpose(2, 0, 1)
    return make_displacement(
        time_s,
        POINTS,
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=change(values),
            displacement_std_mm=np.full(shape, std),
            scale_std=np.full(shape[1:], scale_std),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2], int),
        ),
        attrs={"frame": "structure", **attrs},
    )


def sensors(lag_s=0.0, *, ratio=1.0, duration_s=20.0, band_hz=(1.0, 10.0), axes=STRUCTURE_AXES, offset=7.0):
    """What sensors at the moving points say: a clock and a zero of their own."""
    stamps = np.arange(int(duration_s * 30)) / 30
    true = (stamps - lag_s) * ratio
    values = np.stack([[motion(true, p, STRUCTURE_AXES.index(a)) for a in axes] for p in range(2)]).transpose(2, 0, 1)
    return make_reference(stamps, ("s1", "s2"), axes, values + offset, facts=ReferenceFacts(30, 0, band_hz))


PAIRS = {"mid": "s1", "quarter": "s2"}


def test_truth_is_compared_sample_by_sample():
    rng = np.random.default_rng(3)
    noise = 0.05 * rng.standard_normal((480, 3, 3))
    truth = measured(std=0.0, title="truth")
    result = evaluate(measured(change=lambda values: 1.1 * values + 0.3 + noise), truth)
    assert result.synchronization is None
    assert result.band_hz is None
    assert result.reference_name == "truth"
    assert {row.point for row in result.rows} == {"mid", "quarter"}
    row = result.row("quarter", "vertical")
    true, seen = motion(TIME, 1, 1), 1.1 * motion(TIME, 1, 1) + 0.3 + noise[:, 1, 1]
    assert row.score.nrmse_range == pytest.approx(nrmse_range(seen, true))
    assert row.score.gain == pytest.approx(1.1, abs=0.01)
    assert row.score.offset == pytest.approx(0.3, abs=0.01)
    assert not row.score.offset_removed
    assert row.rms_error_mm == pytest.approx(np.sqrt(np.mean((seen - true) ** 2)))
    assert row.estimate_peak_to_peak_mm == pytest.approx(np.ptp(seen))
    assert row.reference_peak_to_peak_mm == pytest.approx(np.ptp(true))
    assert row.score.samples == 480


@pytest.mark.parametrize(("scale_std", "expected"), [(0.0, 0.23), (0.1, 1.0)])
def test_the_stated_interval_holds_random_and_systematic_part(scale_std, expected):
    seen = measured(change=lambda values: 1.1 * values, scale_std=scale_std)
    row = evaluate(seen, measured()).row("mid", "lateral")
    assert row.score.coverage == pytest.approx(expected, abs=0.02)
    d = 1.1 * motion(TIME)
    by_hand = np.abs(d - motion(TIME)) <= 2 * np.sqrt(0.05**2 + (scale_std * d) ** 2)
    assert row.score.coverage == pytest.approx(by_hand.mean())


def test_a_sensor_is_aligned_by_itself():
    result = evaluate(measured(), sensors(lag_s=1.2345), pairs=PAIRS)
    assert result.synchronization.lag_s == pytest.approx(1.2345, abs=5e-4)
    assert result.band_hz == (1.0, 10.0)
    assert result.reference_name == "sensors s1, s2"
    assert len(result.scored_rows) == 4
    for row in result.rows:
        assert row.score.nrmse_range < 0.005
        assert row.score.skill > 0.999
        assert row.score.offset_removed
        assert row.score.lag_s == pytest.approx(0, abs=1e-3)
        assert np.isnan(row.score.coverage)
        assert row.score.band_hz == (1.0, 10.0)
        assert row.score.samples > 450


def test_a_known_lag_is_taken_as_it_is():
    reference = sensors(lag_s=0.8)
    right = evaluate(measured(), reference, pairs=PAIRS, clock=ReferenceClock(synchronize=False, start_lag_s=0.8))
    assert right.synchronization is None
    assert right.row("mid", "lateral").score.nrmse_range < 0.002
    # The reference happens 6 ms too late then, so the estimate happens 6 ms too early.
    wrong = evaluate(measured(), reference, pairs=PAIRS, clock=ReferenceClock(synchronize=False, start_lag_s=0.794))
    assert wrong.row("mid", "lateral").score.lag_s == pytest.approx(-6e-3, abs=2e-4)
    assert wrong.row("mid", "lateral").score.nrmse_range > 0.01


def test_a_drifting_clock_is_followed():
    time_s = np.arange(75 * 30) / 30
    reference = sensors(lag_s=0.5, ratio=1.0002, duration_s=76)
    result = evaluate(measured(time_s), reference, pairs=PAIRS)
    assert result.synchronization.rate_ratio == pytest.approx(1.0002, abs=2e-5)
    assert all(row.score.nrmse_range < 0.005 for row in result.rows)


def test_displacement_with_another_clock_can_be_aligned():
    late = measured().assign_coords(time=("time", TIME + 0.4, {"units": "s"}))
    result = evaluate(late, measured(), clock=ReferenceClock(synchronize=True))
    assert result.synchronization.lag_s == pytest.approx(-0.4, abs=5e-4)
    assert not result.rows[0].score.offset_removed
    # Unless told so, clocks of displacement are one.
    assert evaluate(late, measured()).rows[0].score.skill < 0.9


def test_the_lag_that_is_left_is_that_of_the_estimate():
    late = measured(change=lambda values: 1.2 * values)
    truth = measured(TIME - 0.004).assign_coords(time=("time", TIME, {"units": "s"}))
    # The truth's values are those of 4 ms earlier at every stamp: the estimate happens 4 ms too early.
    assert evaluate(late, truth).row("mid", "vertical").score.lag_s == pytest.approx(-0.004, abs=2e-4)
    opposite = measured(change=lambda values: -values)
    assert np.isnan(evaluate(opposite, truth).row("mid", "vertical").score.lag_s)


def test_both_sides_are_filtered_to_one_band():
    rng = np.random.default_rng(5)
    drift = 3 * np.sin(2 * np.pi * 0.11 * TIME)[:, None, None] + 0.2 * rng.standard_normal((480, 3, 3))
    seen = measured(change=lambda values: values + drift)
    raw = evaluate(seen, measured())
    banded = evaluate(seen, measured(), band_hz=(1.0, 6.0))
    row = banded.row("mid", "lateral")
    expected = [band_pass(v, 30, (1.0, 6.0)) for v in (seen["displacement"].values[:, 0, 0], motion(TIME))]
    assert row.score.nrmse_range == pytest.approx(nrmse_range(*expected), rel=1e-6)
    assert row.score.nrmse_range < 0.2 * raw.row("mid", "lateral").score.nrmse_range
    assert row.score.band_hz == (1.0, 6.0)


def test_a_recorded_displacement_is_not_filtered():
    result = evaluate(measured(scale_std=0.01), sensors(0.3, band_hz=(0.0, 15.0)), pairs=PAIRS)
    assert result.band_hz is None
    assert result.row("mid", "lateral").score.coverage > 0.99
    assert result.row("mid", "lateral").score.offset == pytest.approx(-7, abs=0.02)
    assert result.notes == ()


def test_a_band_beyond_the_references_is_noted():
    notes = evaluate(measured(), sensors(0.3), pairs=PAIRS, band_hz=(0.5, 6.0)).notes
    assert notes == ("the band 0.5 to 6 Hz is wider than the reference's, 1 to 10",)


@pytest.mark.parametrize("band_hz", [None, (1.0, 6.0)])
def test_missing_frames_do_not_shift_what_follows(band_hz):
    there = np.delete(np.arange(480), [100, 101, 250])
    result = evaluate(measured(TIME[there]), measured(), band_hz=band_hz)
    for row in result.rows:
        assert row.score.nrmse_range < 0.02 if band_hz else row.score.nrmse_range < 1e-6
        assert 460 < row.score.samples <= 477


def test_lost_samples_do_not_count():
    def lose(values):
        values[200:260, 0] = np.nan
        return values

    result = evaluate(measured(change=lose), measured())
    assert result.row("mid", "lateral").score.samples == 420
    assert result.row("quarter", "lateral").score.samples == 480
    assert result.row("mid", "lateral").score.nrmse_range < 1e-9


def test_without_a_lag_there_is_no_figure(tmp_path):
    rng = np.random.default_rng(2)
    reference = sensors()
    reference["displacement"].values[:] = rng.standard_normal(reference["displacement"].shape)
    result = evaluate(measured(), reference, pairs=PAIRS, clock=ReferenceClock(search_s=1.0))
    assert result.notes == (
        f"lag of the reference unknown: {result.synchronization.status}; widen or narrow the search, or state the lag",
    )
    assert result.scored_rows == ()
    assert len(result.rows) == 4
    assert all(np.isnan(getattr(row.score, name)) for row in result.rows for name in FIGURES)
    assert all(np.isnan(row.rms_error_mm) for row in result.rows)
    assert np.isnan(result.mean_and_std()["rppae"]).all()
    written = json.loads(write_evaluation(tmp_path, result).read_text())
    assert written["rows"][0]["score"]["nrmse_range"] is None
    assert written["synchronization"]["lag_s"] is None
    assert written["mean"] == {"nrmse_range": None, "correlation": None, "rppae": None}


def test_what_cannot_be_compared_is_named():
    def lose(values):
        values[5:, 1] = np.nan
        return values

    pairs = {"mid": "mid", "quarter": "quarter", "abutment": "abutment"}
    result = evaluate(measured(change=lose), measured(), pairs=pairs, axes=("vertical", "forward"))
    assert result.notes[0] == "left out: axes ['forward'], which one side does not have"
    assert result.notes[1].startswith("'quarter', vertical: estimate: expected at least 10 samples known")
    assert result.notes[2].startswith("'abutment', vertical: reference: expected a signal that moves")
    assert [np.isfinite(row.score.nrmse_range) for row in result.rows] == [True, False, False]
    assert [row.point for row in result.scored_rows] == ["mid"]


def test_mean_and_std_are_those_of_the_scored_rows():
    def change(values):
        values[:, 0] *= 1.1
        values[:, 1] *= 1.3
        return values

    result = evaluate(measured(change=change), measured(), axes=["lateral"])
    assert result.mean_and_std()["rppae"] == pytest.approx((0.2, 0.1))
    one = evaluate(measured(change=change), measured(), axes=["lateral"], pairs={"mid": "mid", "abutment": "abutment"})
    assert one.mean_and_std()["rppae"] == pytest.approx((0.1, 0.0))


def test_the_file_says_everything(tmp_path):
    result = evaluate(measured(), sensors(lag_s=0.5), pairs=PAIRS)
    path = write_evaluation(tmp_path / "run", result)
    assert path == tmp_path / "run" / "evaluation.json"
    written = json.loads(path.read_text())
    assert written["reference"] == "sensors s1, s2"
    assert written["band_hz"] == [1.0, 10.0]
    assert written["synchronization"]["lag_s"] == result.synchronization.lag_s
    assert written["synchronization"]["offset_s"] == result.synchronization.offset_s
    assert written["rows"][1]["point"] == "mid"
    assert written["rows"][1]["axis"] == "vertical"
    assert written["rows"][1]["score"]["gain"] == result.row("mid", "vertical").score.gain
    assert written["rows"][1]["score"]["coverage"] is None
    assert written["mean"]["correlation"] == result.mean_and_std()["correlation"][0]
    (tmp_path / "file").touch()
    with pytest.raises(ResultsError, match=r"expected to write it, got: .*; choose another folder"):
        write_evaluation(tmp_path / "file", result)


def test_misuse_is_refused():
    truth = measured()
    with pytest.raises(DatasetError, match=r"axes: expected some of \['forward'\] on both sides"):
        evaluate(measured(), truth, axes=["forward"])
    for pairs in ({"mid": "nobody"}, {"nobody": "mid"}, {}):
        with pytest.raises(DatasetError, match=r"pairs: expected points of .* got .*; pair them"):
            evaluate(measured(), truth, pairs=pairs)
    with pytest.raises(DatasetError, match=r"pairs: expected points of .* got \{\}; pair them"):
        evaluate(measured(), sensors())
    with pytest.raises(DatasetError, match="time: expected at least 4 stamps on both sides, got 3 and 480"):
        evaluate(measured(TIME[:3]), truth)
    with pytest.raises(DatasetError, match="expected attributes onset_s and band_hz"):
        evaluate(measured(), sensors().drop_attrs(deep=False).assign_attrs(sampling_rate_hz=30), pairs=PAIRS)
    with pytest.raises(DatasetError, match="expected a variable 'position'"):
        evaluate(measured(), truth.drop_vars("position"))
    with pytest.raises(DatasetError, match=r"row: expected one of .*, got \('abutment', 'lateral'\)"):
        evaluate(measured(), truth).row("abutment", "lateral")
