"""Fusion of video and accelerometer: what comes out beside the truth, how well it says so, and where it declines."""

from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.analysis.fusion import FusionSettings, fuse, read_fusion, write_fusion
from vfm_sdm.core.datasets import START
from vfm_sdm.core.statuses import FusionStatus
from vfm_sdm.errors import DatasetError, ResultsError
from vfm_sdm.outputs.report import find_language
from vfm_sdm.stages.synchronize import LagSearch
from vfm_sdm.studies.synthetic.sensed_point import STATIC, SensedPoint, record_point

WHAT = SensedPoint(duration_s=20.0, gap_s=(6.0, 7.0))


@pytest.fixture(scope="module")
def records():
    return record_point(WHAT, 1)


@pytest.fixture(scope="module")
def fused(records):
    displacement, acceleration, _ = records
    return fuse(displacement, acceleration, "mid", axes=["vertical"], static=STATIC)


def errors(fused, truth, axis="vertical"):
    """Errors of fused samples [mm], and their standard deviations."""
    one = fused.sel(axis=axis)
    # Samples are the sensor's, in order; clocks differ by what was found of the lag.
    first = int(np.argmin(np.abs(truth["time"].values - one["time"].values[0])))
    true_s = one["time"].values
    expected = np.interp(true_s, truth["time"].values, truth["displacement"].sel(axis=axis).values)
    near = truth["time"].values[first : first + len(true_s)]
    assert np.abs(near - true_s).max() < 1e-3
    slope = np.gradient(truth["displacement"].sel(axis=axis).values, truth["time"].values)[first : first + len(true_s)]
    expected = truth["displacement"].sel(axis=axis).values[first : first + len(true_s)] + slope * (true_s - near)
    return one["displacement"].values - expected, one["displacement_std"].values


def test_less_than_half_the_error_of_the_video_and_intervals_that_are_no_wider_than_needed(records, fused):
    _, _, truth = records
    error, std = errors(fused, truth)
    rms = np.sqrt(np.mean(error**2))
    assert rms < 0.5 * WHAT.video_std_mm
    assert np.mean(np.abs(error) < 1.96 * std) > 0.85
    assert np.sqrt(np.mean(std**2)) < 2 * rms


def test_lag_gain_and_noise_are_found(fused):
    one = fused.sel(axis="vertical")
    lag_at_middle = WHAT.lag_s + (WHAT.clock_rate - 1) * WHAT.duration_s / 2
    assert abs(float(one["lag"]) - lag_at_middle) < max(4 * float(one["lag_std"]), 5e-4)
    assert abs(float(one["gain"]) - 1 / WHAT.gain) < 4 * float(one["gain_std"]) < 0.05
    assert 0.5 < float(one["sensor_noise"]) / WHAT.sensor_noise < 2
    assert 0.8 < float(one["stated_ratio"]) < 1.25
    assert float(one["bias"]) == pytest.approx(-9.807, abs=0.02)
    assert 0.8 < float(one["innovation_ratio"]) < 1.2


def test_a_gap_is_bridged_with_growing_uncertainty_and_nothing_beyond_the_video(fused):
    one, time_s = fused.sel(axis="vertical"), fused["time"].values
    bridged = one["status"].values == 1
    assert 0.9 < np.ptp(time_s[bridged]) < 1.1
    std = one["displacement_std"].values
    middle, edge = std[np.argmin(np.abs(time_s - 6.5))], std[np.argmin(np.abs(time_s - 6.02))]
    assert middle > edge > np.median(std[~bridged]) * 0.9
    assert time_s[0] >= 0
    assert time_s[-1] <= WHAT.duration_s


def test_fast_motion_that_the_video_cannot_show_is_there(records, fused):
    _, _, truth = records
    for series, clock in ((fused, fused["time"].values), (truth, truth["time"].values)):
        values = series["displacement"].sel(axis="vertical").values
        inside = (clock > 8) & (clock < 18)
        spectrum = np.abs(np.fft.rfft(values[inside] * np.hanning(inside.sum())))
        frequency = np.fft.rfftfreq(inside.sum(), 1 / WHAT.rate_hz)
        power = np.sqrt(np.sum(spectrum[(frequency > 36) & (frequency < 40)] ** 2))
        if series is fused:
            found = power
    assert found / power == pytest.approx(1, abs=0.05)


