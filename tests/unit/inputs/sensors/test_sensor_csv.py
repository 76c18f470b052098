from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration, read_reference

G = 9.80665


def write(tmp_path, text, name="acc-1.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def tri_axial(tmp_path, samples=8, rate=64.0, digits=6, drop=None):
    lines = ["time,lateral,vertical,longitudinal"]
    lines += [f"{10 + i / rate:.{digits}f},{i},{-i},{2 * i}" for i in range(samples) if i != drop]
    return write(tmp_path, "\n".join(lines) + "\n")


def test_acceleration_in_g_becomes_si(tmp_path):
    data = read_acceleration(tri_axial(tmp_path))
    assert data["acceleration"].dims == ("time", "sensor", "axis")
    assert data["acceleration"].attrs["units"] == "m/s2"
    assert (list(data["sensor"].values), list(data["axis"].values)) == (
        ["acc-1"],
        ["lateral", "vertical", "longitudinal"],
    )
    np.testing.assert_allclose(data["acceleration"].values[:, 0], np.outer(np.arange(8), [G, -G, 2 * G]))
    np.testing.assert_allclose(data["time"].values, 10 + np.arange(8) / 64, atol=1e-6)
    assert data.attrs["sampling_rate_hz"] == pytest.approx(64)
    assert data.attrs["file"] == "acc-1.csv"


def test_named_columns_signs_units_and_start(tmp_path):
    path = write(tmp_path, "﻿t, az ,ay\n0,1,5\n0.5,2,6\n1,3,7\n\n,,\n")
    start = datetime(2026, 11, 20, 11, 30, tzinfo=timezone(timedelta(hours=1)))
    data = read_acceleration(
        path,
        sensor="deck",
        columns={"time": "t", "vertical": "-az", "lateral": "ay"},
        units="m/s2",
        sampling_rate_hz=2.0,
        start=start,
    )
    assert list(data["axis"].values) == ["lateral", "vertical"]
    np.testing.assert_array_equal(data["acceleration"].values[:, 0], [[5, -1], [6, -2], [7, -3]])
    assert list(data["sensor"].values) == ["deck"]
    assert datetime.fromisoformat(data.attrs["start_utc"]) == datetime(2026, 11, 20, 10, 30, tzinfo=UTC)


def test_a_column_whose_name_begins_with_a_minus_is_taken_as_it_is(tmp_path):
    path = write(tmp_path, "-z,z\n1,8\n2,9\n")
    data = read_acceleration(path, columns={"vertical": "-z"}, units="m/s2", sampling_rate_hz=1.0)
    np.testing.assert_array_equal(data["acceleration"].values.ravel(), [1, 2])


def test_without_a_time_column_the_rate_makes_the_clock(tmp_path):
    path = write(tmp_path, "lateral,vertical,longitudinal\n1,2,3\n4,5,6\n7,8,9\n")
    np.testing.assert_allclose(read_acceleration(path, sampling_rate_hz=64.0)["time"].values, np.arange(3) / 64)


def test_rounded_time_stamps_become_an_even_clock(tmp_path):
    data = read_acceleration(tri_axial(tmp_path, samples=641, digits=3))
    np.testing.assert_allclose(data["time"].values, 10 + np.arange(641) / 64, atol=1e-9)


def test_a_displacement_sensor_in_mm_with_a_gap(tmp_path):
    path = write(tmp_path, "time,vertical\n0,1.5\n0.1,\n0.2,2.5\n", "lvdt.csv")
    data = read_reference(path)
    assert data["displacement"].attrs["units"] == "mm"
    np.testing.assert_array_equal(data["displacement"].values[:, 0, 0], [1.5, np.nan, 2.5])
    assert list(data["axis"].values) == ["vertical"]
    assert data.attrs["onset_s"] == 0
    assert data.attrs["band_hz"] == [0.0, pytest.approx(5.0)]
    metres = read_reference(path, columns={"lateral": "-vertical"}, units="m")
    np.testing.assert_array_equal(metres["displacement"].values[:, 0, 0], [-1500, np.nan, -2500])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("time,lateral,vertical,up\n0,1,2,3\n1,1,2,3\n", r"expected a column 'longitudinal', got \['time', 'lateral'"),
        ("a,b,c\n1,2,3\n1,2,3\n", "expected a column 'lateral'"),
        ("time,lateral,vertical,longitudinal\n", "expected a line of names and at least 2 below it, got 1 lines"),
        (
            "time,lateral,vertical,longitudinal\n0,1,2,3\n1,1,x,3\n",
            "expected a number in row 3, column 'vertical', got 'x'",
        ),
        ("time,lateral,vertical,longitudinal\n0,1,2,\n1,1,1,3\n", "row 2, column 'longitudinal', got ''"),
        ("time,lateral,vertical,longitudinal\n0,1,2,nan\n1,1,1,3\n", "row 2, column 'longitudinal', got 'nan'"),
        ("time,lateral,vertical,longitudinal\n0,inf,2,2\n1,1,1,3\n", "row 2, column 'lateral', got 'inf'"),
        ("time,lateral,vertical,longitudinal\n0,1,2\n1,1,1,3\n", "expected 4 cells in row 2, got 3"),
        ("time,lateral,vertical,vertical\n0,1,2,3\n1,1,1,3\n", r"got \['vertical'\] more than once"),
        ("lateral,vertical,longitudinal\n0,1,2\n1,1,1\n", "expected a time column or sampling_rate_hz, got neither"),
        (b"\xff\xfe\x00", "expected a CSV file in UTF-8"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path, text, match):
    with pytest.raises(DatasetError, match=match):
        read_acceleration(write(tmp_path, text))


def test_a_lost_sample_is_named(tmp_path):
    with pytest.raises(DatasetError, match=r"expected samples 0.015625 s apart, got 0.03125 s before row 5; cut"):
        read_acceleration(tri_axial(tmp_path, drop=3))


def test_time_that_runs_backwards_is_refused(tmp_path):
    path = write(tmp_path, "time,vertical\n3,1\n2,1\n1,1\n0,1\n")
    with pytest.raises(DatasetError, match="expected rising time stamps, got -1 s between samples"):
        read_reference(path)


def test_other_misuse_is_refused(tmp_path):
    path = tri_axial(tmp_path)
    with pytest.raises(DatasetError, match=r"expected a CSV file in UTF-8, got: .*No such file"):
        read_acceleration(tmp_path / "none.csv")
    with pytest.raises(DatasetError, match=r"expected columns for some of .* got \['time', 'up'\]"):
        read_acceleration(path, columns={"time": "time", "up": "vertical"})
    with pytest.raises(
        DatasetError, match=r"expected a column 'lateral', got \['time', 'x'\]; .* --column vertical='x'"
    ):
        read_reference(write(tmp_path, "time,x\n0,1\n1,2\n", "x.csv"))
    with pytest.raises(DatasetError, match="expected a column '-up'"):
        read_acceleration(path, columns={"vertical": "-up"})
    with pytest.raises(DatasetError, match="sampling_rate_hz: expected a number > 0, got 0"):
        read_acceleration(path, sampling_rate_hz=0)
    with pytest.raises(DatasetError, match="expected a time column of 100 Hz, got 64 Hz"):
        read_acceleration(path, sampling_rate_hz=100.0)
    with pytest.raises(DatasetError, match="'mm' to 'm/s2'"):
        read_acceleration(path, units="mm")
    with pytest.raises(DatasetError, match="'g' to 'mm'"):
        read_reference(path, units="g")
    with pytest.raises(DatasetError, match="start: expected a time with its time zone, got 2026-11-20T10:00:00"):
        read_acceleration(path, start=datetime(2026, 11, 20, 10))
