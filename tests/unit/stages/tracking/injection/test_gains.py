"""Gains of series, and their standard deviations, against many draws."""

import numpy as np
import pytest

from vfm_sdm.stages.tracking.injection.gains import Gain, combine_gains, compute_gain, smooth_motion

T = np.arange(300)
TRUE = np.sin(T / 4) + 0.4 * np.sin(T / 1.7)


@pytest.mark.parametrize("lag", [1, 8])
def test_the_standard_deviation_of_a_gain_is_that_of_many_draws(lag):
    rng = np.random.default_rng(1)
    kernel = np.ones(lag) / np.sqrt(lag)
    draws = [
        compute_gain(0.95 * TRUE + np.convolve(rng.normal(0, 0.1, 300 + lag), kernel)[:300], TRUE) for _ in range(300)
    ]
    gains = np.array([one.gain for one in draws])
    assert gains.mean() == pytest.approx(0.95, abs=0.002)
    assert np.mean([one.std for one in draws]) == pytest.approx(gains.std(), rel=0.25)
    assert np.mean([one.noise for one in draws]) == pytest.approx(0.1, rel=0.1)


def test_a_gain_of_nothing_is_not_known():
    assert np.isnan(compute_gain(TRUE[:10], TRUE[:10]).gain)
    assert np.isnan(compute_gain(TRUE, np.zeros(300)).gain)
    lost = np.where(T % 2, np.nan, 0.9 * TRUE)
    assert compute_gain(lost, TRUE).gain == pytest.approx(0.9)


def test_smooth_motion_keeps_motion_and_leaves_noise():
    noise = np.random.default_rng(2).normal(0, 0.05, (300, 2))
    true = np.column_stack([TRUE, 0 * TRUE])
    smooth = smooth_motion(true + noise)
    assert (smooth[20:-20] - true[20:-20] - (smooth[20:-20] - true[20:-20]).mean(axis=0)).std() < 0.025
    np.testing.assert_array_equal(smooth[0], 0)


def test_gains_of_passes_are_weighed_and_their_spread_counts():
    alike = combine_gains([Gain(0.95, 0.01, 0.1), Gain(0.95, 0.01, 0.1)], loss_share=0.0)
    assert alike.std == pytest.approx(0.01 / np.sqrt(2))
    apart = combine_gains([Gain(0.93, 0.01, 0.1), Gain(0.97, 0.01, 0.1)], loss_share=0.3)
    assert apart.gain == pytest.approx(0.95)
    assert apart.std == pytest.approx(np.sqrt(0.01**2 / 2 + 0.02**2 + 0.015**2))
    assert np.isnan(combine_gains([Gain(0.9, 0.3, 0.1)], loss_share=0.3).gain)
    assert np.isnan(combine_gains([Gain(np.nan, np.nan, 0.1)], loss_share=0.3).gain)
