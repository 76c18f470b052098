"""Checks and means of arrays."""

import warnings

import numpy as np
import pytest

from vfm_sdm.core.arrays import clock_departure, is_even_clock, mean_of_known

VALUES = np.array([[1.0, np.nan, 5.0], [3.0, np.nan, np.nan]])


@pytest.fixture(autouse=True)
def no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_what_is_not_a_number_does_not_count():
    np.testing.assert_array_equal(mean_of_known(VALUES), [2.0, np.nan, 5.0])
    np.testing.assert_array_equal(mean_of_known(VALUES, axis=1), [3.0, 3.0])
    assert mean_of_known(VALUES, axis=(0, 1)) == 3.0


def test_only_what_is_known_counts():
    known = np.array([[True], [False]])
    np.testing.assert_array_equal(mean_of_known(VALUES[:, [0, 2]], known), [1.0, 5.0])
    np.testing.assert_array_equal(mean_of_known(VALUES, np.zeros((2, 3), bool)), [np.nan] * 3)


def test_departure_of_a_clock_is_counted_in_intervals():
    stamps = 7.0 + 0.02 * np.array([0.0, 1.0, 2.03, 3.0, 5.0])
    np.testing.assert_allclose(clock_departure(stamps, 0.02), [0, 0, 0.03, 0, 1], atol=1e-12)
    assert is_even_clock(stamps[:4], 0.02, tolerance=0.04)
    assert not is_even_clock(stamps[:4], 0.02, tolerance=0.02)
    assert not is_even_clock(stamps, 0.02, tolerance=0.9)
