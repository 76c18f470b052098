import csv

import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.accelerometer import compute_reference
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration
from vfm_sdm.studies.synthetic.sensors import Accelerometer, write_acceleration

G = 9.80665


def still(time_s):
    return np.zeros((len(time_s), 3))


def table(path):
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    return rows[0], np.array(rows[1:], float)


def record(tmp_path, acceleration_of=still, duration_s=4.0, seed=1, **sensor):
    exact = {"name": "a", "noise_g_per_sqrt_hz": 0.0} | sensor
    path = tmp_path / "acc.csv"
    assert write_acceleration(path, Accelerometer(**exact), acceleration_of, duration_s=duration_s, seed=seed) == path
    return table(path)


def test_at_rest_the_downward_axis_reads_minus_one_g(tmp_path):
    header, values = record(tmp_path, bias_g=(0.01, -0.02, 0.03))
    assert header == ["time", "lateral", "vertical", "longitudinal"]
    np.testing.assert_allclose(values[:, 0], np.arange(256) / 64)
    np.testing.assert_allclose(values[:, 1:], np.tile([0.01, -1.02, 0.03], (256, 1)))


def test_acceleration_counts_along_the_axes(tmp_path):
    _, values = record(tmp_path, lambda t: np.column_stack([G * t, 2 * G * t, -G * t]))
    time_s = values[:, 0]
    expected = np.column_stack([time_s, 2 * time_s - 1, -time_s])
    np.testing.assert_allclose(values[:, 1:], expected, atol=1e-9)


def test_the_clock_is_the_sensors_own(tmp_path):
    sensor = Accelerometer("a", clock_offset_s=2.0, clock_rate=1.01)
    seen = []
    _, values = record(
        tmp_path, lambda t: (seen.append(t), still(t))[1], clock_offset_s=2.0, clock_rate=1.01, rate_hz=100.0
    )
    np.testing.assert_allclose(values[:, 0], np.arange(400) / 100)
    np.testing.assert_allclose(seen[0], 2 + np.arange(400) / 101)
    np.testing.assert_array_equal(sensor.true_time(values[:, 0]), seen[0])


def test_noise_has_the_stated_density(tmp_path):
    _, values = record(tmp_path, noise_g_per_sqrt_hz=25e-6, duration_s=100)
    np.testing.assert_allclose(values[:, 1:].std(axis=0), 25e-6 * np.sqrt(32), rtol=0.05)
    assert abs(np.corrcoef(values[:, 1:].T) - np.eye(3)).max() < 0.05


def test_a_tilted_housing_mixes_the_axes(tmp_path):
    # Turned about longitudinal, so that its lateral axis leans towards vertical (down).
    _, values = record(tmp_path, misalignment_deg=(0, 0, 2.0))
    angle = np.radians(2)
    np.testing.assert_allclose(values[0, 1:], [-np.sin(angle), -np.cos(angle), 0], atol=1e-9)


def test_spikes_come_at_the_stated_rate_and_size(tmp_path):
    _, values = record(tmp_path, spikes_per_minute=30, spike_g=0.5, duration_s=600)
    off = values[:, 1:] - [0, -1, 0]
    np.testing.assert_allclose(np.unique(off.round(6)), [-0.5, 0, 0.5])
    assert np.count_nonzero(off) == pytest.approx(900, rel=0.15)


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    paths = [tmp_path / f"{i}.csv" for i in range(3)]
    for path, seed in zip(paths, (7, 7, 8), strict=True):
        write_acceleration(path, Accelerometer("a"), still, duration_s=2, seed=seed)
    first, again, other = (path.read_bytes() for path in paths)
    assert first == again != other


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(DatasetError, match=r"acceleration_of: expected shape \(128, 3\), got \(128, 2\)"):
        write_acceleration(
            tmp_path / "a.csv", Accelerometer("a"), lambda t: np.zeros((len(t), 2)), duration_s=2, seed=1
        )
    with pytest.raises(DatasetError, match="expected finite m/s2"):
        write_acceleration(
            tmp_path / "a.csv", Accelerometer("a"), lambda t: np.full((len(t), 3), np.nan), duration_s=2, seed=1
        )
    for duration in (0.01, float("nan")):
        with pytest.raises(DatasetError, match="duration_s: expected two samples at 64 Hz or more"):
            write_acceleration(tmp_path / "a.csv", Accelerometer("a"), still, duration_s=duration, seed=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("changes", [{"rate_hz": 0}, {"clock_rate": -1}])
def test_clocks_must_run(changes):
    with pytest.raises(DatasetError, match="expected rate_hz and clock_rate > 0"):
        Accelerometer("a", **changes)


@pytest.mark.parametrize("changes", [{"noise_g_per_sqrt_hz": -1}, {"spikes_per_minute": -1}, {"spike_g": -1}])
def test_faults_are_not_negative(changes):
    with pytest.raises(DatasetError, match="expected noise, spike rate and spike size >= 0"):
        Accelerometer("a", **changes)


def test_from_motion_to_file_to_displacement(tmp_path):
    """A burst of 3 mm at 2.4 Hz comes back, in millimetres and with its sign, at the right true time."""
    omega, centre, width = 2 * np.pi * 2.4, 8.0, 1.5

    def displacement(t):
        return 3e-3 * np.exp(-(((t - centre) / width) ** 2)) * np.sin(omega * t)

    def acceleration(t):
        step = 1e-3
        second = (displacement(t + step) - 2 * displacement(t) + displacement(t - step)) / step**2
        return np.column_stack([0 * t, second, 0 * t])

    sensor = Accelerometer("a", bias_g=(0.01, 0.02, 0.0), clock_offset_s=0.7, clock_rate=1.0001)
    path = write_acceleration(tmp_path / "a.csv", sensor, acceleration, duration_s=16, seed=2)
    reference = compute_reference(read_acceleration(path))
    found = reference["displacement"].sel(axis="vertical", sensor="a").values
    truth = 1e3 * displacement(sensor.true_time(reference["time"].values))
    known = np.isfinite(found)
    assert reference.attrs["onset_s"] > 2
    # Half of this bound is the trapezoid's loss of amplitude, half noise integrated twice.
    assert abs(found - truth)[known].max() < 0.1
    assert np.polyfit(truth[known], found[known], 1)[0] == pytest.approx(0.99, abs=0.006)
