import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import pyuff
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat

from uff import read_uff
from vfm_sdm.core.datasets import STATUS_MEANINGS, STRUCTURE_AXES, DisplacementArrays, make_displacement, make_tracks
from vfm_sdm.core.netcdf import read_displacement, read_points, read_tracks, write_tracks
from vfm_sdm.errors import DatasetError, ResultsError
from vfm_sdm.outputs.results import (
    read_summary,
    summarize_displacement,
    write_displacement,
    write_export,
    write_summary,
)
from vfm_sdm.signals.spectrum import dominant_frequency

POINTS = ["1/2 span", "abutment, süd"]
OK, LOST, OUTSIDE, UNRELIABLE = range(4)


def make_example(frames: int = 30, *, fps: float = 60.0, seed: int = 0) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    shape = (frames, len(POINTS), 3)
    status = np.zeros(shape[:2])
    displacement = rng.normal(size=shape)
    if frames > 5:
        status[3, 0], status[4, 1], status[5, 0] = LOST, UNRELIABLE, OUTSIDE
        displacement[[3, 5], 0] = np.nan
    return make_displacement(
        np.arange(frames) / fps,
        POINTS,
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=displacement,
            displacement_std_mm=rng.uniform(0.1, 0.2, shape),
            scale_std=rng.uniform(0.01, 0.02, shape[1:]),
            position_m=rng.normal(size=shape),
            reprojection_error_px=rng.uniform(size=shape[:2]),
            status=status,
        ),
        attrs={"frame": "structure", "baseline_m": 4.0},
    )


def make_track(view: str, frames: int, *, seed: int) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    position = rng.normal(1000, 10, (frames, 2, 2))
    position[1, 0] = np.nan
    covariance = np.broadcast_to(1e-4 * np.eye(2), (frames, 2, 2, 2))
    attrs = {"tracker": "icgn", "view": view, "image_width": 3840, "subset_px": 41}
    return make_tracks(
        0.1 + np.arange(frames) / 59.94, POINTS, position, covariance, np.zeros((frames, 2)), attrs=attrs
    )


# --- netCDF ----------------------------------------------------------------------------------------------------------


def test_tracks_come_back_identical_in_the_order_of_the_views(tmp_path):
    tracks = {"right cam": make_track("right cam", 5, seed=1), "left": make_track("left", 7, seed=2)}
    path = write_tracks(tmp_path / "run", tracks)
    assert path == tmp_path / "run" / "tracks.nc"
    for source in (path, tmp_path / "run"):
        again = read_tracks(source)
        assert list(again) == ["right cam", "left"]
        for view, expected in tracks.items():
            xr.testing.assert_identical(again[view], expected)
    assert again["left"]["status"].dtype == np.int8


def test_tracks_keep_further_variables_of_a_tracker(tmp_path):
    track = make_track("left", 5, seed=1)
    track["correlation"] = (("time", "point"), np.full((5, 2), 0.99), {"units": "1"})
    write_tracks(tmp_path, {"left": track})
    xr.testing.assert_identical(read_tracks(tmp_path)["left"], track)


ATTRS = {
    "none": None,
    "empty": "",
    "text": "± 2 µm",
    "json text": 'json:{"a": 1}',
    "yes": True,
    "whole": 7,
    "number": 0.1,
    "huge": 10**30,
    "list": ["a", None, 1.5],
    "no items": [],
    "band_hz": [0.5, 20.0],
    "table": {"numpy": "2.4", "deep": {"x": [1, 2]}},
    "array": np.array([1.5, 2.5]),
    "nan": float("nan"),
}


@pytest.mark.parametrize("name", ATTRS)
def test_displacement_comes_back_identical_with_any_attribute(tmp_path, name):
    displacement = make_example()
    displacement.attrs[name] = ATTRS[name]
    displacement["displacement"].attrs[name] = ATTRS[name]
    displacement["time"].attrs[name] = ATTRS[name]
    write_displacement(tmp_path, displacement)
    again = read_displacement(tmp_path)
    xr.testing.assert_identical(again, displacement)
    assert type(again.attrs[name]) in {type(ATTRS[name]), np.int64, np.float64}


