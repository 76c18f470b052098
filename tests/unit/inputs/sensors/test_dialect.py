"""A recording is the same in every dialect that instruments write, or refused with what to do."""

import numpy as np
import pytest

from sensor_files import HEADER, put, rows, swinging
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.dialect import read_table
from vfm_sdm.inputs.sensors.numbers import find_decimal_mark, is_clock_time, parse_numbers
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration, read_reference
from vfm_sdm.inputs.sensors.units import find_units, split_name

TIME, VALUES = swinging(0.5)
PLAIN = rows(TIME, VALUES)
PHYPHOX = [f'"{name}"' for name in ("Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz"))]
PHYPHOX_COLUMNS = {
    "time": "Time (s)",
    "lateral": "Acceleration x (m/s^2)",
    "vertical": "Acceleration y",
    "longitudinal": "Acceleration z",
}
NUMBERED = {"time": "1", "lateral": "2", "vertical": "3", "longitudinal": "4"}


def commas(separator=";"):
    return rows(TIME, VALUES, separator, ",")


@pytest.mark.parametrize(
    ("lines", "how"),
    [
        ([";".join(PHYPHOX), *commas()], {"columns": PHYPHOX_COLUMNS}),
        (["\t".join(PHYPHOX), *commas("\t")], {"columns": PHYPHOX_COLUMNS}),
        ([HEADER.replace(",", ";"), *rows(TIME, VALUES, ";")], {}),
        ([HEADER.replace(",", "|"), *rows(TIME, VALUES, "|")], {}),
        ([HEADER, *rows(TIME, VALUES, ", ")], {}),
        ([HEADER.replace(",", " "), *rows(TIME, VALUES, "   ")], {}),
        (["  " + HEADER.replace(",", " "), *["  " + row for row in commas("  ")]], {}),
        ([HEADER + ",", *[row + "," for row in PLAIN]], {}),
        ([HEADER, *[row + "," for row in PLAIN]], {}),
        (['"' + row.replace(",", '","') + '"' for row in [HEADER, *PLAIN]], {}),
        ([HEADER, *['"' + row.replace(",", '","').replace(".", ",") + '"' for row in PLAIN]], {}),
        ([HEADER.upper(), *PLAIN], {}),
        ([HEADER, "s,m/s2,m/s2,m/s2", *PLAIN], {}),
        (["Time,Acc,Acc,Acc", HEADER, "[s],[m/s²],[m/s²],[m/s²]", *PLAIN], {}),
        (["# made by a logger", "# rate = 200 Hz, range = 4 g, axes = 3", HEADER, *PLAIN], {}),
        (["# " + HEADER, *PLAIN], {}),
        (["----- Data of a logger -----", "Serial: 12", "Sample Rate,200", "Range,4 g", "", HEADER, *PLAIN], {}),
        (["sep=;", HEADER.replace(",", ";"), *commas()], {}),
        ([HEADER, *PLAIN, "End of data"], {}),
        ([HEADER, *PLAIN, "0.5,0.1"], {}),
        ([HEADER + ",state", *[row + ",OK" for row in PLAIN]], {}),
        (["Index," + HEADER, *[f"{n},{row}" for n, row in enumerate(PLAIN)]], {}),
        (PLAIN, {"columns": NUMBERED}),
        ([HEADER, *[row for line in PLAIN for row in (line, "")]], {}),
    ],
)
def test_a_recording_is_the_same_in_every_dialect(tmp_path, lines, how):
    read = read_acceleration(put(tmp_path, lines), units="m/s2", **how)
    np.testing.assert_allclose(read["acceleration"].values[:, 0], VALUES, atol=1e-6)
    np.testing.assert_allclose(read["time"].values, TIME, atol=1e-6)


