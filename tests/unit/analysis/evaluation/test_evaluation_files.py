import numpy as np
import pytest
import xarray as xr

from vfm_sdm.analysis.evaluation import (
    ReferenceClock,
    evaluate_run,
    join_sensors,
    read_comparison,
    read_sensors,
    write_reference,
)
from vfm_sdm.core.datasets import DisplacementArrays, make_displacement
from vfm_sdm.core.sensor_datasets import make_acceleration
from vfm_sdm.errors import DatasetError, ResultsError, SessionError
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings, compute_reference
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration
from vfm_sdm.inputs.session import Session, write_session
from vfm_sdm.outputs.results import write_displacement

AXES = ("lateral", "vertical", "longitudinal")
TIME = np.arange(450) / 30


def motion(time_s, point=0):
    """Displacement [m] of one point along all axes, from rest at 1 s on; shape (T, 3)."""
    swell = np.clip(time_s - 1, 0, 2) / 2
    beat = np.sin(2 * np.pi * 2.3 * time_s + point + 0.8 * np.sin(0.7 * time_s)) * swell**3
    return 1e-3 * beat[:, None] * [2.0, 4.0, 0.1]


def write_csv(path, lag_s, point=0, *, gauge=False):
    """What a sensor records whose clock shows ``lag_s`` when the video's shows 0."""
    stamps = np.arange(20 * 64) / 64
    step = 1e-3
    shifted = [motion(stamps - lag_s + shift, point) for shift in (-step, 0, step)]
    if gauge:
        values = 1e3 * shifted[1] + 12.0
    else:
        values = (shifted[0] - 2 * shifted[1] + shifted[2]) / step**2 / 9.80665 + [0, -1, 0]
    rows = [",".join(f"{number:.9f}" for number in row) for row in np.column_stack([stamps, values])]
    path.write_text("\n".join(["time,lateral,vertical,longitudinal", *rows]) + "\n")
    return path


@pytest.fixture
def run(tmp_path):
    """A run folder with displacement of two moving points and a static one, and the session that names sensors."""
    values = 1e3 * np.stack([motion(TIME), motion(TIME, 1), 0 * motion(TIME)], axis=1)
    values += 0.01 * np.random.default_rng(1).standard_normal(values.shape)
    shape = values.shape
    displacement = make_displacement(
        TIME,
        ["mid", "quarter", "abutment"],
        AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.full(shape, 0.01),
            scale_std=np.zeros(shape[1:]),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2], int),
        ),
        attrs={"frame": "structure"},
    )
    write_displacement(tmp_path / "run", displacement)
    write_csv(tmp_path / "acc-1.csv", 1.5)
    write_csv(tmp_path / "acc-2.csv", 1.5, 1)
    write_csv(tmp_path / "laser.csv", -0.7, gauge=True)
    return tmp_path / "run"


def write_run_session(run, **changes):
    sensors = [
        {"name": "a", "file": "acc-1.csv", "point": "mid", "units": "g"},
        {"name": "b", "file": "acc-2.csv", "point": "quarter", "units": "g"},
    ]
    fields = {
        "name": "test",
        "folder": run.parent,
        "view": [{"name": "left", "video": "left.mp4"}],
        "point": [
            {"name": name, "view": "left", "pixel": [1.0, 2.0], "static": name == "abutment"}
            for name in ("mid", "quarter", "abutment")
        ],
        "sensor": sensors,
    }
    write_session(run / "session.resolved.toml", Session(**{**fields, **changes}))
    return run


def paired(result):
    return sorted({row.point for row in result.rows})


def test_several_files_become_several_sensors(run):
    files = [run.parent / "acc-1.csv", run.parent / "acc-2.csv"]
    both = read_sensors(files, sensors=["left", "right"])
    assert list(both["sensor"].values) == ["left", "right"]
    assert list(read_sensors(files)["sensor"].values) == ["acc-1", "acc-2"]
    alone = compute_reference(read_acceleration(files[1]), RecipeSettings(onset_s=both.attrs["onset_s"]))
    np.testing.assert_allclose(
        both["displacement"].sel(sensor="right"), alone["displacement"].sel(sensor="acc-2"), atol=1e-9
    )
    assert list(both["outliers"].dims) == ["sensor", "axis"]
    laser = read_sensors([run.parent / "laser.csv"], units="mm", columns={"vertical": "-vertical"})
    assert laser["displacement"].values[0] == pytest.approx(-12)
    with pytest.raises(DatasetError, match="sensors: expected one name a file, got 1 for 2; name all or none"):
        read_sensors(files, sensors=["left"])