def test_numpy_attributes_become_lists_and_numbers(tmp_path):
    displacement = make_example()
    displacement.attrs |= {"one": np.array([1.5]), "flag": np.bool_(True), "matrix": np.eye(2), "pair": (1, 2)}
    write_displacement(tmp_path, displacement)
    attrs = read_displacement(tmp_path).attrs
    expected = {"one": [1.5], "flag": True, "matrix": [[1.0, 0.0], [0.0, 1.0]], "pair": [1, 2]}
    assert {name: attrs[name] for name in expected} == expected
    assert [type(attrs[name]) for name in expected] == [list, bool, list, list]


def test_a_result_that_was_read_can_be_written_again(tmp_path):
    write_displacement(tmp_path, make_example())
    again = read_displacement(tmp_path)
    write_displacement(tmp_path, again)  # over the file it came from
    xr.testing.assert_identical(read_displacement(tmp_path), make_example())


def test_storage_hints_of_another_file_do_not_round_the_values(tmp_path):
    displacement = make_example()
    for name in ("displacement", "time"):
        displacement[name].encoding = {"dtype": "int16", "scale_factor": 0.1, "_FillValue": -1}
    write_displacement(tmp_path, displacement)
    xr.testing.assert_identical(read_displacement(tmp_path), displacement)


def test_attribute_that_cannot_be_stored_is_named(tmp_path):
    displacement = make_example()
    displacement.attrs["camera"] = object()
    with pytest.raises(ResultsError, match="attribute 'camera': expected text, a number or a list of them, got object"):
        write_displacement(tmp_path, displacement)
    assert list(tmp_path.iterdir()) == []


def test_tracks_that_cannot_be_written_are_refused(tmp_path):
    with pytest.raises(ResultsError, match=r"tracks.nc: expected tracks of at least one view, got none"):
        write_tracks(tmp_path, {})
    with pytest.raises(ResultsError, match="expected view names without slashes, got 'a/b'"):
        write_tracks(tmp_path, {"a/b": make_track("a", 5, seed=1)})
    with pytest.raises(DatasetError, match="expected a variable 'position_covariance'"):
        write_tracks(tmp_path, {"a": make_track("a", 5, seed=1).drop_vars("position_covariance")})


@pytest.mark.parametrize(
    ("read", "kind", "what"),
    [
        (read_tracks, "tracks", "vfm-sdm track"),
        (read_points, "points", "vfm-sdm cameras"),
        (read_displacement, "displacement", "vfm-sdm measure"),
    ],
)
def test_unreadable_results_are_named_with_the_remedy(tmp_path, read, kind, what):
    name = f"{kind}.nc"
    with pytest.raises(ResultsError, match=rf"{name}: expected {kind}, got no such file; .*`{what}`"):
        read(tmp_path)
    (tmp_path / name).write_text("no netCDF")
    with pytest.raises(ResultsError, match=rf"{name}: expected {kind}, got a damaged file .*`{what}"):
        read(tmp_path)
    xr.Dataset({"a": 1}).to_netcdf(tmp_path / name, engine="h5netcdf")
    if read is read_tracks:
        tree = xr.DataTree.from_dict({"/left": xr.Dataset({"a": 1})})
        tree.to_netcdf(tmp_path / name, engine="h5netcdf")
    with pytest.raises(ResultsError, match=rf"{name}: expected {kind}, got something else .*`{what}"):
        read(tmp_path)