def test_files_come_back(fused, tmp_path):
    assert read_fusion(tmp_path) is None
    paths = write_fusion(tmp_path, fused)
    assert [path.name for path in paths] == ["fused.nc", "fused.csv"]
    again = read_fusion(tmp_path)
    xr.testing.assert_allclose(again["displacement"], fused["displacement"])
    lines = paths[1].read_text().splitlines()
    assert lines[0] == "time_s,vertical_mm,vertical_std_mm,vertical_combined_std_mm,vertical_status"
    assert len(lines) == fused.sizes["time"] + 1
    assert {line.split(",")[-1] for line in lines[1:]} == {"ok", "bridged"}
    paths[0].write_bytes(b"nothing")
    with pytest.raises(ResultsError, match=r"a fusion.*vfm-sdm fuse"):
        read_fusion(tmp_path)


def test_a_sensor_elsewhere_has_no_fusion(records):
    displacement, acceleration, _ = records
    noise = np.random.default_rng(0).normal(size=acceleration["acceleration"].shape)
    other = acceleration.assign(acceleration=(acceleration["acceleration"].dims, noise, {"units": "m/s2"}))
    found = fuse(displacement, other, "mid", axes=["vertical"])
    assert found.attrs["status"] == FusionStatus.NO_MOTION
    assert found.sizes["time"] == 0


def changed(acceleration, change):
    """The acceleration after a function of its values (T, 1, A)."""
    values = acceleration["acceleration"].values.copy()
    return acceleration.assign(acceleration=acceleration["acceleration"].copy(data=change(values)))


def test_other_units_and_a_reversed_axis_have_no_fusion(records):
    displacement, acceleration, _ = records
    in_g = fuse(displacement, changed(acceleration, lambda v: v / 9.81), "mid", axes=["vertical"], static=STATIC)
    assert in_g.attrs["status"] == FusionStatus.OTHER_SIZE
    assert in_g.sizes["time"] == 0
    reversed_one = fuse(displacement, changed(acceleration, lambda v: v * [1, -1]), "mid", static=STATIC)
    assert reversed_one["axis"].values.tolist() == ["lateral"]
    assert any("vertical: left out" in note for note in reversed_one.attrs["notes"])


def test_a_lone_wrong_sample_is_bridged_and_named(records, fused):
    displacement, acceleration, _ = records

    def spoil(values):
        values[2000, 0, 1] = 1e6
        return values

    found = fuse(displacement, changed(acceleration, spoil), "mid", axes=["vertical"], static=STATIC)
    assert float(np.abs(found["displacement"].values - fused["displacement"].values).max()) < 0.05
    assert any("1 lone samples are bridged, the first at 9.7 s" in note for note in found.attrs["notes"])


def test_a_jump_of_the_video_is_named(records):
    displacement, acceleration, _ = records
    values = displacement["displacement"].values.copy()
    values[300:] += 2.0
    jumped = displacement.assign(displacement=displacement["displacement"].copy(data=values))
    found = fuse(jumped, acceleration, "mid", axes=["vertical"], static=STATIC)
    assert any("at 10.00 s the video is off what the sensor predicts" in note for note in found.attrs["notes"])


def test_a_lag_outside_the_search_has_no_fusion(records):
    displacement, acceleration, _ = records
    settings = FusionSettings(search=LagSearch(search_s=0.3, start_lag_s=-2.0))
    found = fuse(displacement, acceleration, "mid", axes=["vertical"], settings=settings)
    assert found.attrs["status"] != FusionStatus.OK
    assert found.sizes["time"] == 0


