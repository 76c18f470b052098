import numpy as np
import pytest

from simulation import placed_cameras
from vfm_sdm.stages.cameras.shared_points import SharedPoints, chain_matches
from vfm_sdm.stages.matching.matches import Matches

PIXELS = np.random.default_rng(0).uniform(0, 1000, (4, 10, 2))


def match(first, second, chosen):
    return Matches(first, second, PIXELS[first, chosen], PIXELS[second, chosen])


def test_one_pair_stays_as_it_is():
    pair = match(0, 1, slice(None))
    pairs, shared = chain_matches([pair])
    assert pairs == [pair]
    assert shared == []


def test_features_of_two_pairs_are_points_of_three_views():
    pairs, shared = chain_matches([match(0, 1, slice(0, 6)), match(0, 2, slice(4, 10))])
    assert [len(m.points_first) for m in pairs] == [4, 4]
    np.testing.assert_array_equal(pairs[0].points_second, PIXELS[1, :4])
    (points,) = shared
    assert points.views == (0, 1, 2)
    assert points.constraints == 3
    order = np.argsort(points.pixels[0, :, 0])
    expected = PIXELS[:3, 4:6][:, np.argsort(PIXELS[0, 4:6, 0])]
    np.testing.assert_array_equal(points.pixels[:, order], expected)


def test_a_pair_that_closes_a_triangle_counts_once():
    three = [match(0, 1, [0, 1]), match(0, 2, [0, 1]), match(1, 2, [0, 1])]
    pairs, shared = chain_matches(three)
    assert [len(m.points_first) for m in pairs] == [0, 0, 0]
    assert [points.pixels.shape for points in shared] == [(3, 2, 2)]


def test_chains_go_on_through_any_view():
    pairs, shared = chain_matches([match(0, 1, [0]), match(1, 2, [0, 1]), match(2, 3, [0, 1])])
    assert [points.views for points in shared] == [(0, 1, 2, 3), (1, 2, 3)]
    assert sum(len(m.points_first) for m in pairs) == 0


def test_a_chain_that_contradicts_itself_stays_pairs():
    wrong = Matches(1, 2, PIXELS[1, [0]], PIXELS[2, [7]])
    pairs, shared = chain_matches([match(0, 1, [0]), match(0, 2, [0]), wrong])
    assert shared == []
    assert [len(m.points_first) for m in pairs] == [1, 1, 1]


@pytest.mark.parametrize("views", [3, 4])
def test_errors_have_the_size_of_pixel_noise(views):
    centers = [(2.0 * k, 0.3 * k, -0.5 * k) for k in range(views)]
    placed = placed_cameras(centers, shared_error_px=0.0)
    points = SharedPoints(tuple(range(views)), placed.pixels)
    squares = np.sum(points.errors(placed.truth) ** 2, axis=1)
    assert np.sqrt(squares.mean() / points.constraints) == pytest.approx(0.35, rel=0.05)
