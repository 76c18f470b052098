"""Clipped, stuck and lost samples are told from a signal that is only coarse, steady or at rest."""

import numpy as np
import pytest

from sensor_files import swinging
from vfm_sdm.inputs.sensors.defects import Reading, find_defects, find_held_samples

TIME, VALUES = swinging(16.0)
RNG = np.random.default_rng(5)


def lively(frequency, rate=200.0, duration_s=30.0, seed=0):
    """Random vibration of a mode, at most 1."""
    time_s = np.arange(round(duration_s * rate)) / rate
    pulse = np.sin(2 * np.pi * frequency * time_s[: int(rate)]) * np.hanning(int(rate))
    series = np.convolve(np.random.default_rng(seed).normal(size=len(time_s)), pulse, "same")
    return series / np.abs(series).max()


@pytest.mark.parametrize("step", [0, 1e-6, 1e-3, 0.01, 0.05, 0.2])
@pytest.mark.parametrize("frequency", [1.7, 2.0, 5.0, 9.7])
@pytest.mark.parametrize("rate", [64.0, 100.0, 200.0])
def test_what_is_only_coarse_steady_or_at_rest_is_left_alone(step, frequency, rate):
    time_s = np.arange(round(30 * rate)) / rate
    steady = np.sin(2 * np.pi * frequency * time_s)
    begun = steady * np.clip((time_s - 3) / 2, 0, 1) ** 2
    series = np.column_stack([steady, begun, np.exp(-0.3 * time_s) * begun, lively(frequency, rate)])
    coarse = np.round(series / step) * step if step else series
    assert not find_defects(coarse).any()


def test_impacts_between_rests_are_left_alone():
    time_s = np.arange(6000) / 200
    struck = np.zeros(6000)
    for at in np.arange(3, 28, 2.5):
        far = (np.pi * 20 * (time_s - at)) ** 2
        struck += RNG.uniform(0.5, 1) * (1 - 2 * far) * np.exp(-far)
    for step in (1e-6, 0.01, 0.1):
        assert not find_defects((np.round(struck / step) * step)[:, None]).any()


@pytest.mark.parametrize("limits", [(-0.7, 0.7), (-9, 0.7), (-0.7, 9)])
@pytest.mark.parametrize("step", [0, 1e-6, 1e-3, 0.01])
def test_clipped_samples_are_found(limits, step):
    series = lively(2.7)
    beyond = (series < limits[0]) | (series > limits[1])
    cut = np.clip(series, *limits)
    found = find_defects((np.round(cut / step) * step if step else cut)[:, None])[:, 0]
    assert beyond.sum() > 30
    assert np.mean(found[beyond] == Reading.CLIPPED) > 0.9
    assert not found[np.abs(series - np.clip(series, limits[0] + 0.02, limits[1] - 0.02)) == 0].any()


def test_a_limit_with_noise_on_it_is_found():
    series = lively(2.7)
    noisy = np.clip(series, -9, 0.6) + RNG.normal(0, 1e-3, len(series))
    found = find_defects(noisy[:, None])[:, 0]
    assert np.mean(found[series > 0.62] == Reading.CLIPPED) > 0.9
    assert not found[series < 0.58].any()
    assert not find_defects((series + RNG.normal(0, 1e-3, len(series)))[:, None]).any()


def test_short_touches_of_the_limit_are_clipped_too():
    time_s = np.arange(6000) / 200
    struck = RNG.normal(0, 1e-3, 6000)
    for at in np.arange(1.001, 29, 1.4037):
        far = (np.pi * 40 * (time_s - at)) ** 2
        struck += RNG.uniform(0.4, 2) * (1 - 2 * far) * np.exp(-far)
    found = find_defects(np.minimum(struck, 0.9)[:, None])[:, 0]
    assert 6 <= (struck >= 0.9).sum() <= 30
    np.testing.assert_array_equal(found == Reading.CLIPPED, struck >= 0.9)


@pytest.mark.parametrize("length", [5, 100])
def test_stuck_samples_are_found(length):
    hung = VALUES.copy()
    hung[1200 : 1200 + length] = hung[1200]
    status = find_defects(hung)
    assert (status[1200 : 1200 + length] == Reading.STUCK).all()
    assert (status != Reading.OK).sum() == 3 * length


def test_a_sensor_of_low_resolution_can_be_stuck_too():
    coarse = np.round(VALUES / 0.01) * 0.01
    coarse[1100:1250] = coarse[1100]
    assert (find_defects(coarse)[1100:1250, :2] == Reading.STUCK).all()


@pytest.mark.parametrize("value", [0.0, -9999.0, 32767.0])
def test_values_that_stand_for_none_are_missing(value):
    lost = RNG.random(len(VALUES)) < 0.01
    status = find_defects(np.where(lost[:, None], value, VALUES))
    np.testing.assert_array_equal(status == Reading.MISSING, np.repeat(lost[:, None], 3, axis=1))


def test_overload_is_clipped_and_nan_is_missing():
    values = VALUES.copy()
    values[500], values[700] = np.inf, np.nan
    status = find_defects(values)
    assert (status[500] == Reading.CLIPPED).all()
    assert (status[700] == Reading.MISSING).all()
    assert (status != Reading.OK).sum() == 6


def test_a_slow_sensor_that_is_read_too_often_is_known():
    held = np.repeat(VALUES[::4], 4, axis=0)
    assert find_held_samples(held) == 4
    assert find_held_samples(VALUES) == 1
    assert find_held_samples(np.zeros((50, 2))) == 1
    assert not find_defects(held).any()
