"""Edges in pictures whose true lines are known: where they lie, how well, and how far that is believed."""

import cv2
import numpy as np

from vfm_sdm.stages.matching.straight_edges import StraightEdges, find_straight_edges


def picture(angle_deg, *, noise=1.0, offset=0.0, bow=0.0, seed=0, size=(200, 260)):
    """Dark below a line through the middle, at an angle to the rows, with its parabola's bow over the width [px]."""
    height, width = size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x = u - (width - 1) / 2
    line = (height - 1) / 2 + offset + np.tan(np.radians(angle_deg)) * x + bow * (1 - (2 * x / width) ** 2)
    # A pixel that the line crosses is grey by the share below it; blurred as by a lens.
    share = np.clip(v - line + 0.5, 0, 1)
    luma = cv2.GaussianBlur(60 + 120 * share, (0, 0), 0.8)
    return np.clip(np.rint(luma + np.random.default_rng(seed).normal(0, noise, size)), 0, 255).astype(np.uint8)


def angle_of(edges: StraightEdges) -> float:
    along = edges.places[0, 2] - edges.places[0, 0]
    return float(np.degrees(np.arctan(along[1] / along[0])))


def test_direction_and_bow_are_within_what_is_stated_of_them():
    errors = []
    for seed, angle in enumerate(np.linspace(1, 21, 16)):
        bow = 0.3 * (-1) ** seed
        edges = find_straight_edges(picture(angle, bow=bow, noise=3.0, offset=0.1 * seed, seed=seed), 0)
        assert len(edges) == 1
        half = edges.length_px[0] / 2
        slope = np.radians(angle_of(edges) - angle) * half / edges.slope_std_px[0]
        a, b, c = edges.places[0]
        normal = np.array([-(c - a)[1], (c - a)[0]]) / (2 * half)
        normal = normal * np.sign(normal[1])
        # The parabola bows over the whole width; the edge is a part of it, seen at a right angle.
        share = (half * np.cos(np.radians(angle)) / 130) ** 2
        expected = bow * share * np.cos(np.radians(angle))
        errors.append((slope, ((b - (a + c) / 2) @ normal - expected) / edges.bow_std_px[0]))
        assert edges.slope_std_px[0] < 0.1
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 2.0)
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) > 0.3)


def test_noise_is_no_edge():
    luma = np.random.default_rng(0).normal(120, 8, (200, 260)).clip(0, 255).astype(np.uint8)
    assert len(find_straight_edges(luma, 0)) == 0


def test_a_picture_without_anything_has_no_edges():
    edges = find_straight_edges(np.full((100, 100), 90, dtype=np.uint8), 1)
    assert len(edges) == 0
    assert edges.view == 1
