"""Matches guided by a map, and those that their surroundings contradict."""

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from vfm_sdm.stages.matching.detection import detect_features
from vfm_sdm.stages.matching.surface_matches import match_through
from vfm_sdm.stages.matching.smooth import agree_smoothly


def textured(seed, shape=(300, 420)):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 2)
    return np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)


def test_a_pattern_that_repeats_farther_off_is_no_rival():
    tile = textured(0, (240, 80))
    first = np.tile(tile, (1, 5))
    second = np.rint(shift(first.astype(float), (0, 6), order=3, mode="grid-wrap")).clip(0, 255).astype(np.uint8)
    points, seen = match_through(detect_features(first), (first, second), lambda p: p, (20.0, 6.0))
    assert len(points) > 50
    np.testing.assert_allclose(np.median(seen - points, axis=0), [6, 0], atol=0.2)
    assert (np.abs(seen - points - [6, 0]).max(axis=1) < 2).mean() > 0.95


def test_a_map_that_leads_nowhere_matches_nothing():
    image = textured(1)
    points, seen = match_through(detect_features(image), (image, image), lambda p: np.full_like(p, np.nan), (9.0, 9.0))
    assert points.shape == seen.shape == (0, 2)


def test_a_flat_picture_matches_nothing():
    flat = np.full((200, 300), 90, np.uint8)
    points, _ = match_through(detect_features(flat), (flat, flat), lambda p: p, (9.0, 9.0))
    assert len(points) == 0


def test_what_follows_a_smooth_map_agrees_and_the_rest_does_not():
    rng = np.random.default_rng(2)
    pixels = rng.uniform(0, 1000, (200, 2))
    offsets = np.column_stack([0.01 * pixels[:, 0] + 3e-6 * pixels[:, 1] ** 2, -0.004 * pixels[:, 1]])
    offsets += rng.normal(0, 0.2, offsets.shape)
    offsets[:120] += rng.uniform(3, 20, (120, 2)) * rng.choice([-1, 1], (120, 2))
    agree = agree_smoothly(pixels, offsets)
    assert agree[120:].mean() > 0.9
    assert agree[:120].mean() < 0.1


def test_too_few_agree_with_nothing():
    assert not agree_smoothly(np.zeros((5, 2)), np.zeros((5, 2))).any()
