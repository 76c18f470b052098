"""The recipe's Hampel filter repairs lone wrong samples and leaves impacts alone, or says what it does to them."""

import numpy as np
import pytest
from scipy import signal

from vfm_sdm.core.sensor_datasets import make_acceleration
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings, compute_reference
from vfm_sdm.inputs.sensors.outliers import OutlierRules, find_worth, treat_outliers
from vfm_sdm.signals.filters import band_pass

RATE = 200.0
TIME = np.arange(round(30 * RATE)) / RATE


def recorded(values):
    return make_acceleration(TIME, ["deck"], ["vertical"], values[:, None, None], sampling_rate_hz=RATE)


def quiet_deck_with_a_joint():
    """Acceleration [m/s2] of a deck that hardly moves and is hit every 2.5 s: Ricker pulses of 20 Hz."""
    values = -5e-6 * (2 * np.pi * 3) ** 2 * np.sin(2 * np.pi * 3 * TIME) * (TIME > 3)
    for at in np.arange(6.0, 28, 2.5):
        far = (np.pi * 20 * (TIME - at)) ** 2
        values = values + 0.17 * (1 - 2 * far) * np.exp(-far)
    noise = np.random.default_rng(0).normal(size=len(TIME))
    return values + 0.012 * signal.sosfiltfilt(signal.butter(4, 25, "highpass", fs=RATE, output="sos"), noise)


def expected_mm(values):
    """Displacement in the band, by the trapezoid without any filter of outliers."""
    velocity = np.cumsum(values - values.mean()) / RATE
    velocity -= np.polyval(np.polyfit(TIME, velocity, 1), TIME)
    return band_pass(1e3 * np.cumsum(velocity) / RATE, RATE, (1.0, 10.0))


def compare(reference, values):
    """Correlation and gain in the band, ends left out."""
    time_s, found = reference["time"].values, reference["displacement"].values[:, 0, 0]
    known = np.isfinite(found)
    found = band_pass(found[known], 30.0, (1.0, 10.0))[90:-90]
    truth = band_pass(np.interp(time_s[known], TIME, expected_mm(values)), 30.0, (1.0, 10.0))[90:-90]
    return np.corrcoef(found, truth)[0, 1], found @ truth / (truth @ truth)


def test_impacts_survive_the_recipe_and_the_note_says_so():
    values = quiet_deck_with_a_joint()
    reference = compute_reference(recorded(values))
    correlation, gain = compare(reference, values)
    assert correlation > 0.99
    assert gain == pytest.approx(1, abs=0.02)
    assert reference["outliers"].item() == 0
    (note,) = reference.attrs["notes"]
    assert "the Hampel filter of the recipe would have replaced" in note
    assert "spread over neighbouring samples as impacts are" in note


def test_the_papers_filter_is_an_option_that_says_what_it_took():
    values = quiet_deck_with_a_joint()
    reference = compute_reference(recorded(values), RecipeSettings(hampel="on"))
    assert compare(reference, values)[0] < 0.8
    assert reference["outliers"].item() > 50
    assert reference["outlier_energy"].item() > 0.2
    assert "use --hampel off" in reference.attrs["notes"][0]
    untouched = compute_reference(recorded(values), RecipeSettings(hampel="off"))
    assert untouched["outliers"].item() == 0
    assert "would have replaced" in untouched.attrs["notes"][0]
    with pytest.raises(DatasetError, match=r"hampel: expected one of \('auto', 'on', 'off'\), got 'maybe'"):
        RecipeSettings(hampel="maybe")


def test_lone_faults_among_impacts_are_replaced_alone():
    values = quiet_deck_with_a_joint()
    faulty = values.copy()
    faulty[[2900, 3900, 5000]] += 2.0
    clean, mended = compute_reference(recorded(values)), compute_reference(recorded(faulty))
    assert mended["outliers"].item() == 3
    assert "3 lone samples alone were replaced" in mended.attrs["notes"][0]
    spoiled = compute_reference(recorded(faulty), RecipeSettings(hampel="off"))
    left, without = (
        np.nanmax(np.abs(one["displacement"].values - clean["displacement"].values)) for one in (mended, spoiled)
    )
    assert left < 0.15 * np.nanmax(np.abs(clean["displacement"].values))
    assert without > 10 * left


def test_lone_faults_alone_are_replaced_as_in_the_paper():
    values = 0.3 * np.sin(2 * np.pi * 2 * TIME) + np.random.default_rng(1).normal(0, 1e-3, len(TIME))
    values[[1500, 3100]] += 5.0
    reference = compute_reference(recorded(values))
    assert reference["outliers"].item() == 2
    assert "lone samples as faults are; --hampel off leaves them" in reference.attrs["notes"][0]


def test_noise_is_not_worth_a_word():
    noise = np.random.default_rng(2).normal(0, 1e-3, (len(TIME), 2)) + np.sin(2 * np.pi * 2 * TIME)[:, None] * [1, 0]
    worth = find_worth(noise, RATE, (1.0, 10.0))
    assert worth.tolist() == [pytest.approx(1e-3), pytest.approx(2e-2)]
    rules = OutlierRules(151, 3.5, RATE, (1.0, 10.0), worth=worth[1])
    assert treat_outliers(noise[:, 1], rules).energy < rules.worth