def test_cut_off_file_is_an_error_and_no_result(tmp_path):
    path = write_displacement(tmp_path, make_example(500))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ResultsError, match=r"displacement.nc: expected displacement, got a damaged file"):
        read_displacement(tmp_path)


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (lambda folder, data: write_tracks(folder, {"left": make_track("left", 9, seed=len(data.time))}), "tracks.nc"),
        (write_displacement, "displacement.csv"),
        (partial(write_export, "mat"), "displacement.mat"),
        (partial(write_export, "uff"), "displacement.uff"),
        (lambda folder, data: write_summary(folder, {"frames": len(data.time)}), "summary.json"),
    ],
)
def test_failed_write_keeps_the_earlier_files(tmp_path, monkeypatch, write, name):
    write(tmp_path, make_example(20))
    earlier = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(ResultsError, match=rf"{name}: expected to write it, got: .*No space left"):
        write(tmp_path, make_example(30))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == earlier


def test_half_written_netcdf_is_removed(tmp_path, monkeypatch):
    write_displacement(tmp_path, make_example(20))
    earlier = (tmp_path / "displacement.nc").read_bytes()

    whole = Path.write_bytes

    def half(self, content):
        whole(self, content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(ResultsError, match=r"displacement.nc: expected to write it"):
        write_displacement(tmp_path, make_example(20))
    assert (tmp_path / "displacement.nc").read_bytes() == earlier
    assert sorted(path.name for path in tmp_path.iterdir()) == ["displacement.csv", "displacement.nc"]


# --- tables and other programs ---------------------------------------------------------------------------------------


def test_csv_opens_as_a_table_with_the_same_values(tmp_path):
    displacement = make_example()
    write_displacement(tmp_path, displacement)
    table = pd.read_csv(tmp_path / "displacement.csv")
    expected = ["time_s"]
    for point in POINTS:
        for axis in STRUCTURE_AXES:
            expected += [f"{point} {axis} [mm]", f"{point} {axis} std [mm]"]
        expected.append(f"{point} status")
    assert list(table.columns) == expected
    np.testing.assert_array_equal(table["time_s"], displacement["time"])
    for point in POINTS:
        for axis in STRUCTURE_AXES:
            of_axis = displacement.sel(point=point, axis=axis)
            np.testing.assert_allclose(table[f"{point} {axis} [mm]"], of_axis["displacement"], rtol=1e-8)
            np.testing.assert_allclose(table[f"{point} {axis} std [mm]"], of_axis["displacement_std"], rtol=1e-8)
    assert list(table["1/2 span status"][2:7]) == ["ok", "lost", "ok", "outside", "ok"]
    assert table["abutment, süd status"][4] == "unreliable"
    with (tmp_path / "displacement.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[4][1] == ""  # a missing value is an empty cell
    assert len({len(row) for row in rows}) == 1


def test_csv_that_cannot_be_written(tmp_path):
    (tmp_path / "displacement.csv").mkdir()
    with pytest.raises(ResultsError, match=r"displacement.csv: expected to write it"):
        write_displacement(tmp_path, make_example())


def test_mat_holds_arrays_names_and_units(tmp_path):
    displacement = make_example()
    content = loadmat(write_export("mat", tmp_path, displacement))
    np.testing.assert_array_equal(content["displacement_mm"], displacement["displacement"])
    np.testing.assert_array_equal(content["displacement_std_mm"], displacement["displacement_std"])
    np.testing.assert_array_equal(content["position_m"], displacement["position"])
    np.testing.assert_array_equal(content["scale_std"], displacement["scale_std"])
    np.testing.assert_array_equal(content["reprojection_error_px"], displacement["reprojection_error"])
    np.testing.assert_array_equal(content["status"], displacement["status"])
    np.testing.assert_array_equal(content["time_s"][:, 0], displacement["time"])
    assert [str(cell[0]) for cell in content["points"][:, 0]] == POINTS
    assert [str(cell[0]) for cell in content["axes"][:, 0]] == list(STRUCTURE_AXES)
    assert [str(cell[0]) for cell in content["status_meanings"][:, 0]] == list(STATUS_MEANINGS)
    assert content["frame"][0] == "structure"


def test_uff_is_dataset_58_in_metres_with_units(tmp_path):
    displacement = make_example(31)
    units, functions = read_uff(write_export("uff", tmp_path, displacement))
    assert units[0].strip() == "164"
    assert (int(units[1][:10]), int(units[1][30:40])) == (1, 2)  # SI, relative temperature
    assert [float(units[2][i : i + 25].replace("D", "E")) for i in (0, 25, 50)] == [1, 1, 1]
    assert float(units[3].replace("D", "E")) == 273.15
    assert [(f["node"], f["direction"]) for f in functions] == [(n, d) for n in (1, 2) for d in (1, 2, 3)]
    for f in functions:
        assert (f["type"], f["ordinate_type"]) == (1, 4)  # time response, double precision
        assert f["abscissa"] == (17, "Time", "s")
        assert f["ordinate"] == (8, 1, "Displacement", "m")
        series = displacement["displacement"].values[:, f["node"] - 1, f["direction"] - 1]
        found = np.isfinite(series)
        assert f["even"] == int(f["node"] == 2)  # the first point has gaps
        np.testing.assert_allclose(f["values"], 1e-3 * series[found], rtol=1e-12)
        np.testing.assert_allclose(f["times"], displacement["time"].values[found], rtol=1e-5)
    assert functions[0]["ids"][0] == "1/2 span lateral"
    assert functions[3]["ids"][:2] == ["abutment, s?d lateral", "displacement along lateral"]


def test_another_program_reads_uff_as_it_is_meant(tmp_path):
    displacement = make_example(31)
    units, nodes, *functions = pyuff.UFF(str(write_export("uff", tmp_path, displacement))).read_sets()
    places = np.column_stack([nodes[key] for key in "xyz"])
    assert list(nodes["node_nums"]) == [1, 2]
    np.testing.assert_allclose(places, displacement["position"].median("time"), rtol=1e-5)
    assert (units["units_code"], units["length"], units["temp_mode"]) == (1, 1.0, 2)
    assert [(f["rsp_node"], f["rsp_dir"]) for f in functions] == [(n, d) for n in (1, 2) for d in (1, 2, 3)]
    for f in functions:
        series = displacement["displacement"].values[:, f["rsp_node"] - 1, f["rsp_dir"] - 1]
        found = np.isfinite(series)
        assert (f["func_type"], f["abscissa_spec_data_type"], f["ordinate_spec_data_type"]) == (1, 17, 8)
        assert (f["abscissa_axis_units_lab"], f["ordinate_axis_units_lab"]) == ("s", "m")
        np.testing.assert_allclose(f["data"], 1e-3 * series[found], rtol=1e-12)
        np.testing.assert_allclose(f["x"], displacement["time"].values[found], rtol=1e-5)


def test_uff_of_uneven_frames_keeps_their_times(tmp_path):
    displacement = make_example(40)
    time_s = displacement["time"].values.copy()
    time_s[20:] += 0.5 / 60
    displacement = displacement.assign_coords(time=("time", time_s, {"units": "s"}))
    function = read_uff(write_export("uff", tmp_path, displacement))[1][3]
    assert not function["even"]
    np.testing.assert_allclose(function["times"], time_s, rtol=1e-5)


def test_uff_takes_stamps_rounded_by_the_container_for_even(tmp_path):
    displacement = make_example(60)
    rounded = np.round(displacement["time"].values, 3)
    displacement = displacement.assign_coords(time=("time", rounded, {"units": "s"}))
    assert read_uff(write_export("uff", tmp_path, displacement))[1][3]["even"]


def test_uff_of_one_frame_and_of_nothing(tmp_path):
    functions = read_uff(write_export("uff", tmp_path, make_example(1)))[1]
    assert [f["values"].size for f in functions] == [1] * 6
    empty = make_example(5)
    empty["displacement"][:] = np.nan
    with pytest.raises(ResultsError, match=r"displacement.uff: expected at least one value, got none"):
        write_export("uff", tmp_path, empty)


# --- summary ---------------------------------------------------------------------------------------------------------


def test_summary_comes_back_with_null_for_what_is_not_finite(tmp_path):
    summary = {
        "a": float("nan"),
        "b": [np.float64(1.5), np.inf, np.int8(3), np.bool_(True), None],
        "c": {"path": Path("a/b"), "array": np.array([[1.0, np.nan]])},
        "größe": (1, "µm"),
    }
    path = write_summary(tmp_path / "run", summary)
    text = path.read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text
    expected = {
        "a": None,
        "b": [1.5, None, 3, True, None],
        "c": {"path": "a/b", "array": [[1.0, None]]},
        "größe": [1, "µm"],
    }
    assert json.loads(text) == expected
    assert read_summary(tmp_path / "run") == expected
    assert read_summary(path) == expected


def test_summary_faults(tmp_path):
    with pytest.raises(ResultsError, match=r"summary.a\[1\]: expected text, numbers, lists or tables, got object"):
        write_summary(tmp_path, {"a": [1, object()]})
    with pytest.raises(ResultsError, match=r"summary.json: expected a summary, got no such file"):
        read_summary(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(ResultsError, match=r"summary.json: expected a summary, got: Expecting"):
        read_summary(tmp_path)
    (tmp_path / "summary.json").write_text("[]")
    with pytest.raises(ResultsError, match=r"summary.json: expected a table, got list"):
        read_summary(tmp_path)


def make_known(values: np.ndarray, *, fps: float = 50.0, std: float = 0.1, scale_std: float = 0.02) -> xr.Dataset:
    """One point whose vertical displacement is given; the other axes rest."""
    shape = (values.size, 1, 3)
    displacement = np.zeros(shape)
    displacement[:, 0, 1] = values
    return make_displacement(
        np.arange(values.size) / fps,
        ["mid"],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=displacement,
            displacement_std_mm=np.full(shape, std),
            scale_std=np.full((1, 3), scale_std),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2]),
        ),
        attrs={},
    )


