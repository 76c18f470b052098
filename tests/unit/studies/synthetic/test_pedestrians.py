from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.pedestrians import Pedestrian

RATE = 1000
WEIGHT = 75 * 9.81
STEADY = {"mass_kg": 75, "start_s": 1.0, "station": 0.5, "rate_variation": 0.0, "force_variation": 0.0}


def harmonic(values, frequency_hz):
    """Amplitude at a frequency of which the series holds whole periods."""
    phase = 2j * np.pi * frequency_hz * np.arange(len(values)) / RATE
    return 2 * abs(np.mean(values * np.exp(phase)))


def steady(person, *, duration_s=10.0):
    """Force over whole steps, after the first ones."""
    return person.force(3.0 + np.arange(round(duration_s * RATE)) / RATE)


@pytest.mark.parametrize("gait", ["walking", "running", "jumping"])
def test_a_person_stands_until_the_start_and_weighs_the_same_on_average(gait):
    person = Pedestrian(gait, rate_hz=2.0, **STEADY)
    still = person.force(np.linspace(0, 1, 200))
    np.testing.assert_allclose(still, np.tile([0, WEIGHT], (200, 1)), atol=1e-9)
    assert np.mean(steady(person)[:, 1]) == pytest.approx(WEIGHT, rel=2e-3)
    assert np.ptp(steady(person)[:, 1]) > 0.4 * WEIGHT


def test_walking_has_the_published_share_of_the_weight_in_each_harmonic():
    force = steady(Pedestrian("walking", rate_hz=2.0, **STEADY))
    vertical = [harmonic(force[:, 1], 2.0 * n) / WEIGHT for n in (1, 2, 3, 4)]
    # Young's mean values at 2, 4, 6 and 8 Hz.
    np.testing.assert_allclose(vertical, [0.37 * 1.05, 0.054 + 0.0176, 0.026 + 0.03, 0.010 + 0.0408], rtol=1e-6)
    lateral = [harmonic(force[:, 0], 1.0 * n) / WEIGHT for n in (1, 2, 3)]
    np.testing.assert_allclose(lateral, [0.039, 0.010, 0.043], rtol=1e-6)


def test_running_is_a_half_sine_while_a_foot_is_down():
    person = Pedestrian("running", rate_hz=2.5, contact_ratio=0.4, **STEADY)
    time_s = 1.0 + 5 * 0.4 + np.linspace(0, 0.4, 401)[:-1]  # the sixth step
    force = person.force(time_s)
    share = np.arange(400) / 400
    expected = np.where(share < 0.4, np.pi / 0.8 * np.sin(np.pi * share / 0.4), 0) * WEIGHT
    np.testing.assert_allclose(force[:, 1], expected, atol=1e-3)
    # To the other side with every step: half the rate.
    following = person.force(time_s + 0.4)
    np.testing.assert_allclose(following[:, 0], -force[:, 0], atol=1e-3)
    assert np.abs(force[:, 0]).max() > 0.05 * WEIGHT


def test_steps_vary_in_length_and_strength_and_the_seed_decides():
    person = Pedestrian("jumping", 75, 2.0, 1.0, 0.5, rate_variation=0.05, force_variation=0.1, seed=4)
    time_s = np.arange(0, 60, 1 / RATE)
    vertical = person.force(time_s)[:, 1]
    lands = time_s[1:][(vertical[:-1] < 1e-6) & (vertical[1:] > 1e-6)]
    assert np.diff(lands).mean() == pytest.approx(0.5, rel=0.02)
    assert 0.03 < np.diff(lands).std() / 0.5 < 0.07
    peaks = [vertical[(time_s >= a) & (time_s < b)].max() for a, b in pairwise(lands)]
    assert 0.07 < np.std(peaks) / np.mean(peaks) < 0.13
    np.testing.assert_array_equal(person.force(time_s), person.force(time_s))
    assert not np.allclose(replace(person, seed=5).force(time_s), person.force(time_s))


@pytest.mark.parametrize("gait", ["walking", "running", "jumping"])
def test_the_force_at_a_time_does_not_depend_on_what_else_is_asked(gait):
    person = Pedestrian(gait, 75, 1.9, 1.0, 0.5, seed=3)
    together = person.force(np.array([2.0, 5.0, 30.0]))
    np.testing.assert_allclose(person.force(np.array([5.0]))[0], together[1], rtol=1e-12)


def test_people_walk_along_the_span_and_turn_round_at_its_ends():
    person = Pedestrian("walking", 75, 1.9, 1.0, 0.6, speed_m_s=1.5)
    stations = person.stations(np.array([0.0, 1.0, 3.0, 9.0, 25.0]), span_m=30.0)
    np.testing.assert_allclose(stations, [0.6, 0.6, 0.7, 1.0, 0.2], atol=1e-12)
    back = replace(person, speed_m_s=-1.5).stations(np.array([3.0, 17.0]), span_m=30.0)
    np.testing.assert_allclose(back, [0.5, 0.2], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gait": "dancing"}, "expected a gait of"),
        ({"mass_kg": 0}, "expected mass and rate > 0"),
        ({"contact_ratio": 1.2}, r"a contact ratio in \(0, 1\]"),
        ({"station": 1.5}, r"a station in \[0, 1\]"),
        ({"rate_variation": 0.5}, r"expected variations in \[0, 0.3\]"),
    ],
)
def test_impossible_people_are_refused(changes, message):
    with pytest.raises(DatasetError, match=message):
        replace(Pedestrian("walking", 75, 2.0, 1.0, 0.5), **changes)
