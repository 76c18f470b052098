"""Points carried from one view to the other by a network that knows where they are."""

import numpy as np
import pytest

from vfm_sdm.networks.interface import ChunkTracks
from vfm_sdm.stages.matching.network import locate_points

FIRST, SECOND = (600, 960), (480, 640)
POINTS = np.array([[500.25, 300.5], [40.0, 20.0], [930.5, 580.75]])
TRUE = np.array([[311.5, 240.125], [20.25, 30.5], [600.0, 455.5]])


def ramps(shape, view):
    """Column in red, row in green (both of 0 .. 250 across the picture), the view in blue."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.stack([columns / (shape[1] - 1) * 250, rows / (shape[0] - 1) * 250, np.full(shape, view)], axis=2).astype(
        np.uint8
    )


class Oracle:
    """Reads off the grey values where it looks, and so knows the mapping of what it was given to the full images."""

    def __init__(self, *, hidden=(), rough_error=(0.0, 0.0)):
        self.hidden, self.rough_error, self.calls = hidden, np.array(rough_error), []

    def follow(self, frames, queries):
        self.calls.append((frames.shape, queries))
        places, seen = [], []
        for query in queries:
            here = _looked_up(frames[0], query, FIRST)
            index = int(np.argmin(np.linalg.norm(POINTS - here, axis=1)))
            off = self.rough_error if len(queries) > 1 else 0.0
            places.append(_found(frames[1], TRUE[index] + off, SECOND))
            seen.append(0.1 if index in self.hidden else 0.9)
        positions = np.stack([queries, np.array(places)])
        visibility = np.stack([np.ones(len(queries)), np.array(seen)])
        return ChunkTracks(positions, visibility, visibility)


def _slopes(picture, size):
    """Full-image pixels (u, v) of a picture, linear in its columns and rows, from its coloured part."""
    content = picture[..., 2] < 200
    rows, columns = np.flatnonzero(content.any(axis=1)), np.flatnonzero(content.any(axis=0))
    line_u = np.polyfit(columns, picture[rows[len(rows) // 2], columns, 0] / 250 * (size[1] - 1), 1)
    line_v = np.polyfit(rows, picture[rows, columns[len(columns) // 2], 1] / 250 * (size[0] - 1), 1)
    return line_u, line_v


def _looked_up(picture, place, size):
    return np.array([np.polyval(line, x) for line, x in zip(_slopes(picture, size), place, strict=True)])


def _found(picture, point, size):
    return np.array([(x - line[1]) / line[0] for line, x in zip(_slopes(picture, size), point, strict=True)])


@pytest.fixture(scope="module")
def views():
    return ramps(FIRST, 1), ramps(SECOND, 2)


def test_points_are_found_in_the_full_image(views):
    oracle = Oracle()
    found = locate_points(oracle, *views, POINTS)
    # Grey values have steps of 250 / 640 px, from which the oracle's lines are drawn.
    np.testing.assert_allclose(found, TRUE, atol=1.5)
    shapes = [shape for shape, _ in oracle.calls]
    assert shapes[0][:1] == (2,)
    assert set(shapes[1:]) == {(2, 294, 294, 3)}
    assert len(shapes) == 1 + len(POINTS)


def test_patches_mend_what_the_reduced_frames_are_off(views):
    found = locate_points(Oracle(rough_error=(25.0, -18.0)), *views, POINTS)
    np.testing.assert_allclose(found, TRUE, atol=1.5)


def test_hidden_points_are_not_made_up(views):
    found = locate_points(Oracle(hidden=(1,)), *views, POINTS)
    assert np.isnan(found[1]).all()
    assert np.isfinite(found[[0, 2]]).all()


def test_points_that_would_lie_outside_the_other_view_are_not_found(views):
    found = locate_points(Oracle(rough_error=(700.0, 0.0)), *views, POINTS)
    assert np.isnan(found).all()
