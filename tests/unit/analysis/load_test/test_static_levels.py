"""Static levels: vibration stays out, scatter is stated as large as it is, and standing is found."""

import numpy as np
import pytest
from scipy.stats import t

from vfm_sdm.analysis.load_test import find_level, find_plateaus
from vfm_sdm.errors import DatasetError

RATE = 30


@pytest.mark.parametrize("frequency", [1.1, 2.2, 7.3])
@pytest.mark.parametrize("phase", [0.0, 1.3])
def test_vibration_does_not_move_a_level(frequency, phase):
    seconds = np.arange(20 * RATE) / RATE
    wave = 0.42 * np.sin(2 * np.pi * frequency * seconds + phase)
    found = find_level(1.5 + wave, np.ones(len(seconds), bool))
    plain = abs(np.mean(wave))
    assert abs(found.value_mm - 1.5) < max(plain / 5, 1e-4)
    assert found.std_mm < 1e-3


def test_stated_scatter_holds():
    """White noise on vibration of changing strength: 95 % intervals by Student's t hold as often as they say."""
    rng, seconds = np.random.default_rng(0), np.arange(15 * RATE) / RATE
    held = []
    for _ in range(1000):
        strength = 0.3 * (1 + 0.5 * np.sin(2 * np.pi * rng.uniform(0.02, 0.1) * seconds + rng.uniform(0, 6)))
        values = strength * np.sin(2 * np.pi * 1.7 * seconds + rng.uniform(0, 6)) + rng.normal(0, 0.2, len(seconds))
        found = find_level(values, rng.random(len(seconds)) > 0.1)
        held.append(abs(found.value_mm) <= t.ppf(0.975, found.freedom) * found.std_mm)
    # Three standard deviations of a share of 1000.
    assert np.mean(held) == pytest.approx(0.95, abs=0.021)


def test_too_few_samples_have_no_level():
    ok = np.zeros(100, bool)
    ok[:19] = True
    found = find_level(np.ones(100), ok)
    assert np.isnan(found.value_mm)
    assert np.isnan(found.std_mm)


def standing(levels, rng, *, stand_s=20.0, move_s=8.0):
    """Displacement that goes from level to level, with vibration and noise, and when it stands."""
    parts, intervals, begin = [], [], 0.0
    for number, level in enumerate(levels):
        parts.append(np.full(round(stand_s * RATE), level))
        intervals.append((begin, begin + stand_s))
        begin += stand_s
        if number + 1 < len(levels):
            x = np.linspace(0, 1, round(move_s * RATE))
            parts.append(level + (levels[number + 1] - level) * (3 * x**2 - 2 * x**3))
            begin += move_s
    values = np.concatenate(parts)
    seconds = np.arange(len(values)) / RATE
    wave = 0.3 * np.sqrt(2) * np.sin(2 * np.pi * 1.8 * seconds + 3 * np.sin(0.2 * seconds))
    return seconds, values + wave + rng.normal(0, 0.05, len(values)), intervals


@pytest.mark.parametrize("seed", range(5))
def test_standing_is_found_inside_what_stands(seed):
    rng = np.random.default_rng(seed)
    levels = np.array([0.0, 1.0, 2.0, 5.0, 2.5, 0.3])
    seconds, values, true = standing(levels, rng)
    other = 0.4 * values + rng.normal(0, 0.05, len(values))
    found = find_plateaus(seconds, np.column_stack([values, other]), len(levels))
    for (begin, end), (stands, moves) in zip(found, true, strict=True):
        assert stands - 0.5 <= begin < end <= moves + 0.5
        assert end - begin > 0.5 * (moves - stands)


def test_a_recording_too_short_for_its_steps_is_refused():
    with pytest.raises(DatasetError, match="expected a recording in which 6 steps can be told, got 200 frames"):
        find_plateaus(np.arange(200) / RATE, np.zeros((200, 1)), 6)


@pytest.mark.parametrize("hidden", [(0.0, 10.0), (76.0, 84.0), (30.0, 44.0)], ids=["begin", "between", "in a step"])
def test_what_is_not_seen_is_no_level(hidden):
    """Fog for a while: the other steps are found where they stand, and no step lies where nothing is seen."""
    levels = np.array([3.0, 1.0, 5.0, 2.0])
    seconds, values, true = standing(levels, np.random.default_rng(1))
    values[(seconds >= hidden[0]) & (seconds < hidden[1])] = np.nan
    found = find_plateaus(seconds, values[:, None], len(levels))
    for (begin, end), (stands, moves) in zip(found, true, strict=True):
        assert stands - 0.5 <= begin < end <= moves + 0.5
        assert np.isfinite(values[(seconds >= begin) & (seconds <= end)]).mean() > 0.5


def test_a_recording_that_shows_too_little_is_refused():
    values = np.full((900, 1), np.nan)
    values[:200] = 0.0
    with pytest.raises(DatasetError, match="expected a recording in which 4 steps are seen, got 22% of it"):
        find_plateaus(np.arange(900) / RATE, values, 4)
