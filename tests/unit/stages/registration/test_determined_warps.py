"""Round targets and what else determines less than an affine warp: found every time, and as well as stated."""

import numpy as np
import pytest
from scipy.special import erf

from moving_frames import NOISE, NaturalTexture, digitize, grid_points
from vfm_sdm.stages.registration.determined_warps import estimate_noise, invert_determined
from vfm_sdm.stages.registration.subsets import SubsetBank, SubsetDesign, Warp

MIDDLE, SIDE = np.array([40.0, 40.0]), 81


def draw_target(shift=(0.0, 0.0), half_axes=(9.0, 9.0)):
    """A dark ellipse on a plain ground, blurred by 0.9 px."""
    v, u = np.indices((SIDE, SIDE))
    x, y = u - MIDDLE[0] - shift[0], v - MIDDLE[1] - shift[1]
    radius = np.maximum(np.hypot(x / half_axes[0], y / half_axes[1]), 1e-9)
    return 230 - 107.5 * (1 - erf((1 - 1 / radius) * np.hypot(x, y) / (np.sqrt(2) * 0.9)))


@pytest.mark.parametrize("noise", [0.0, 1.0, 4.0])
@pytest.mark.parametrize(("half_axes", "subset_px"), [((9, 9), 21), ((9, 9), 41), ((9, 6), 21), ((12, 4), 31)])
@pytest.mark.parametrize("designed", [False, True])
def test_round_targets_are_found_every_time(noise, half_axes, subset_px, designed):
    rng = np.random.default_rng(1)
    designs = [SubsetDesign(subset_px)] if designed else None
    reference = digitize(draw_target(half_axes=half_axes), rng, noise)
    bank = SubsetBank.prepare(reference, MIDDLE[None], subset_px=subset_px, designs=designs)
    errors, squares = [], []
    for shift in rng.uniform(-0.5, 0.5, (40, 2)):
        found = bank.register(digitize(draw_target(shift, half_axes), rng, noise), MIDDLE[None])
        assert found.converged.all()
        errors.append(found.position[0] - MIDDLE - shift)
        squares.append(errors[-1] @ np.linalg.solve(found.covariance[0], errors[-1]) / 2)
    assert np.sqrt(np.mean(np.square(errors))) < 0.002 + 0.005 * noise
    assert np.mean(squares) < 1.5


def test_what_a_round_target_does_not_determine_is_uncertain_beside_its_middle():
    """Ten pixels beside it, an unseen turn, half the difference of two elements of 3e-4, moves the point."""
    rng = np.random.default_rng(2)
    frames = [digitize(draw_target(), rng, 0.2) for _ in range(2)]
    points = np.array([MIDDLE, MIDDLE + np.array([10.0, 0.0])])
    std = np.sqrt(SubsetBank.prepare(frames[0], points, subset_px=31).register(frames[1], points).covariance[:, 1, 1])
    assert np.sqrt(std[1] ** 2 - std[0] ** 2) == pytest.approx(10 * 3e-4 / np.sqrt(2), rel=0.1)


def test_turns_that_the_texture_shows_are_followed():
    """Holding what is undetermined must not hold what is seen: a turned square of texture, and strain of a disc."""
    rng = np.random.default_rng(3)
    texture = NaturalTexture(7, size=SIDE, cutoff=0.2)
    bank = SubsetBank.prepare(digitize(texture.image(), rng, NOISE), grid_points(SIDE, 8, 30), subset_px=31)
    assert (np.linalg.matrix_rank(bank.prepared[0][1].matrices[:, 0], rtol=1e-9) == 6).all()
    frames = [digitize(draw_target(half_axes=axes), rng, 1.0) for axes in ((9.0, 9.0), (9.27, 8.82))]
    disc = SubsetBank.prepare(frames[0], MIDDLE[None], subset_px=31)
    strained = disc.register(frames[1], MIDDLE[None])
    np.testing.assert_allclose(np.diag(strained.affine[0]), [1.03, 0.98], atol=0.003)


@pytest.mark.parametrize("warp", [Warp.SIMILARITY, Warp.AFFINE])
def test_only_what_is_allowed_is_left(warp):
    """A disc leaves of a similarity translation and scale."""
    rng = np.random.default_rng(4)
    bank = SubsetBank.prepare(digitize(draw_target(), rng, 1.0), MIDDLE[None], designs=[SubsetDesign(31, warp)])
    rank = np.linalg.matrix_rank(bank.prepared[0][1].matrices[0, 0], rtol=1e-9)
    assert rank == (3 if warp == Warp.SIMILARITY else 5)


def test_noise_is_not_mistaken_for_texture_nor_texture_for_noise():
    rng = np.random.default_rng(5)
    texture = NaturalTexture(6, size=SIDE, cutoff=0.25).image()
    for noise in (0.5, 3.0):
        image = texture + rng.normal(0, noise, texture.shape)
        assert np.sqrt(estimate_noise(image[None])[0]) == pytest.approx(noise, rel=0.2)
    assert estimate_noise(np.full((1, 40, 40), 90.0)).tolist() == [1 / 12]


def test_without_a_place_nothing_is_left():
    M = np.diag([0.0, 9.0, 9.0, 9.0, 9.0, 9.0])[None]
    inverse, fixed = invert_determined(M, np.eye(4)[None])
    assert not fixed.any()
    assert np.isfinite(inverse).all()


def test_between_views_nothing_is_held_and_an_edge_is_of_no_use():
    noise = np.random.default_rng(5).normal(0, 1, (SIDE, SIDE))
    columns = np.indices((SIDE, SIDE))[1]
    target, edge = (
        np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)
        for picture in (draw_target(), 120 + 60 * erf((columns - MIDDLE[0]) / 2))
    )
    in_time, between_views = (
        SubsetBank.prepare(target, MIDDLE[None], subset_px=41, moderate=moderate) for moderate in (True, False)
    )
    assert in_time.freedoms[0] < between_views.freedoms[0] == 6
    bare = np.tile(edge[:1], (SIDE, 1))
    assert not SubsetBank.prepare(bare, MIDDLE[None], subset_px=41, moderate=False).usable[0]