@pytest.mark.parametrize(
    ("encoding", "newline"),
    [
        ("utf-8-sig", "\n"),
        ("utf-16", "\r\n"),
        ("utf-16-be", "\n"),
        ("utf-16-le", "\r\n"),
        ("utf-8", "\r"),
        ("cp1252", "\n"),
    ],
)
def test_a_recording_is_the_same_in_every_encoding(tmp_path, encoding, newline):
    lines = ["Time;Lateral [m/s²];Vertical [m/s²];Longitudinal [m/s²]", *commas()]
    read = read_acceleration(put(tmp_path, lines, encoding=encoding, newline=newline))
    np.testing.assert_allclose(read["acceleration"].values[:, 0], VALUES, atol=1e-6)
    assert any("Windows-1252" in note for note in read.attrs["notes"]) == (encoding == "cp1252")


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (
            [HEADER, *[row.replace(".", ",") for row in PLAIN]],
            "got 8; where commas are decimal marks, too, export with",
        ),
        (PLAIN, r"expected a column 'lateral', got \['1', '2', '3', '4'\].*no line of names above the numbers"),
        ([HEADER.replace(",", ";"), *commas()[:9], *rows(TIME, VALUES, ";")[9:]], "expected one decimal mark, got "),
        (["time;vertical", "1,000;1,234", "2,000;5,678"], "expected numbers that say whether a comma is the decimal"),
        ([HEADER, *PLAIN, HEADER, *PLAIN], "got a second line of names in row 102; cut the file there"),
        (
            ["time,ax,ay,az", *PLAIN],
            "name in columns which of them is along which axis, such as --column vertical='ax'",
        ),
        (["PK\x03\x04"], "got an Excel workbook or another archive; export the sheet as CSV"),
        (["no numbers here", "none, either"], "expected a line of names and at least 2 below it, got 2 lines"),
        (["time,vertical,temperature", *PLAIN], "expected 3 cells in row 2, got 4"),
        ([HEADER, *PLAIN[:50], "0.25,0.1", *PLAIN[51:]], "expected 4 cells in row 52, got 2; complete the row"),
        ([HEADER, *[row.replace(",", " g,") for row in PLAIN]], r"such as '.* g,.*', which is not of numbers"),
    ],
)
def test_what_cannot_be_told_is_refused_with_advice(tmp_path, lines, match):
    with pytest.raises(DatasetError, match=match):
        read_acceleration(put(tmp_path, lines), units="m/s2")


def test_one_axis_needs_no_columns_where_its_name_says_which(tmp_path):
    single = [f"{row.split(',')[0]},{row.split(',')[2]}" for row in PLAIN]
    read = read_acceleration(put(tmp_path, ["time,Vertical (m/s2)", *single]))
    assert read["axis"].values.tolist() == ["vertical"]
    np.testing.assert_allclose(read["acceleration"].values[:, 0, 0], VALUES[:, 1], atol=1e-6)
    two = read_acceleration(
        put(tmp_path, ["time,lateral,vertical", *["".join(row.rpartition(",")[:1]) for row in PLAIN]])
    )
    assert two["axis"].values.tolist() == ["lateral", "vertical"]
    alone = put(tmp_path, ["vertical", *[row.split(",")[2].replace(".", ",") for row in PLAIN]])
    read = read_acceleration(alone, units="m/s2", sampling_rate_hz=200.0)
    np.testing.assert_allclose(read["acceleration"].values[:, 0, 0], VALUES[:, 1], atol=1e-6)
    with pytest.raises(DatasetError, match=r"such as --column vertical='acceleration \(g\)'"):
        read_acceleration(put(tmp_path, ["time,acceleration (g)", *single]))