def test_figures_of_a_known_sine():
    time_s = np.arange(1000) / 50
    data = make_known(3.0 * np.sin(2 * np.pi * 2.0 * time_s))
    point = summarize_displacement(data)["mid"]
    assert point["coverage_valid"] == 1.0
    assert point["status_counts"] == dict.fromkeys(STATUS_MEANINGS, 0) | {"ok": 1000}
    vertical = point["axes"]["vertical"]
    span = float(np.ptp(data["displacement"].values))
    assert vertical["peak_to_peak_mm"] == pytest.approx(span)
    assert span == pytest.approx(6.0, abs=0.02)
    assert vertical["rms_mm"] == pytest.approx(3 / np.sqrt(2), rel=1e-6)
    assert vertical["random_std_mm"] == pytest.approx(0.1)
    assert vertical["scale_std"] == 0.02
    # By hand: random parts of two frames and 2 % of the span, k = 2.
    assert vertical["expanded_uncertainty_mm"] == pytest.approx(2 * np.sqrt(0.1**2 + 0.1**2 + (0.02 * span) ** 2))
    assert vertical["dominant_frequency_hz"] == pytest.approx(2.0, abs=0.002)
    lateral = point["axes"]["lateral"]
    assert (lateral["peak_to_peak_mm"], lateral["dominant_frequency_hz"]) == (0.0, None)


