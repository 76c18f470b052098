"""Number of false alarms: random matches are chance whatever pose fits them best, right ones are not."""

from dataclasses import replace

import numpy as np
import poselib
import pytest

from simulation import project_all, scene_points, simple_rig
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.stages.matching.consensus import assign_cells, find_consensus

SIZE = (1280, 720)


def errors_of(points_first, points_second, rig):
    return sampson_error(points_first, points_second, rig)


class TestFindConsensus:
    def test_random_matches_are_chance_in_all_draws(self):
        rig = simple_rig()
        width, height = size = rig.cameras[0].image_size
        camera = {"model": "PINHOLE", "width": width, "height": height}
        models = [camera | {"params": [c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2]]} for c in rig.cameras]
        for draw in range(200):
            rng = np.random.default_rng(draw)
            first, second = rng.uniform(0, size, (2, int(rng.integers(20, 200)), 2))
            options = {"max_epipolar_error": 2.0, "max_iterations": 300, "min_iterations": 300, "seed": draw}
            pose, _ = poselib.estimate_relative_pose(first, second, *models, options, {})
            best = posed(rig, np.column_stack([pose.R, pose.t]))
            error = errors_of(first, second, best)
            assert find_consensus(error, size).log_nfa > 0
            assert find_consensus(error, size, cells=assign_cells(first, size)).log_nfa > 0

    @pytest.mark.parametrize("with_cells", [False, True])
    def test_three_of_ten_right_are_meaningful(self, with_cells):
        rng = np.random.default_rng(0)
        rig = simple_rig()
        size = rig.cameras[0].image_size
        first, second = project_all(rig, scene_points(rng, 200)) + rng.normal(0, 0.5, (2, 200, 2))
        second[60:] = rng.uniform(0, size, (140, 2))
        error = errors_of(first, second, rig)
        found = find_consensus(error, size, cells=assign_cells(first, size) if with_cells else None)
        assert found.log_nfa < -5
        assert 0.8 < found.threshold_px < 4
        assert found.inliers[:60].mean() > 0.9
        assert found.inliers[60:].mean() < 0.05

    def test_a_wrong_pose_has_no_meaning_with_the_same_matches(self):
        rng = np.random.default_rng(1)
        rig = simple_rig()
        first, second = project_all(rig, scene_points(rng, 200))
        turned = rig.perturbed([*np.zeros(10), *np.zeros(4), np.radians(3), np.radians(-4), np.radians(5), 0, 0, 0])
        error = errors_of(first, second, turned)
        assert (
            find_consensus(
                error, rig.cameras[0].image_size, cells=assign_cells(first, rig.cameras[0].image_size)
            ).log_nfa
            > 0
        )

    def test_matches_of_one_cell_count_once(self):
        rng = np.random.default_rng(2)
        error = np.concatenate([rng.uniform(0, 0.5, 60), rng.uniform(0, 300, 100)])
        heaped = np.concatenate([np.repeat(np.arange(4), 15), 10 + np.arange(100)])
        assert find_consensus(error, SIZE).log_nfa < -30
        assert find_consensus(error, SIZE, cells=heaped).log_nfa > 0

    def test_matches_at_like_heights_are_no_agreement(self):
        # Errors as broad as a wall is high, near the lines of every level pair: many, and none nearer than others.
        rng = np.random.default_rng(3)
        broad = rng.normal(0, 25, 400)
        assert find_consensus(broad, SIZE).log_nfa > 0
        sharp = np.concatenate([broad, rng.normal(0, 0.4, 60)])
        assert find_consensus(sharp, SIZE).log_nfa < -5

    def test_all_right_is_the_clearest(self):
        rng = np.random.default_rng(4)
        found = find_consensus(rng.normal(0, 0.3, 100), SIZE)
        assert found.log_nfa < -50
        assert found.inliers.mean() > 0.9

    @pytest.mark.parametrize("error", [[], [0.1] * 5, [np.nan] * 30])
    def test_nothing_agrees_where_there_is_nothing(self, error):
        found = find_consensus(error, SIZE)
        assert (found.is_meaningful, found.threshold_px, found.inliers.any()) == (False, 0.0, False)

    def test_refuses_cells_of_other_matches(self):
        with pytest.raises(CameraError, match=r"consensus: expected one cell a match .* got 3 errors, 2 cells"):
            find_consensus([1.0, 2.0, 3.0], SIZE, cells=[0, 1])


def posed(rig, cam2_from_cam1):
    second = replace(rig.cameras[1], cam_from_world=cam2_from_cam1)
    return Rig(rig.names, (rig.cameras[0], second))
