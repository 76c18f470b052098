"""A field against motion that is known: its line, its bands, the points it leaves out, its shapes."""

import numpy as np
import pytest
import xarray as xr

from fields import FREQUENCIES_HZ, draw_field
from vfm_sdm.analysis.field import compute_field, compute_mac, extreme_times, find_shapes, read_field, write_field
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement
from vfm_sdm.errors import DatasetError


@pytest.fixture(scope="module")
def drawn():
    return draw_field(1)


@pytest.fixture(scope="module")
def field(drawn):
    return compute_field(drawn.displacement, stations=41)


def test_the_line_is_the_beams_within_its_scale(drawn, field):
    true = drawn.truth(field["station"].values)
    error = field["displacement"].values - true
    assert (np.abs(error) < 5 * field["displacement_std"].values).all()
    for axis in range(2):
        assert np.sqrt((error[..., axis] ** 2).mean()) < 0.02 * np.abs(true[..., axis]).max()


def test_the_line_is_better_than_its_points(drawn, field):
    error = field["displacement"].values - drawn.truth(field["station"].values)
    points = drawn.displacement["displacement"].values - drawn.truth(field["point_place"].values[:, 2])
    assert np.sqrt((error[..., 1] ** 2).mean()) < 0.7 * np.sqrt(np.median(points[..., 1] ** 2, axis=1).mean()) + 0.03


def test_points_that_follow_something_else_are_named_and_do_not_count(drawn, field):
    left_out = [str(n) for n, why in zip(field["point"].values, field["reason"].values, strict=True) if why]
    assert set(drawn.bad) <= set(left_out)
    assert len(left_out) < 0.2 * field.sizes["point"]
    assert all("departs from its neighbours" in str(field["reason"].sel(point=name).item()) for name in drawn.bad)
    without = compute_field(draw_field(1, bad=0).displacement, stations=41)
    np.testing.assert_allclose(without["displacement"].values[..., 1], field["displacement"].values[..., 1], atol=0.05)


def test_what_neighbours_share_is_found_in_the_residuals(field):
    one = field.sel(axis="vertical")
    assert 0.3 < float(one["correlated_share"]) < 0.9
    assert 0.1 < float(one["correlation_length"]) < 0.8
    assert 0.004 < float(one["gain_scatter"]) < 0.02
    assert 0.02 < float(one["point_std"]) < 0.045


def test_noise_that_all_points_share_is_in_the_band(drawn):
    calm = compute_field(draw_field(1, shared_noise=0.0).displacement, stations=5)
    noisy = compute_field(draw_field(1, shared_noise=0.1).displacement, stations=5)
    assert float(calm["displacement_std"].sel(axis="vertical").min()) < 0.03
    assert 0.09 < float(noisy["displacement_std"].sel(axis="vertical").min()) < 0.13


def test_what_moves_at_rest_is_an_error_of_the_line(drawn):
    still = drawn.displacement.copy(deep=True)
    still["displacement"][:30] = 0.2
    alone = compute_field(drawn.displacement, stations=5, still_interval_s=None)
    found = compute_field(still, stations=5, still_interval_s=(0.0, 0.95))
    assert float(found["displacement_std"].min()) > 0.15 > float(alone["displacement_std"].min())


def test_gaps_of_points_are_no_gaps_of_the_line(drawn):
    gaps = drawn.displacement.copy(deep=True)
    rng = np.random.default_rng(0)
    lost = rng.random(gaps["status"].shape) < 0.02
    lost[50] = True
    gaps["status"].values[lost] = Status.LOST
    gaps["status"].values[:, 7] = Status.LOST
    found = compute_field(gaps, stations=5)
    # Lines reach as far as the points that they use, which differ.
    whole = compute_field(drawn.displacement, stations=81).interp(station=found["station"].values)
    assert np.isnan(found["displacement"].values[50]).all()
    known = np.delete(np.arange(120), 50)
    # At the very ends, the line rests on few points.
    apart = (found["displacement"] - whole["displacement"].values).values[known, 1:-1, 1]
    assert np.abs(apart).max() < 0.08
    assert found["reason"].values[7] == "100 % of its samples are missing"


def test_shapes_are_those_of_the_motion(drawn, field):
    true = drawn.truth(field["station"].values)
    shapes, frequency = find_shapes(true, field["time"].values)
    np.testing.assert_allclose(field["shape_frequency"].sel(axis="vertical"), FREQUENCIES_HZ, atol=0.3)
    np.testing.assert_allclose(field["shape_frequency"].sel(axis="vertical"), frequency[:, 1])
    for number in range(3):
        assert compute_mac(field["shape"].values[number, :, 1], shapes[number, :, 1]) > 0.98


def test_static_points_are_not_of_the_structure(drawn):
    found = compute_field(drawn.displacement, static=["web 001"], stations=5)
    assert found["reason"].values[0] == "not of the structure"
    assert float(found["station"][0]) > float(drawn.displacement["origin"][0, 2])