def test_only_trusted_frames_count():
    data = make_known(np.array([0.0, 1.0, 100.0, -1.0, np.nan, np.nan]))
    data["status"][:, 0] = [OK, OK, UNRELIABLE, OK, LOST, OUTSIDE]
    data["displacement_std"][2] = 9.0
    point = summarize_displacement(data)["mid"]
    assert point["coverage_valid"] == 0.5
    counts = {"ok": 3, "lost": 1, "outside": 1, "unreliable": 1, "behind_camera": 0}
    assert point["status_counts"] == counts
    vertical = point["axes"]["vertical"]
    assert vertical["peak_to_peak_mm"] == 2.0
    assert vertical["rms_mm"] == pytest.approx(np.sqrt(2 / 3))
    assert vertical["random_std_mm"] == pytest.approx(0.1)


def test_the_uncertainty_is_that_of_the_extreme_frames():
    data = make_known(np.array([0.0, 5.0, 2.0, -5.0]), scale_std=0.0)
    data["displacement_std"][:, 0, 1] = [7.0, 3.0, 7.0, 4.0]
    assert summarize_displacement(data)["mid"]["axes"]["vertical"]["expanded_uncertainty_mm"] == pytest.approx(10.0)


def with_budget(data: xr.Dataset, **parts: list[float]) -> xr.Dataset:
    """The dataset with a budget along the vertical axis, and nothing along the others."""
    budget = np.zeros((len(parts), *data["displacement"].shape))
    budget[..., 0, 1] = list(parts.values())
    return data.assign(uncertainty=(("component", "time", "point", "axis"), budget, {"units": "mm"})).assign_coords(
        component=list(parts)
    )


