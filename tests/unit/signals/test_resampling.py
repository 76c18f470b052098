"""Interpolation over runs of valid samples."""

import numpy as np
import pytest

from vfm_sdm.signals.resampling import interpolate_runs

HAVE = np.arange(12) / 10
WANT = np.linspace(-0.1, 1.2, 131)


def test_degree_one_draws_straight_lines():
    values = np.random.default_rng(0).normal(size=(12, 3))
    inside = (HAVE[0] <= WANT) & (HAVE[-1] >= WANT)
    found = interpolate_runs(HAVE, values, WANT, degree=1)
    expected = np.stack([np.interp(WANT[inside], HAVE, column) for column in values.T], axis=-1)
    np.testing.assert_allclose(found[inside], expected, atol=1e-14)
    assert np.isnan(found[~inside]).all()


@pytest.mark.parametrize(("samples", "power"), [(2, 1), (3, 1), (4, 3), (5, 3), (6, 5), (12, 5)])
def test_a_short_run_gets_the_degree_that_it_has_samples_for(samples, power):
    have = HAVE[:samples]
    want = np.linspace(have[0], have[-1], 50)
    found = interpolate_runs(have, have[:, None] ** power, want)[:, 0]
    np.testing.assert_allclose(found, want**power, atol=1e-12)
    above = interpolate_runs(have, have[:, None] ** (power + 2), want)[:, 0]
    assert np.abs(above - want ** (power + 2)).max() > 1e-6


def test_runs_end_at_gaps_and_at_long_steps():
    values = np.ones((12, 2))
    values[4, 1] = np.nan
    have = HAVE + np.where(np.arange(12) >= 8, 0.3, 0.0)
    found = np.isfinite(interpolate_runs(have, values, WANT, longest_step_s=0.2)).all(axis=1)
    expected = [(have[i] <= WANT) & (have[j] >= WANT) for i, j in ((0, 3), (5, 7), (8, 11))]
    np.testing.assert_array_equal(found, np.logical_or.reduce(expected))
