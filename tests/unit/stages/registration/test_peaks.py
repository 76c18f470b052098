"""Whether the best of several places stands out."""

import numpy as np
import pytest

from vfm_sdm.stages.registration.peaks import AMBIGUITY_MARGIN, has_rival

PLACES = np.array([[10.0, 10.0], [11.5, 10.0], [40.0, 10.0], [np.nan, np.nan]])


@pytest.mark.parametrize(
    ("correlation", "rival"),
    [
        ([0.95, 0.94, 0.80, 0.99], False),  # next to the winner is the winner, and nowhere is no place
        ([0.95, 0.60, 0.95 - 0.9 * AMBIGUITY_MARGIN, -np.inf], True),
        ([0.95, 0.60, 0.95 - 1.1 * AMBIGUITY_MARGIN, -np.inf], False),
    ],
)
def test_a_rival_is_elsewhere_and_as_good(correlation, rival):
    assert has_rival(np.array(correlation), PLACES, 0) is rival


def test_what_counts_as_elsewhere_can_be_said():
    correlation = np.array([0.95, 0.94, 0.2, 0.2])
    assert not has_rival(correlation, PLACES, 0)
    assert has_rival(correlation, PLACES, 0, distinct_px=1.0)


def test_a_single_place_has_no_rival():
    assert not has_rival(np.array([0.9]), PLACES[:1], 0)