def test_uncertainty_of_the_peak_to_peak_from_the_budget():
    known = make_known(np.array([0.0, 5.0, 2.0, -4.0, 9.0]), scale_std=0.5)
    known["status"].values[4, 0] = UNRELIABLE
    data = with_budget(
        known,
        random=[7.0, 0.3, 7.0, 0.4, 99.0],
        cameras=[0.0, 0.5, 0.2, 0.4, 99.0],
        synchronization=[1.0, 0.1, 2.0, 0.2, 99.0],
        assumption=[0.6, 0.6, 0.6, 0.6, 99.0],
        compression=[0.0, 0.05, 0.02, 0.04, 99.0],
    )
    vertical = summarize_displacement(data)["mid"]["axes"]["vertical"]
    # Frames 1 and 3. Gains of cameras and codec stretch the whole span; the rest is independent at the two.
    variance = 0.3**2 + 0.4**2 + 0.9**2 + 0.1**2 + 0.2**2 + 2 * 0.6**2 + 0.09**2
    assert vertical["expanded_uncertainty_mm"] == pytest.approx(2 * np.sqrt(variance))
    assert vertical["budget_mm"] == pytest.approx(
        {
            "random": np.sqrt((49 + 0.09 + 49 + 0.16) / 4),
            "cameras": np.sqrt((0.25 + 0.04 + 0.16) / 4),
            "synchronization": np.sqrt((1 + 0.01 + 4 + 0.04) / 4),
            "assumption": 0.6,
            "compression": np.sqrt((0.0025 + 0.0004 + 0.0016) / 4),
        }
    )
    lateral = summarize_displacement(data)["mid"]["axes"]["lateral"]
    assert set(lateral["budget_mm"].values()) == {0.0}


def test_a_component_that_is_not_known_is_none_and_so_is_the_whole():
    data = with_budget(make_known(np.array([0.0, 1.0])), random=[0.1, 0.1], cameras=[np.nan, np.nan])
    vertical = summarize_displacement(data)["mid"]["axes"]["vertical"]
    assert vertical["budget_mm"] == {"random": pytest.approx(0.1), "cameras": None}
    assert vertical["expanded_uncertainty_mm"] is None
    assert vertical["peak_to_peak_mm"] == 1.0


def test_what_is_not_known_is_none():
    data = make_known(np.full(5, np.nan))
    data["status"][:] = LOST
    figures = summarize_displacement(data)["mid"]
    assert figures["coverage_valid"] == 0.0
    assert figures["axes"]["vertical"] == {
        "peak_to_peak_mm": None,
        "rms_mm": None,
        "random_std_mm": None,
        "detection_limit_mm": None,
        "scale_std": 0.02,
        "expanded_uncertainty_mm": None,
        "budget_mm": None,
        "dominant_frequency_hz": None,
    }
    unknown = make_known(np.array([0.0, 1.0]), std=np.nan, scale_std=np.nan)
    vertical = summarize_displacement(unknown)["mid"]["axes"]["vertical"]
    assert vertical["peak_to_peak_mm"] == 1.0
    assert (vertical["random_std_mm"], vertical["scale_std"], vertical["expanded_uncertainty_mm"]) == (None, None, None)