@pytest.fixture(scope="module")
def late():
    """Records whose clocks are 40 s apart, as their start times say to the second, with three gaps of the logger."""
    what = SensedPoint(duration_s=15.0)
    displacement, acceleration, _ = record_point(what, 2)
    values, seconds = acceleration["acceleration"].values.copy(), acceleration["time"].values
    for begin in (3.5, 7.2, 11.0):
        values[(seconds >= begin) & (seconds < begin + 0.1)] = np.nan
    acceleration = acceleration.assign(acceleration=acceleration["acceleration"].copy(data=values))
    acceleration = acceleration.assign_coords(time=("time", seconds + 40.0, {"units": "s"}))
    lag_s = what.lag_s + 40.0
    acceleration.attrs["start_utc"] = "2026-11-20T10:15:18.600+00:00"
    # An event at time zero of the video is at lag_s on the sensor's clock, which began at 39.7 s.
    begun = datetime.fromisoformat("2026-11-20T10:15:18.600+00:00") + timedelta(seconds=lag_s - 39.7)
    return displacement.assign_attrs({START: begun.replace(microsecond=0).isoformat()}), acceleration, lag_s


def test_start_times_tell_where_the_lag_lies_and_missing_samples_do_not_hide_it(late):
    displacement, acceleration, lag_s = late
    found = fuse(displacement, acceleration, "mid", axes=["vertical"], static=STATIC)
    assert found.attrs["status"] == FusionStatus.OK, found.attrs["notes"]
    assert abs(float(found["lag"][0]) - lag_s) < max(4 * float(found["lag_std"][0]), 1e-3)
    (note,) = [one for one in found.attrs["notes"] if "start times" in one]
    assert note.startswith("the lag is looked for within 2 s of 40.1")
    assert "nach den Anfangszeiten" in find_language("de").tell(note).text


def test_without_start_times_a_lag_far_away_is_not_found(late):
    displacement, acceleration, _ = late
    del acceleration.attrs["start_utc"]
    assert fuse(displacement, acceleration, "mid", axes=["vertical"]).attrs["status"] != FusionStatus.OK


def test_without_static_points_a_note_says_what_is_assumed(records):
    displacement, acceleration, _ = records
    found = fuse(displacement, acceleration, "mid", axes=["vertical"])
    assert any("no static point" in note for note in found.attrs["notes"])


def test_where_the_sensor_recorded_nothing_there_is_nothing(records):
    displacement, acceleration, _ = records
    values = acceleration["acceleration"].values.copy()
    values[2000:2200] = np.nan
    codes = np.where(np.isnan(values), 1, 0).astype(np.int8)
    broken = acceleration.assign(
        acceleration=(acceleration["acceleration"].dims, values, {"units": "m/s2"}),
        status=(acceleration["acceleration"].dims, codes),
    )
    found = fuse(displacement, broken, "mid", axes=["vertical"], static=STATIC).sel(axis="vertical")
    lost = found["status"].values == 2
    assert 190 <= lost.sum() <= 210
    assert np.isnan(found["displacement"].values[lost]).all()
    assert np.isfinite(found["displacement"].values[~lost]).all()


@pytest.mark.parametrize(
    ("point", "axes", "said"),
    [("other", (), "point: expected one of"), ("mid", ("longitudinal",), "axes: expected some of")],
)
def test_names_that_do_not_exist_are_refused(records, point, axes, said):
    with pytest.raises(DatasetError, match=said):
        fuse(records[0], records[1], point, axes=axes)


@pytest.mark.hundreds
@pytest.mark.parametrize("what", [SensedPoint(slow_share=0.0), SensedPoint(slow_share=0.6, sensor_noise=2e-3)])
def test_intervals_hold_over_many_records(what):
    inside, gaps = [], []
    for seed in range(40):
        displacement, acceleration, truth = record_point(replace(what, gap_s=(20.0, 21.0)), seed)
        fused = fuse(displacement, acceleration, "mid", axes=["vertical"], static=STATIC)
        error, std = errors(fused, truth)
        held = np.abs(error) < 1.96 * std
        inside.append(held.mean())
        gaps.append(held[fused["status"].values[:, 0] == 1].mean())
    assert 0.93 <= np.mean(inside) <= 0.97
    assert 0.90 <= np.mean(gaps) <= 0.99
