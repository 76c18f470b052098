from dataclasses import fields

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from vfm_sdm.core.arrays import as_float_array
from vfm_sdm.core.datasets import (
    CAMERA_AXES,
    PIXEL,
    STATUS_MEANINGS,
    STRUCTURE_AXES,
    DisplacementArrays,
    Status,
    check_displacement,
    check_tracks,
    convert_units,
    make_displacement,
    make_tracks,
    status_variable,
)
from vfm_sdm.core.sensor_datasets import (
    ReferenceFacts,
    check_acceleration,
    check_reference,
    make_acceleration,
    make_reference,
)
from vfm_sdm.errors import DatasetError, SessionError, VfmSdmError


def tracks(frames=4, **changes):
    arguments = {
        "time_s": np.arange(frames) / 60,
        "points": ["a", "b"],
        "position": np.arange(frames * 4.0).reshape(frames, 2, 2),
        "position_covariance": np.broadcast_to(np.eye(2), (frames, 2, 2, 2)),
        "status": np.zeros((frames, 2)),
        "attrs": {"tracker": "icgn", "view": "left"},
    } | changes
    return make_tracks(**arguments)


def displacement(frames=4, **changes):
    shape = (frames, 2, 3)
    arguments = {
        "time_s": np.arange(frames) / 60,
        "points": ["a", "b"],
        "axes": STRUCTURE_AXES,
        "displacement_mm": np.arange(frames * 6.0).reshape(shape),
        "displacement_std_mm": np.ones(shape),
        "scale_std": np.full((2, 3), 0.02),
        "position_m": np.zeros(shape),
        "reprojection_error_px": np.zeros(shape[:2]),
        "status": np.zeros(shape[:2]),
        "attrs": {"frame": "structure"},
    } | changes
    arrays = DisplacementArrays(**{field.name: arguments.pop(field.name) for field in fields(DisplacementArrays)})
    return make_displacement(arrays=arrays, **arguments)


def test_tracks_name_their_axes_and_units():
    data = tracks()
    assert data["position"].dims == ("time", "point", "pixel")
    assert data["position_covariance"].dims == ("time", "point", "pixel_a", "pixel_b")
    assert (data["position"].attrs["units"], data["position_covariance"].attrs["units"]) == ("px", "px2")
    assert data["time"].attrs["units"] == "s"
    assert float(data["position"].sel(point="b", pixel="v").isel(time=1)) == 7.0
    assert tuple(data["pixel"].values) == PIXEL == ("u", "v")
    assert data.attrs == {"tracker": "icgn", "view": "left"}


def test_displacement_names_its_axes_and_units():
    data = displacement()
    units = {name: data[name].attrs.get("units") for name in data.data_vars}
    assert units == {
        "displacement": "mm",
        "displacement_std": "mm",
        "scale_std": "1",
        "position": "m",
        "reprojection_error": "px",
        "status": None,
    }
    assert float(data["displacement"].sel(point="b", axis="longitudinal").isel(time=0)) == 5.0
    camera = displacement(axes=CAMERA_AXES)
    assert tuple(camera["axis"].values) == ("right", "down", "forward")


def test_status_tells_what_its_codes_mean():
    status = status_variable(("time",), [Status.OK, Status.LOST, Status.OUTSIDE, Status.UNRELIABLE, Status.BEHIND])
    words = status.attrs["flag_meanings"].split()
    assert [words[code] for code in status.values] == ["ok", "lost", "outside", "unreliable", "behind_camera"]
    assert list(status.attrs["flag_values"]) == list(range(len(STATUS_MEANINGS)))
    assert status.dtype == np.int8


@pytest.mark.parametrize(
    "changes",
    [
        {"position": np.zeros((3, 2, 2))},
        {"position": np.zeros((4, 2))},
        {"points": ["a"]},
        {"status": np.zeros((4, 3))},
    ],
)
def test_tracks_of_unequal_shape_are_refused(changes):
    with pytest.raises(DatasetError, match="tracks: expected arrays of one number of frames and points"):
        tracks(**changes)


def test_displacement_of_unequal_shape_is_refused():
    with pytest.raises(DatasetError, match="displacement: expected arrays of one number of frames and points"):
        displacement(scale_std=np.zeros((3, 3)))


@pytest.mark.parametrize("time_s", [[0, 1, 1, 2], [0, 2, 1, 3], [0, 1, np.nan, 3], [0, 1, 2, np.inf]])
@pytest.mark.parametrize("make", [tracks, displacement])
def test_clock_must_increase(make, time_s):
    with pytest.raises(DatasetError, match="time: expected finite, increasing seconds"):
        make(time_s=np.array(time_s, float))


