"""Checks of what subsets cover, from tracks that say it."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core.statuses import Outcome
from vfm_sdm.stages.audit.references import check_references
from vfm_sdm.stages.audit.subsets import check_believed, check_parts


class Inputs:
    """Tracks of one view and the names of its points on the structure."""

    def __init__(self, **variables):
        tracks = xr.Dataset(
            {
                "part_gain_std": (("point", "direction"), [[0.01, 0.02], [np.nan, np.nan], [0.9, 0.9]]),
                "believed": ("point", [1.0, 0.9, 0.1]),
                "edge_across": (("point", "pixel"), np.full((3, 2), np.nan)),
            },
            coords={"point": ["a", "b", "static"]},
        )
        self.tracks, self.moving = {"left": tracks.assign(variables)}, ["a", "b"]
        self.cameras = SimpleNamespace(points=xr.Dataset(coords={"view": ["left"], "point": ["a", "b", "static"]}))


def test_points_of_the_structure_that_move_as_a_whole_pass():
    assert check_parts(Inputs()).outcome == check_believed(Inputs()).outcome == Outcome.PASS


@pytest.mark.parametrize("direction", [0, 1])
def test_gains_that_differ_in_rows_or_columns_are_a_caution(direction):
    spread = np.array([[0.01, 0.01], [0.01, 0.01], [0.0, 0.0]])
    spread[1, direction] = 0.08
    found = check_parts(Inputs(part_gain_std=(("point", "direction"), spread)))
    assert found.outcome == Outcome.CAUTION
    assert found.where == "b in left"
    assert "parts of the subset of b in left move by different amounts" in found.sentence


def test_a_square_that_moves_otherwise_is_a_caution_and_an_edge_has_half_of_it():
    believed = ("point", [1.0, 0.28, 1.0])
    assert check_believed(Inputs(believed=believed)).outcome == Outcome.CAUTION
    across = np.full((3, 2), np.nan)
    across[1] = 0.6, 0.8
    assert check_believed(Inputs(believed=believed, edge_across=(("point", "pixel"), across))).outcome == Outcome.PASS


def test_trackers_that_say_nothing_of_subsets_are_not_judged():
    inputs = Inputs()
    inputs.tracks = {"left": inputs.tracks["left"].drop_vars(["part_gain_std", "believed"])}
    assert check_parts(inputs).outcome == check_believed(inputs).outcome == Outcome.NOT_POSSIBLE


def renewed(*std_px):
    """Tracks of points whose references were renewed once, which adds these standard deviations [px]."""
    added = np.zeros((2, 3, 2, 2))
    added[1] = np.eye(2) * np.reshape(std_px, (3, 1, 1)) ** 2
    return Inputs(reference_covariance=(("reference_frame", "point", "pixel_a", "pixel_b"), added))


def test_renewed_references_say_what_they_add():
    assert check_references(Inputs()) is None
    found = check_references(renewed(0.02, 0.03, np.nan))
    assert found.outcome == Outcome.PASS
    assert found.where == "b in left"
    assert found.value == pytest.approx(0.03)
    assert "renewed 1 times as light changed; that adds 0.030 px in b in left" in found.sentence


def test_references_that_add_more_than_a_position_may_have_are_a_caution():
    found = check_references(renewed(0.02, 0.3, 0.01))
    assert found.outcome == Outcome.CAUTION
    assert "slow motion below that cannot be told from light" in found.sentence