@settings(max_examples=40, deadline=None)
@given(
    frequency=st.floats(1.5, 12.0),
    phase=st.floats(0, 6.3),
    fps=st.sampled_from([29.97, 50.0, 59.94]),
    seconds=st.floats(4.0, 30.0),
    seed=st.integers(0, 1000),
)
def test_frequency_is_found_below_a_line_of_the_spectrum(frequency, phase, fps, seconds, seed):
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(seconds * fps)) / fps
    values = np.sin(2 * np.pi * frequency * time_s + phase) + 0.1 * rng.normal(size=time_s.size) + 3 + 0.1 * time_s
    values[rng.random(time_s.size) < 0.05] = np.nan
    values[[0, -1]] = 0
    found = dominant_frequency(time_s, values)
    assert found == pytest.approx(frequency, abs=0.1 / seconds)


def test_frequency_with_stamps_rounded_to_milliseconds():
    time_s = np.round(np.arange(1200) / 60, 3)
    assert dominant_frequency(time_s, np.sin(2 * np.pi * 7.3 * time_s)) == pytest.approx(7.3, abs=0.002)


def test_noise_drift_and_rest_have_no_frequency():
    rng = np.random.default_rng(0)
    time_s = np.arange(600) / 60
    white = sum(dominant_frequency(time_s, rng.normal(size=600)) is not None for _ in range(300))
    assert white <= 2
    walks = sum(dominant_frequency(time_s, np.cumsum(rng.normal(size=600))) is not None for _ in range(300))
    assert walks <= 6  # the noise level is less sure on a steep spectrum
    assert dominant_frequency(time_s, np.full(600, 3.7)) is None
    assert dominant_frequency(time_s, 1e3 + 5 * time_s) is None
    assert dominant_frequency(time_s, np.exp(-(((time_s - 5) / 1.5) ** 2))) is None  # one slow passage


def test_vibration_is_found_below_a_larger_slow_passage():
    rng = np.random.default_rng(0)
    time_s = np.arange(1800) / 60
    passage = -8 * np.exp(-(((time_s - 12) / 3) ** 2)) + np.cumsum(rng.normal(size=1800)) * 0.02
    values = passage + 0.3 * np.sin(2 * np.pi * 3.2 * time_s) + 0.05 * rng.normal(size=1800)
    assert dominant_frequency(time_s, values) == pytest.approx(3.2, abs=0.005)


def test_the_stronger_of_two_vibrations_is_dominant():
    time_s = np.arange(1800) / 60
    values = np.sin(2 * np.pi * 3.2 * time_s) + 1.5 * np.sin(2 * np.pi * 7.1 * time_s)
    assert dominant_frequency(time_s, values) == pytest.approx(7.1, abs=0.005)


def test_too_little_has_no_frequency():
    time_s = np.arange(600) / 60
    values = np.sin(2 * np.pi * 5 * time_s)
    assert dominant_frequency(time_s, values) == pytest.approx(5, abs=0.01)
    assert dominant_frequency(time_s[:119], values[:119]) is None  # shorter than 2 s
    gappy = values.copy()
    gappy[100:300] = np.nan
    assert dominant_frequency(time_s, gappy) is None
    assert dominant_frequency(time_s, np.full(600, np.nan)) is None
    assert dominant_frequency([0.0, 3.0], [1.0, 2.0]) is None
    assert dominant_frequency([0.0, 1.5, 3.0], [1.0, -1.0, 1.0]) is None
    assert dominant_frequency([], []) is None


def test_frequency_of_malformed_series():
    with pytest.raises(DatasetError, match="spectrum: expected increasing time stamps, one a value, got 2"):
        dominant_frequency([0.0, 1.0], [1.0, 2.0, 3.0])
    with pytest.raises(DatasetError, match="expected increasing time stamps"):
        dominant_frequency([0.0, 0.0], [1.0, 2.0])