def test_one_frame_is_a_recording():
    assert tracks(1).sizes["time"] == 1


@pytest.mark.parametrize("name", ["position", "position_covariance", "status"])
def test_tracks_lacking_a_variable_are_refused(name):
    with pytest.raises(DatasetError, match=f"dataset: expected a variable '{name}', got"):
        check_tracks(tracks().drop_vars(name))


@pytest.mark.parametrize("name", list(displacement().data_vars))
def test_displacement_lacking_a_variable_is_refused(name):
    with pytest.raises(DatasetError, match=f"dataset: expected a variable '{name}', got"):
        check_displacement(displacement().drop_vars(name))


def test_other_dims_and_units_are_refused():
    with pytest.raises(DatasetError, match=r"position: expected dims \('time', 'point', 'pixel'\), got \('point', "):
        check_tracks(tracks().transpose("point", ...))


@pytest.mark.parametrize("code", [-1, len(STATUS_MEANINGS)])
def test_a_status_without_meaning_is_refused(code):
    damaged = tracks()
    damaged["status"][0, 0] = code
    with pytest.raises(DatasetError, match=f"status: expected codes from 0 to 4, got {code}"):
        check_tracks(damaged)
    wrong = displacement()
    wrong["displacement"].attrs["units"] = "m"
    with pytest.raises(DatasetError, match="displacement: expected units 'mm', got 'm'; convert them"):
        check_displacement(wrong)
    # Arithmetic keeps the units of what came in or drops them: both are noticed.
    scaled = displacement()
    scaled["position"] = (scaled["position"] * 1000).drop_attrs()
    with pytest.raises(DatasetError, match="position: expected units 'm', got None"):
        check_displacement(scaled)


def test_synchronized_tracks_lead_with_the_view():
    both = xr.concat([tracks(), tracks()], dim="view").assign_coords(view=["left", "right"])
    assert check_tracks(both, synchronized=True) is both
    with pytest.raises(DatasetError, match=r"position: expected dims \('time'"):
        check_tracks(both)
    with pytest.raises(DatasetError, match=r"position: expected dims \('view'"):
        check_tracks(tracks(), synchronized=True)


@pytest.mark.parametrize(
    ("have", "want", "factor"),
    [("m", "mm", 1e3), ("mm", "m", 1e-3), ("g", "m/s2", 9.80665), ("m/s2", "g", 1 / 9.80665)],
)
def test_values_and_units_change_together(have, want, factor):
    array = xr.DataArray([1.0, -2.0], dims="time", attrs={"units": have, "note": "kept"}, name="x")
    converted = convert_units(array, want)
    np.testing.assert_allclose(converted, [factor, -2 * factor], rtol=1e-15)
    assert converted.attrs == {"units": want, "note": "kept"}
    assert array.attrs["units"] == have
    xr.testing.assert_allclose(convert_units(converted, have), array)


def test_same_units_change_nothing():
    array = xr.DataArray([1.0], attrs={"units": "mm"})
    assert convert_units(array, "mm") is array


def test_unknown_units_are_refused():
    with pytest.raises(DatasetError, match="got 'px' to 'mm'"):
        convert_units(xr.DataArray([1.0], attrs={"units": "px"}), "mm")
    with pytest.raises(DatasetError, match="got 'None' to 'mm'; set `units`"):
        convert_units(xr.DataArray([1.0]), "mm")


def test_as_float_array_gives_doubles_of_the_expected_shape():
    array = as_float_array([[1, 2], [3, 4]], "points2d", (None, 2))
    assert (array.dtype, array.shape) == (np.float64, (2, 2))
    assert as_float_array(5, "value", ()).shape == ()
    assert as_float_array(np.zeros((7, 3, 4)), "poses", (-1, 3, 4)).shape == (7, 3, 4)
    assert as_float_array(np.zeros((3, 4)), "poses", (-1, 3, 4)).shape == (3, 4)


@given(st.lists(st.integers(0, 4), max_size=4), st.lists(st.none() | st.integers(0, 4), max_size=3), st.booleans())
def test_as_float_array_accepts_exactly_the_trailing_shapes_that_fit(shape, wanted, open_front):
    lead = len(shape) - len(wanted)
    fits = (lead >= 0 if open_front else lead == 0) and all(
        want is None or want == got for want, got in zip(wanted, shape[max(lead, 0) :], strict=False)
    )
    expected = (-1, *wanted) if open_front else tuple(wanted)
    if fits:
        assert as_float_array(np.zeros(shape), "x", expected).shape == tuple(shape)
    else:
        with pytest.raises(DatasetError, match="x: expected shape"):
            as_float_array(np.zeros(shape), "x", expected)


