"""Checks and means of arrays."""

import warnings

import numpy as np
import pytest

from vfm_sdm.core.arrays import mean_of_known

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