def test_only_sensors_on_one_clock_are_joined():
    def recording(name, *, start=0.0, axes=AXES, count=50):
        stamps = start + np.arange(count) / 64
        return make_acceleration(stamps, [name], axes, np.zeros((count, 1, len(axes))), sampling_rate_hz=64)

    assert join_sensors([recording("a"), recording("b")]).sizes["sensor"] == 2
    with pytest.raises(
        DatasetError, match=r"expected one clock, got 50 samples from 0 s on and 50 samples from 0\.1 s"
    ):
        join_sensors([recording("a"), recording("b", start=0.1)])
    with pytest.raises(DatasetError, match="expected one clock, got 50 samples from 0 s on and 49 samples"):
        join_sensors([recording("a"), recording("b", count=49)])
    with pytest.raises(DatasetError, match=r"expected different names, got \['a', 'a'\]; name each with --sensor"):
        join_sensors([recording("a"), recording("a")])
    with pytest.raises(DatasetError, match="expected recordings of one kind and the same axes"):
        join_sensors([recording("a"), recording("b", axes=AXES[:2])])
    with pytest.raises(DatasetError, match="expected one recording or more, got none"):
        join_sensors([])


def test_a_reference_file_comes_back_as_it_was(run, tmp_path):
    reference = read_sensors([run.parent / "acc-1.csv", run.parent / "acc-2.csv"])
    path = write_reference(tmp_path / "reference.nc", reference)
    back = read_comparison(path)
    xr.testing.assert_equal(back, reference)
    assert tuple(back.attrs["band_hz"]) == (1.0, 10.0)
    assert back.attrs["onset_s"] == reference.attrs["onset_s"]
    assert back["displacement"].attrs["units"] == "mm"
    assert "point" in read_comparison(run / "displacement.nc").dims
    with pytest.raises(ResultsError, match=r"expected to write it, got: .*; choose another folder"):
        write_reference(path / "below.nc", reference)
    with pytest.raises(DatasetError, match="onset_s"):
        write_reference(path, reference.drop_attrs(deep=False).assign_attrs(sampling_rate_hz=30.0))