def test_as_float_array_names_what_is_wrong():
    with pytest.raises(DatasetError, match=r"points2d: expected shape \(\.\.\., any, 2\), got \(5, 3\); reshape it"):
        as_float_array(np.zeros((5, 3)), "points2d", (-1, None, 2))
    with pytest.raises(DatasetError, match="points2d: expected numbers, got list; pass a numeric array"):
        as_float_array(["a"], "points2d", (None,))
    with pytest.raises(DatasetError, match="points2d: expected numbers, got dict"):
        as_float_array({}, "points2d", ())  # type: ignore[arg-type]


def test_every_error_is_also_a_built_in_one():
    assert issubclass(DatasetError, ValueError)
    assert issubclass(SessionError, ValueError)
    assert issubclass(DatasetError, VfmSdmError)


def acceleration(**changes):
    arguments = {
        "time_s": 5 + np.arange(6) / 64,
        "sensors": ["a", "b"],
        "axes": STRUCTURE_AXES[:2],
        "acceleration": np.arange(24.0).reshape(6, 2, 2),
        "sampling_rate_hz": 64.0,
    } | changes
    return make_acceleration(**arguments)


def reference(**changes):
    arguments = {
        "time_s": np.arange(6) / 30,
        "sensors": ["a"],
        "axes": STRUCTURE_AXES,
        "displacement_mm": np.zeros((6, 1, 3)),
        "sampling_rate_hz": 30.0,
        "onset_s": 0.1,
        "band_hz": (1.0, 10.0),
        "attrs": {"onset_status": "detected"},
    } | changes
    facts = ReferenceFacts(**{field.name: arguments.pop(field.name) for field in fields(ReferenceFacts)})
    return make_reference(facts=facts, **arguments)


def test_sensor_datasets_name_their_axes_units_and_attributes(tmp_path):
    data = acceleration(attrs={"file": "a.csv"})
    assert data["acceleration"].dims == ("time", "sensor", "axis")
    assert data["acceleration"].attrs["units"] == "m/s2"
    assert data.attrs == {"sampling_rate_hz": 64.0, "file": "a.csv"}
    assert float(data["acceleration"].sel(sensor="b", axis="vertical").isel(time=1)) == 7
    data = reference()
    assert data["displacement"].dims == ("time", "sensor", "axis")
    assert data["displacement"].attrs["units"] == "mm"
    assert data.attrs == {
        "sampling_rate_hz": 30.0,
        "onset_s": 0.1,
        "band_hz": [1.0, 10.0],
        "onset_status": "detected",
    }
    data.to_netcdf(tmp_path / "reference.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "reference.nc", engine="h5netcdf", decode_times=False) as again:
        check_reference(again)
        assert list(again.attrs["band_hz"]) == [1.0, 10.0]


def test_sensor_datasets_with_a_fault_are_refused():
    with pytest.raises(DatasetError, match=r"acceleration: expected shape \(time, sensor, axis\)"):
        acceleration(sensors=["a"])
    with pytest.raises(DatasetError, match=r"reference: expected shape \(time, sensor, axis\)"):
        reference(sensors=["a", "b"])
    with pytest.raises(DatasetError, match=r"expected t0 \+ i / 60 s, got 5.015625 s as sample 1; cut"):
        acceleration(sampling_rate_hz=60)
    for rate in (0, -1, float("nan"), float("inf")):
        with pytest.raises(DatasetError, match="sampling_rate_hz: expected an attribute > 0 Hz"):
            acceleration(sampling_rate_hz=rate)
    with pytest.raises(DatasetError, match="time: expected finite, increasing seconds"):
        reference(time_s=np.zeros(6))
    with pytest.raises(DatasetError, match="units 'm/s2'"):
        check_acceleration(acceleration().assign(acceleration=lambda d: d["acceleration"].drop_attrs()))
    with pytest.raises(DatasetError, match="units 'mm'"):
        check_reference(reference().assign(displacement=lambda d: d["displacement"].drop_attrs()))
    bare = reference()
    del bare.attrs["band_hz"]
    with pytest.raises(DatasetError, match=r"missing \['band_hz'\]"):
        check_reference(bare)
