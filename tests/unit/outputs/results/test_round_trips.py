"""Results of a measurement, read by programs that know nothing of this package, are those of the dataset."""

from datetime import UTC, datetime

import h5netcdf
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import loadmat
from scipy.io.matlab import MatWriteError

from measurements import measured, simulate
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.core.netcdf import read_displacement, read_tracks, write_displacement, write_tracks
from vfm_sdm.errors import ResultsError
from vfm_sdm.outputs.results import exports, write_export, write_movement

START = datetime(2026, 5, 4, 12, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def measurement():
    """A whole simulated measurement, whose reference view began at a known time."""
    simulated = simulate(3)
    view = simulated.session.view[0].model_copy(update={"start": START, "use_s": (1.5,)})
    session = simulated.session.model_copy(update={"view": (view, *simulated.session.view[1:])})
    return measured(session, simulated.tracks, simulated.solution)


@pytest.fixture(scope="module")
def displacement(measurement):
    return measurement.displacement


def test_a_table_has_what_is_known_of_every_sample(displacement, tmp_path):
    table = pd.read_csv(write_export("csv", tmp_path, displacement))
    names = {
        "": "displacement",
        " std": "displacement_std",
        " combined std": "combined_std",
        " U(k=2)": "expanded_uncertainty",
    }
    points = [str(point) for point in displacement["point"].values]
    assert len(table.columns) == 1 + len(points) * (4 * 3 + 1)
    np.testing.assert_array_equal(table["time_s"], displacement["time"])
    for point in points:
        for axis in STRUCTURE_AXES:
            for words, name in names.items():
                expected = displacement[name].sel(point=point, axis=axis)
                np.testing.assert_allclose(table[f"{point} {axis}{words} [mm]"], expected, rtol=1e-8)


def test_matlab_has_the_budget(displacement, tmp_path):
    content = loadmat(write_export("mat", tmp_path, displacement))
    dims = ("time", "point", "axis")
    for name in ("combined_std", "expanded_uncertainty"):
        np.testing.assert_array_equal(content[f"{name}_mm"], displacement[name].transpose(*dims))
    np.testing.assert_array_equal(content["uncertainty_mm"], displacement["uncertainty"].transpose(*dims, "component"))
    assert [str(cell[0]) for cell in content["components"][:, 0]] == list(displacement["component"].values)
    np.testing.assert_allclose(content["expanded_uncertainty_mm"], 2 * content["combined_std_mm"])
    assert content["start"][0] == "2026-05-04T12:30:01.500000+00:00"


def test_what_is_too_large_for_matlab_is_one_clear_error(displacement, tmp_path, monkeypatch):
    """It needs 4 GB in one array, such as the budget of two hours of 60 points."""

    def refuse(*_, **__):
        raise MatWriteError("Matrix too large to save with Matlab 5 format")

    monkeypatch.setattr(exports, "savemat", refuse)
    with pytest.raises(ResultsError, match=r"displacement\.mat: expected arrays below 4 GB, .* displacement\.nc, too"):
        write_export("mat", tmp_path, displacement)
    assert not list(tmp_path.iterdir())


def open_plain(path, engine):
    pytest.importorskip(engine.replace("netcdf4", "netCDF4"))
    return xr.open_dataset(path, engine=engine, decode_times=False)


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_netcdf_describes_itself_to_anybody(displacement, tmp_path, engine):
    path = write_displacement(tmp_path, displacement)
    with open_plain(path, engine) as found:
        for name in displacement.variables:
            np.testing.assert_array_equal(found[name].values, displacement[name].values, err_msg=str(name))
            if "units" in displacement[name].attrs:
                assert found[name].attrs["units"] == displacement[name].attrs["units"]
        assert found.attrs["Conventions"] == "CF-1.11"
        assert found.attrs["time_coverage_start"] == "2026-05-04T12:30:01.500000+00:00"
        assert found["expanded_uncertainty"].attrs["long_name"].startswith("expanded uncertainty")
        assert "vertical: down" in found["axis"].attrs["positive"]
        unnamed = [name for name in ("time", "displacement", "uncertainty", "scale_std", "position", "status")
                   if "long_name" not in found[name].attrs]  # fmt: skip
        assert unnamed == []
    xr.testing.assert_identical(read_displacement(path), displacement)


def test_tracks_are_groups_of_plain_xarray(measurement, tmp_path):
    path = write_tracks(tmp_path, measurement.tracks)
    tree = xr.open_datatree(path, engine="h5netcdf", decode_times=False)
    for view, tracks in measurement.tracks.items():
        np.testing.assert_array_equal(tree[view]["position"], tracks["position"])
        with xr.open_dataset(path, group=view, engine="h5netcdf", decode_times=False) as alone:
            np.testing.assert_array_equal(alone["position"], tracks["position"])
            assert alone["position"].attrs["long_name"] == "position of the point in the picture"
        xr.testing.assert_identical(read_tracks(path)[view], tracks)
    tree.close()
    with h5netcdf.File(path) as file:
        assert file.attrs["Conventions"] == "CF-1.11"


def test_movement_finds_poses(measurement, tmp_path):
    """The layout that its validator asks for: dims in this order, float positions, coordinates by name, attributes."""
    paths = write_movement(tmp_path, measurement.tracks)
    for path, (view, tracks) in zip(paths, measurement.tracks.items(), strict=True):
        assert path.name == f"movement_{view}.nc"
        with xr.open_dataset(path) as found:
            assert found["position"].dims == ("time", "space", "keypoints", "individuals")
            assert found["confidence"].dims == ("time", "keypoints", "individuals")
            assert found["space"].values.tolist() == ["x", "y"]
            assert found.attrs["ds_type"] == "poses"
            assert found.attrs["time_unit"] == "seconds"
            assert found.attrs["fps"] == pytest.approx(30.0, abs=1e-4)
            np.testing.assert_array_equal(found["time"], tracks["time"])
            assert found["keypoints"].values.tolist() == tracks["point"].values.tolist()
            np.testing.assert_array_equal(
                found["position"].isel(individuals=0).transpose("time", "keypoints", "space"), tracks["position"]
            )
            std = np.sqrt(np.einsum("tpkk->tkp", tracks["position_covariance"].values))
            np.testing.assert_array_equal(found["position_std"].isel(individuals=0), std)