def test_files_that_are_no_reference_are_refused(tmp_path):
    expected = r"\.nc: expected a reference or displacement, got "
    with pytest.raises(ResultsError, match=rf"none{expected}no such file; .*`vfm-sdm reference`"):
        read_comparison(tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("nothing")
    with pytest.raises(ResultsError, match=rf"text{expected}a damaged file "):
        read_comparison(tmp_path / "text.nc")
    xr.Dataset({"x": ("sensor", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(
        ResultsError, match=rf"other{expected}something else \(dataset: expected a variable 'displacement'"
    ):
        read_comparison(tmp_path / "other.nc")
    xr.Dataset({"x": ("time", [1.0])}).to_netcdf(tmp_path / "third.nc", engine="h5netcdf")
    with pytest.raises(ResultsError, match=rf"third{expected}something else \(dataset: expected a variable "):
        read_comparison(tmp_path / "third.nc")


def test_the_session_says_where_sensors_sit_and_what_does_not_move(run):
    write_run_session(run)
    path = write_reference(
        run.parent / "reference.nc",
        read_sensors([run.parent / "acc-1.csv", run.parent / "acc-2.csv"], sensors=["a", "b"]),
    )
    result = evaluate_run(run, path)
    assert paired(result) == ["mid", "quarter"]
    assert result.reference_name == "sensors a, b"
    assert result.synchronization.lag_s == pytest.approx(1.5, abs=2e-3)
    assert all(row.score.skill > 0.99 for row in result.rows)
    crossed = evaluate_run(run, path, pairs={"mid": "b"}, clock=ReferenceClock(start_lag_s=1.5, synchronize=False))
    assert crossed.row("mid", "vertical").score.skill < 0.8
    own = evaluate_run(run, run / "displacement.nc")
    assert paired(own) == ["mid", "quarter"]


def test_without_a_session_names_and_motion_decide(run):
    # Noise moves the abutment here; a truth would not.
    assert paired(evaluate_run(run, run / "displacement.nc")) == ["abutment", "mid", "quarter"]


def test_a_csv_file_that_the_session_names_is_read_as_it_says(run, tmp_path):
    write_run_session(run)
    result = evaluate_run(run, run.parent / "acc-2.csv")
    assert paired(result) == ["quarter"]
    assert result.row("quarter", "vertical").score.skill > 0.99
    moved = tmp_path / "elsewhere" / "acc-2.csv"
    moved.parent.mkdir()
    (run.parent / "acc-2.csv").rename(moved)
    assert evaluate_run(run, moved).row("quarter", "vertical").score.skill > 0.99


def test_a_gauge_is_compared_unfiltered(run):
    write_run_session(run, sensor=[{"name": "laser", "file": "laser.csv", "point": "mid", "units": "mm"}])
    result = evaluate_run(run, run.parent / "laser.csv", axes=["vertical"])
    assert result.band_hz is None
    assert result.synchronization.lag_s == pytest.approx(-0.7, abs=2e-3)
    assert result.row("mid", "vertical").score.offset == pytest.approx(-12, abs=0.01)
    assert result.row("mid", "vertical").score.coverage > 0.9


def test_what_the_session_does_not_say_is_asked_for(run):
    csv = run.parent / "acc-1.csv"
    with pytest.raises(SessionError, match="got 0 sensors of that file; convert the file with `vfm-sdm reference`"):
        evaluate_run(run, csv)
    write_run_session(run, sensor=[{"name": "a", "file": "acc-1.csv", "point": "mid"}])
    with pytest.raises(SessionError, match="got no units for 'a'"):
        evaluate_run(run, csv)
    path = write_reference(run.parent / "reference.nc", read_sensors([csv, run.parent / "acc-2.csv"]))
    with pytest.raises(SessionError, match=r"expected one of the sensors \['acc-1', 'acc-2'\] at each .* --pair"):
        evaluate_run(run, path)
    twice = [{"name": name, "file": f"{name}.csv", "point": "mid", "units": "g"} for name in ("acc-1", "acc-2")]
    write_run_session(run, sensor=twice)
    with pytest.raises(SessionError, match=r"got \[\('acc-1', 'mid'\), \('acc-2', 'mid'\)\] in the session"):
        evaluate_run(run, path)


def test_notes_of_the_reference_reach_the_evaluation_and_its_gaps_stay_open(run):
    lines = (run.parent / "acc-1.csv").read_text().splitlines()
    (run.parent / "acc-1.csv").write_text("\n".join([lines[0], *lines[1:600], *lines[660:]]) + "\n")
    write_run_session(run)
    result = evaluate_run(run, run.parent / "acc-1.csv")
    assert any(note.startswith("reference: 'a', ") and "60 samples" in note for note in result.notes)
    row = result.row("mid", "vertical").score
    assert row.skill > 0.99
    assert 200 < row.samples < 400


def test_the_header_may_state_the_units_instead_of_the_session(run):
    path = run.parent / "acc-1.csv"
    header, rest = path.read_text().split("\n", 1)
    path.write_text(",".join([header.split(",")[0], *[f"{name} (g)" for name in header.split(",")[1:]]]) + "\n" + rest)
    write_run_session(run, sensor=[{"name": "a", "file": "acc-1.csv", "point": "mid"}])
    assert evaluate_run(run, path).row("mid", "vertical").score.skill > 0.99
    text = path.rename(path.with_suffix(".txt"))
    write_run_session(run, sensor=[{"name": "a", "file": "acc-1.txt", "point": "mid"}])
    assert evaluate_run(run, text).row("mid", "vertical").score.skill > 0.99
    gauge = run.parent / "laser.csv"
    gauge.write_text(gauge.read_text().replace("vertical", "vertical [mm]", 1))
    assert "recorded_at_hz" not in read_sensors([gauge]).attrs


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda truth: truth.drop_vars("time"), r"time: expected a coordinate of time stamps in seconds, got none"),
        (
            lambda truth: truth.assign_coords(time=("time", 1e3 * truth["time"].values, {"units": "ms"})),
            r"time: expected units 's', got 'ms'; convert the stamps to seconds",
        ),
        (
            lambda truth: truth.assign_coords(time=("time", np.arange(truth.sizes["time"]))),
            r"time: expected units 's', got None",
        ),
    ],
)
def test_a_clock_that_is_not_in_seconds_is_refused(run, tmp_path, change, match):
    with xr.open_dataset(run / "displacement.nc", engine="h5netcdf", decode_times=False) as file:
        change(file.load()).to_netcdf(tmp_path / "truth.nc", engine="h5netcdf")
    with pytest.raises(ResultsError, match=match):
        evaluate_run(run, tmp_path / "truth.nc")
