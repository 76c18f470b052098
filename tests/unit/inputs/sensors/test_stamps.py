"""Time in every form is the same clock, or its unit is asked for."""

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from sensor_files import HEADER, put, rows, swinging
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.netcdf import join_sensors
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration

TIME, VALUES = swinging(2.0)
START = datetime(2026, 5, 14, 10, 22, 31, tzinfo=timezone(timedelta(hours=2)))
MOMENTS = [START + timedelta(seconds=float(stamp)) for stamp in TIME]
AXES = {"lateral": "lateral", "vertical": "vertical", "longitudinal": "longitudinal"}


def clocks(pattern, cut=-3, start=START):
    """Stamps of moments to the millisecond."""
    return [(start + timedelta(seconds=float(stamp))).strftime(pattern)[: cut or None] for stamp in TIME]


@pytest.mark.parametrize(
    ("stamps", "noted"),
    [
        ([moment.isoformat(timespec="milliseconds") for moment in MOMENTS], None),
        (clocks("%Y-%m-%d %H:%M:%S.%f"), None),
        (clocks("%d.%m.%Y %H:%M:%S.%f"), None),
        (clocks("%d-%b-%Y %H:%M:%S.%f"), None),
        ([stamp + " AM" for stamp in clocks("%m/%d/%Y %I:%M:%S.%f")], None),
        (clocks("%H:%M:%S:%f"), None),
        (clocks("%M:%S.%f"), None),
        (clocks("%H:%M:%S.%f", start=datetime(2026, 5, 14, 23, 59, 59)), "passes midnight 1 times"),
        ([f"{1778746951000 + round(1e3 * stamp)}" for stamp in TIME], "Unix time in ms"),
        ([f"{1778746951 + stamp:.3f}" for stamp in TIME], "Unix time in s"),
        ([f"{(1778746951000 + round(1e3 * stamp)) * 10**6}" for stamp in TIME], "Unix time in ns"),
        ([f"{46000.5 + stamp / 86400:.10f}" for stamp in TIME], "days since 1900"),
    ],
)
def test_time_of_a_calendar_counts_from_the_first_sample(tmp_path, stamps, noted):
    read = read_acceleration(put(tmp_path, [HEADER, *rows(stamps, VALUES)]), units="m/s2")
    np.testing.assert_allclose(read["time"].values, TIME, atol=1e-5)
    assert read.attrs["first_stamp"] == stamps[0]
    assert noted is None or any(noted in note for note in read.attrs["notes"])


def test_stamps_that_state_their_zone_say_when_the_recording_began(tmp_path):
    read = read_acceleration(put(tmp_path, [HEADER, *rows([m.isoformat() for m in MOMENTS], VALUES)]), units="m/s2")
    assert datetime.fromisoformat(read.attrs["start_utc"]) == START


def test_sensors_of_other_first_stamps_share_no_clock(tmp_path):
    later = clocks("%H:%M:%S.%f", start=START + timedelta(seconds=7))
    files = [
        put(tmp_path, [HEADER, *rows(stamps, VALUES)], name)
        for name, stamps in (("a.csv", clocks("%H:%M:%S.%f")), ("b.csv", later))
    ]
    with pytest.raises(DatasetError, match=r"expected one clock, got first stamps \['10:22:31.000', '10:22:38.000'\]"):
        join_sensors([read_acceleration(file, units="m/s2") for file in files])


@pytest.mark.parametrize(
    ("factor", "how"),
    [
        (1e3, {"columns": {**AXES, "time": "time in ms"}}),
        (1e3, {"sampling_rate_hz": 200.0}),
        (1e6, {"sampling_rate_hz": 200.0}),
        (200.0, {"sampling_rate_hz": 200.0}),
        (1 / 86400, {"columns": {**AXES, "time": "time in d"}}),
    ],
)
def test_the_unit_of_time_is_stated_or_follows_from_the_rate(tmp_path, factor, how):
    lines = [HEADER, *rows([f"{factor * stamp:.12g}" for stamp in TIME], VALUES)]
    read = read_acceleration(put(tmp_path, lines), units="m/s2", **how)
    np.testing.assert_allclose(read["time"].values, TIME, atol=1e-6)


@pytest.mark.parametrize(
    ("factor", "match"),
    [
        (1e3, r"numbers 5 apart in column 'time', which is 0\.2 Hz \(200 Hz if in ms\); .*'time=time in ms'"),
        (1e6, "200 Hz if in us"),
        (200.0, "numbers 1 apart .* or, where they number the samples, give --rate"),
        (1 / 86400, "200 Hz if in d"),
        (1 / 60, "200 Hz if in min"),
    ],
)
def test_a_unit_of_time_that_cannot_be_told_is_asked_for(tmp_path, factor, match):
    path = put(tmp_path, [HEADER, *rows([f"{factor * stamp:.12g}" for stamp in TIME], VALUES)])
    with pytest.raises(DatasetError, match=match):
        read_acceleration(path, units="m/s2")


def test_wrong_stamps_are_named(tmp_path):
    stamps = [f"{stamp:.3f}" for stamp in TIME]
    stamps[7] = "x"
    with pytest.raises(DatasetError, match="expected a number in row 9, column 'time', got 'x'"):
        read_acceleration(put(tmp_path, [HEADER, *rows(stamps, VALUES)]), units="m/s2")
    clock = clocks("%H:%M:%S.%f")
    clock[7] = "noon"
    with pytest.raises(DatasetError, match="expected a time of day in row 9, column 'time', got 'noon'"):
        read_acceleration(put(tmp_path, [HEADER, *rows(clock, VALUES)]), units="m/s2")
    with pytest.raises(DatasetError, match=r"expected column 'time' in one of .*, got 'g'"):
        read_acceleration(
            put(tmp_path, [HEADER, *rows(TIME, VALUES)]), columns={**AXES, "time": "time in g"}, units="m/s2"
        )


def test_a_column_of_time_can_be_left_out(tmp_path):
    path = put(tmp_path, [HEADER, *rows(0 * TIME, VALUES)])
    read = read_acceleration(path, columns={**AXES, "time": "none"}, units="m/s2", sampling_rate_hz=200.0)
    np.testing.assert_allclose(read["time"].values, TIME, atol=1e-9)