def test_units_are_those_of_the_header_and_contradict_nothing(tmp_path):
    lines = ["Time [ms];lateral (mg);vertical (mg);longitudinal (mg)", *rows(1e3 * TIME, VALUES / 9.80665e-3, ";", ",")]
    read = read_acceleration(put(tmp_path, lines))
    np.testing.assert_allclose(read["acceleration"].values[:, 0], VALUES, atol=1e-6)
    np.testing.assert_allclose(read["time"].values, TIME, atol=1e-6)
    assert read.attrs["notes"] == []
    with pytest.raises(DatasetError, match=r"expected values in g, as stated, got \{'lateral \(mg\)': 'mg'"):
        read_acceleration(put(tmp_path, lines), units="g")
    mixed = ["time,lateral (g),vertical (m/s2),longitudinal (g)", *PLAIN]
    with pytest.raises(DatasetError, match=r"expected columns of one unit, got \{'lateral \(g\)': 'g', 'vertical"):
        read_acceleration(put(tmp_path, mixed))
    with pytest.raises(DatasetError, match=r"expected one of \['g', 'mg', .*\], got 'furlong'"):
        read_acceleration(put(tmp_path, lines), units="furlong")
    with pytest.raises(DatasetError, match="expected 'lateral' in g, as stated, got a header that says mg"):
        read_acceleration(put(tmp_path, lines), columns={"lateral": "lateral in g"})
    stated = read_acceleration(
        put(tmp_path, ["t,a", *["".join(row.rpartition(",")[:1]) for row in rows(TIME, VALUES[:, :2])]]),
        columns={"vertical": "-a in mg"},
    )
    np.testing.assert_allclose(stated["acceleration"].values[:, 0, 0], -VALUES[:, 0] * 9.80665e-3, atol=1e-8)


def test_units_that_nothing_states_are_said(tmp_path):
    read = read_acceleration(put(tmp_path, [HEADER, *PLAIN]))
    assert read.attrs["notes"] == ["no units are stated: values are taken as g; state them with --units"]
    gauge = read_reference(put(tmp_path, ["time,vertical", *[row[: row.index(",", 10)] for row in PLAIN]]))
    assert gauge.attrs["notes"] == ["no units are stated: values are taken as mm; state them with --units"]


def test_a_table_keeps_words_and_lines(tmp_path):
    table = read_table(put(tmp_path, ["about", "Time / s;x;y", "0;1.234,5;2", "", "1;-1;3", ";;"]))
    assert table.bare_names() == ["time", "x", "y"]
    assert table.units == ("s", None, None)
    assert (table.lines, table.decimal) == ([3, 5], ",")


@pytest.mark.parametrize(
    ("cells", "decimal", "values"),
    [
        (["1.5", "-2e-3", "+.5", "7."], ".", [1.5, -2e-3, 0.5, 7]),
        (["1,5", "-2,0E-03", "1.234,5", "1.234.567"], ",", [1.5, -2e-3, 1234.5, 1234567]),
        (["1,234.5", "1 234.5", "1'234.5", "\u22121.5"], ".", [1234.5, 1234.5, 1234.5, -1.5]),
        (["", "NaN", "n/a", "OVL", "-inf"], ".", [np.nan, np.nan, np.nan, np.inf, -np.inf]),
    ],
)
def test_numbers_in_every_spelling(cells, decimal, values):
    found, wrong = parse_numbers(cells, decimal)
    np.testing.assert_array_equal(found, values)
    assert wrong is None
    assert find_decimal_mark("a.csv", cells) == decimal


@pytest.mark.parametrize("cell", ["1.2.3", "abc", "12,34", "1,2345.6"])
def test_what_is_no_number_is_none(cell):
    assert parse_numbers(["1", cell], ".")[1] == 1


def test_units_and_times_by_their_spelling():
    assert [find_units(text) for text in ("(m/s^2)", "m s⁻²", "Gal", "µs", "[g]", "kg")] == [
        "m/s2",
        "m/s2",
        "cm/s2",
        "us",
        "g",
        None,
    ]
    assert split_name("X-Axis (m/(s^2))") == ("X-Axis", "m/s2")
    assert split_name("acc_m") == ("acc_m", None)
    assert [is_clock_time(text) for text in ("10:22:31.5", "5/14/2026 10:22:31 AM", "2026-05-14", "10.22")] == [
        True,
        True,
        True,
        False,
    ]
