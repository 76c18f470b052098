"""Parts of the steps that need no browser."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from vfm_sdm.page.steps.common import as_point, value_at
from vfm_sdm.page.steps.points import fill_polygon


def test_a_grid_fills_a_polygon_and_nothing_else():
    triangle = [(0.0, 0.0), (99.0, 0.0), (0.0, 99.0)]
    grid = np.array(fill_polygon(triangle, 10.0))
    assert (grid.sum(axis=1) < 99).all()
    assert (grid > 0).all()
    # A grid of that spacing holds one place in each 10 x 10 px of the triangle, but for its edge.
    assert len(grid) == pytest.approx(49, abs=6)


def test_values_are_found_by_names():
    fields = {"view": [{"name": "left", "lens": {"camera": "phone"}}]}
    assert value_at(fields, ("view", "left", "lens")) == {"camera": "phone"}
    assert value_at(fields, ("view", "right", "lens")) is None
    assert value_at({}, ("site", "baseline")) is None


def test_a_point_is_read_without_what_a_click_does_not_know():
    point = as_point({"name": "mid", "view": "left", "pixel": [1.0, 2.0], "static": True, "time_s": 3.0})
    assert point.pixel == (1.0, 2.0)
    assert point.static
    assert point.time_s is None
