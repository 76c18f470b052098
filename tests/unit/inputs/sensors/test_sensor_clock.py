"""Stamps that are not even: put right where nothing is guessed, else refused with the place."""

import numpy as np
import pytest

from sensor_files import HEADER, RATE, put, rows, swinging
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration

TIME, VALUES = swinging(4.0)
NUMBERS = np.arange(len(TIME))


def read(folder, stamps, values=VALUES, **how):
    return read_acceleration(put(folder, [HEADER, *rows(stamps, values)]), units="m/s2", **how)


def test_bursts_without_loss_become_even(tmp_path):
    for size in (3, 5):
        found = read(tmp_path, TIME[NUMBERS // size * size])
        assert found.attrs["sampling_rate_hz"] == pytest.approx(RATE, rel=1e-6)
        np.testing.assert_allclose(found["time"].values, TIME, atol=1e-6)
        np.testing.assert_allclose(found["acceleration"].values[:, 0], VALUES, atol=1e-6)
        assert "time stamps come in bursts" in found.attrs["notes"][0]


def test_bursts_of_any_size_become_even_whichever_sample_their_stamp_is_of(tmp_path):
    edges = np.concatenate([[0], np.cumsum(np.random.default_rng(1).integers(2, 6, len(TIME)))])
    burst = np.searchsorted(edges, NUMBERS, side="right") - 1
    for place in (edges[burst], np.minimum(edges[burst + 1] - 1, NUMBERS[-1])):
        found = read(tmp_path, TIME[place])
        np.testing.assert_allclose(found["time"].values, TIME, atol=1e-6)


def test_stamps_of_whole_seconds_become_even(tmp_path):
    found = read(tmp_path, np.floor(TIME + 0.3), sampling_rate_hz=RATE)
    np.testing.assert_allclose(np.diff(found["time"].values), 1 / RATE)
    assert "the stated 200 Hz are believed" in found.attrs["notes"][0]


def test_a_lost_burst_is_named(tmp_path):
    kept = (NUMBERS < 300) | (NUMBERS >= 305)
    with pytest.raises(DatasetError, match=r"bursts of about 5 samples .* around row 30\d, as where samples are lost"):
        read(tmp_path, TIME[NUMBERS // 5 * 5][kept], VALUES[kept])


def test_stamps_of_arrival_need_the_rate(tmp_path):
    late = np.random.default_rng(0).uniform(0, 0.02, len(TIME) // 10)
    arrival = TIME[NUMBERS // 10 * 10] + late[NUMBERS // 10] + NUMBERS % 10 * 1e-4
    with pytest.raises(DatasetError, match=r"stamps of arrival are not those of the samples; state the sensor's rate"):
        read(tmp_path, arrival)
    np.testing.assert_allclose(np.diff(read(tmp_path, arrival, sampling_rate_hz=RATE)["time"].values), 1 / RATE)


@pytest.mark.parametrize("lost", [NUMBERS % 10 == 9, (NUMBERS > 300) & (NUMBERS < 350)])
def test_missing_samples_leave_their_place(tmp_path, lost):
    found = read(tmp_path, TIME[~lost], VALUES[~lost])
    values, status = found["acceleration"].values[:, 0], found["status"].values[:, 0]
    inside = NUMBERS[: len(values)]
    np.testing.assert_array_equal(np.isnan(values).all(axis=1), lost[inside])
    np.testing.assert_array_equal((status == 1).all(axis=1), lost[inside])
    np.testing.assert_allclose(values[~lost[inside]], VALUES[inside][~lost[inside]], atol=1e-6)


def test_too_many_missing_samples_are_refused(tmp_path):
    kept = NUMBERS % 5 != 4
    with pytest.raises(DatasetError, match=r"got 0\.01 s before row 6; cut the recording .* samples are missing"):
        read(tmp_path, TIME[kept], VALUES[kept])


def test_a_pause_may_change_the_phase(tmp_path):
    paused = np.where(NUMBERS >= 400, TIME + 0.1023, TIME)
    found = read(tmp_path, paused, np.sin(2 * np.pi * 2 * paused)[:, None] * [1, 1, 1])
    values, clock = found["acceleration"].values[:, 0, 0], found["time"].values
    known = np.isfinite(values)
    np.testing.assert_allclose(values[known], np.sin(2 * np.pi * 2 * clock[known]), atol=1e-4)
    assert 15 < (~known).sum() < 25


def test_rows_out_of_order_are_sorted(tmp_path):
    order = NUMBERS.copy()
    order[100:104] = order[100:104][::-1]
    found = read(tmp_path, TIME[order], VALUES[order])
    np.testing.assert_allclose(found["acceleration"].values[:, 0], VALUES, atol=1e-6)
    assert found.attrs["notes"] == ["3 times rows are out of order, first row 103: sorted by time"]


def test_rows_written_twice_count_once(tmp_path):
    for twice in (np.sort(np.concatenate([NUMBERS, NUMBERS[50::97]])), np.repeat(NUMBERS, 2)):
        found = read(tmp_path, TIME[twice], VALUES[twice])
        np.testing.assert_allclose(found["acceleration"].values[:, 0], VALUES, atol=1e-6)
        assert found.attrs["notes"] == [
            f"{len(twice) - len(NUMBERS)} rows are there twice, stamp and values alike: left out"
        ]


def test_a_clock_that_starts_again_is_refused(tmp_path):
    again = np.concatenate([TIME, TIME])
    with pytest.raises(DatasetError, match=r"got 3\.995 s and then 0 s in row 802: the clock starts again there"):
        read(tmp_path, again, np.concatenate([VALUES, VALUES]))


def test_stamps_that_all_but_stand_still_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="most stamps repeated; give finer stamps, or state the rate"):
        read(tmp_path, np.floor(TIME / 2) * 2)
    with pytest.raises(DatasetError, match=r"expected even time stamps|two time stamps|most stamps repeated"):
        read(tmp_path, 0 * TIME)