def test_misuse_is_named(drawn):
    with pytest.raises(DatasetError, match="expected displacement along the structure's axes"):
        compute_field(drawn.displacement.assign_attrs(frame="reference camera"))
    with pytest.raises(DatasetError, match="expected at least 6 points of the structure"):
        compute_field(drawn.displacement.isel(point=slice(5)))
    with pytest.raises(DatasetError, match="stations: expected at least 2, got 1"):
        compute_field(drawn.displacement, stations=1)


def bend(station, count=120):
    """A beam of 10 m in three modes, with errors of 0.01 mm, by few points at these stations, and the truth."""
    time_s, rng = np.arange(count) / 20, np.random.default_rng(3)

    def true(where):
        waves = [
            size * np.sin(rate * time_s + mode)[:, None] * np.sin(mode * np.pi * np.asarray(where) / 10)
            for mode, size, rate in ((1, 1.0, 9.0), (2, 0.4, 23.0), (3, 0.15, 41.0))
        ]
        return sum(waves)

    values = rng.normal(0, 0.01, (count, len(station), 3))
    values[..., 1] += true(station)
    place = np.zeros(values.shape)
    place[..., 2] = station
    arrays = DisplacementArrays(
        values, np.full(values.shape, 0.01), np.zeros(values.shape[1:]), place, *np.zeros((2, *values.shape[:2]))
    )
    names = [f"p{number}" for number in range(len(station))]
    return make_displacement(time_s, names, STRUCTURE_AXES, arrays, attrs={"frame": "structure"}), true


@pytest.mark.parametrize("count", [6, 8, 12, 20, 60])
def test_a_few_points_do_not_know_how_the_structure_bends_between_them(count):
    displacement, true = bend(np.linspace(0, 10, count))
    one = compute_field(displacement, stations=41).sel(axis="vertical")
    off = (one["displacement"].values - true(one["station"].values)) / one["displacement_std"].values
    # Bands of a line through a few points were two to three times too narrow.
    assert np.sqrt((off**2).mean()) < 1.7
    if count == 60:
        assert float(one["displacement_std"].median()) < 0.004


@pytest.mark.parametrize(
    ("station", "said"),
    [
        (np.full(8, 5.0), "those along lateral at one station, 5.00 m"),
        (np.repeat([2.0, 8.0], 5), "got none along lateral from 2.00 m to 8.00 m"),
        (np.r_[np.linspace(0, 1, 8), 10.0], "got none along lateral from 1.00 m to 10.00 m"),
    ],
)
def test_nothing_is_said_of_places_far_from_any_point(station, said):
    with pytest.raises(DatasetError, match=said):
        compute_field(bend(station)[0])


def test_nothing_is_said_beyond_the_outermost_points_of_any_axis():
    apart, _ = bend(np.linspace(0, 10, 20))
    apart["displacement"].values[:, 10:, 0] = np.nan
    found = compute_field(apart, stations=5)
    assert float(found["station"].max()) < 10 * 10 / 19
    apart["displacement"].values[:, :10, 1] = np.nan
    with pytest.raises(DatasetError, match=r"stations with points along every axis, got none: lateral 0\.\d+ m to 4"):
        compute_field(apart)


def test_a_few_frames_and_points_without_an_uncertainty_make_no_field():
    displacement, _ = bend(np.linspace(0, 10, 20))
    with pytest.raises(DatasetError, match="expected at least 20 frames"):
        compute_field(displacement.isel(time=slice(19)))
    displacement["displacement_std"].values[:] = np.nan
    with pytest.raises(DatasetError, match="expected at least 6 points of the structure"):
        compute_field(displacement)


def test_files_hold_the_field(field, tmp_path):
    times_s = extreme_times(field, "vertical")
    netcdf, table = write_field(tmp_path, field, times_s)
    xr.testing.assert_allclose(read_field(tmp_path).drop_attrs(), field.drop_attrs())
    lines = table.read_text(encoding="utf-8").splitlines()
    assert lines[0].split(",")[:3] == ["time_s", "station_m", "lateral_mm"]
    assert len(lines) == 1 + 2 * field.sizes["station"]
    largest = float(np.abs(field["displacement"].sel(axis="vertical")).max())
    assert max(abs(float(line.split(",")[3])) for line in lines[1:]) == pytest.approx(largest, rel=1e-4)
    assert netcdf.name == "field.nc"
    assert read_field(tmp_path / "elsewhere") is None


@pytest.mark.hundreds
def test_bands_hold_over_many_draws():
    inside = []
    for seed in range(100):
        drawn = draw_field(seed, points=150, frames=60, bad=2)
        found = compute_field(drawn.displacement, stations=21)
        error = found["displacement"].values - drawn.truth(found["station"].values)
        inside.append((np.abs(error) <= 1.96 * found["displacement_std"].values).mean(axis=(0, 1)))
    assert (np.mean(inside, axis=0) > 0.92).all()
    assert (np.mean(inside, axis=0) < 0.98).all()
