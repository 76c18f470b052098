"""Feature matches along epipolar lines: a textured plate at a known distance before two cameras side by side."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.detection import add_stretched, detect_features
from vfm_sdm.stages.matching.features import match_detected
from vfm_sdm.stages.matching.guided import match_guided

SHIFT, FOCAL_PX, BASELINE_M = 40, 800.0, 2.0
DEPTH_M = FOCAL_PX * BASELINE_M / SHIFT


def textured(rng, shape):
    noise = gaussian_filter(rng.normal(size=shape), 2)
    return 128 + 40 * noise / noise.std()


def seen_twice(plate, rng, noise=6.0):
    """Features of a plate as both cameras see it: the second has everything further left."""
    images = [
        np.clip(part + rng.normal(0, noise, part.shape), 0, 255) for part in (plate[:, :-SHIFT], plate[:, SHIFT:])
    ]
    return [detect_features(np.rint(image).astype(np.uint8)) for image in images]


def make_rig(shape, covariance=None):
    height, width = shape
    K = np.array([[FOCAL_PX, 0, (width - 1) / 2], [0, FOCAL_PX, (height - 1) / 2], [0, 0, 1.0]])
    second = np.array([[1.0, 0, 0, -BASELINE_M], [0, 1, 0, 0], [0, 0, 1, 0]])
    cameras = Camera(K, (width, height)), Camera(K, (width, height), cam_from_world=second)
    return Rig(("left", "right"), cameras, True, covariance)


def is_right(matches):
    return np.abs(matches.points_second - matches.points_first + [SHIFT, 0]).max(axis=1) < 2


class TestMatchGuided:
    def test_known_cameras_find_more_right_matches(self):
        rng = np.random.default_rng(0)
        features = seen_twice(textured(rng, (240, 360)), rng, noise=25.0)
        free, guided = match_detected(*features), match_guided(*features, make_rig((240, 320)))
        assert is_right(guided).sum() > 1.15 * is_right(free).sum()
        assert is_right(guided).mean() > 0.8
        assert (np.diff(guided.quality) <= 0).all()

    def test_rows_that_repeat_are_told_apart_by_their_lines(self):
        rng = np.random.default_rng(1)
        features = seen_twice(np.vstack([textured(rng, (60, 360))] * 4), rng)
        assert (
            is_right(match_guided(*features, make_rig((240, 320)))).sum()
            > 5 * is_right(match_detected(*features)).sum()
        )

    def test_what_repeats_along_the_line_is_not_matched_unless_the_depth_tells(self):
        rng = np.random.default_rng(2)
        features = seen_twice(np.hstack([textured(rng, (240, 60))] * 6), rng)
        rig = make_rig((240, 320))
        open_depth = match_guided(*features, rig)
        known_depth = match_guided(*features, rig, depths=(0.8 * DEPTH_M, 1.2 * DEPTH_M))
        assert is_right(known_depth).mean() > 0.9
        assert is_right(known_depth).sum() > 200
        clear_open, clear_known = ((one.quality > 0.4).sum() for one in (open_depth, known_depth))
        assert clear_open < 0.2 * clear_known

    def test_the_band_is_as_wide_as_the_cameras_are_uncertain(self):
        rng = np.random.default_rng(3)
        features = seen_twice(textured(rng, (240, 360)), rng)
        covariance = np.zeros((20, 20))
        covariance[14, 14] = np.radians(1.0) ** 2
        step = np.zeros(20)
        step[14] = np.radians(1.0)  # pitch of the second camera, 14 px
        tilted = make_rig((240, 320)).perturbed(step)
        exact = match_guided(*features, tilted)
        honest = match_guided(*features, Rig(tilted.names, tilted.cameras, True, covariance))
        assert is_right(honest).sum() > 300
        assert is_right(exact).sum() < 0.02 * is_right(honest).sum()

    def test_views_in_the_other_order_agree(self):
        rng = np.random.default_rng(4)
        first, second = seen_twice(textured(rng, (240, 360)), rng)
        rig = make_rig((240, 320))
        there, back = match_guided(first, second, rig), match_guided(second, first, rig, views=(1, 0))
        pairs = {(*u, *v) for u, v in zip(there.points_first, there.points_second, strict=True)}
        swapped = {(*v, *u) for u, v in zip(back.points_first, back.points_second, strict=True)}
        assert len(pairs & swapped) > 0.9 * len(pairs)

    @pytest.mark.parametrize("empty", [0, 1])
    def test_no_features_give_no_matches(self, empty):
        rng = np.random.default_rng(5)
        features = seen_twice(textured(rng, (240, 360)), rng)
        flat = np.full((240, 320), 90, np.uint8)
        features[empty] = add_stretched(detect_features(flat), flat)
        assert len(match_guided(*features, make_rig((240, 320)))) == 0
