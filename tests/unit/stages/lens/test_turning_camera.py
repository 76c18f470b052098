"""The model of a turning camera, and its derivatives, against differences."""

from dataclasses import replace

import numpy as np
import pytest

from turning import draw_lever, draw_plan, look
from vfm_sdm.stages.lens.nearness import PointSums, taken_by_points, volume_of_points
from vfm_sdm.stages.lens.turning_camera import LENS, tangents


@pytest.fixture(scope="module")
def scene():
    plan = draw_plan(0, 40, distance_m=(12.0, 60.0), lever_m=draw_lever(0, 0.3), readout_s=0.03)
    camera, clip = look(plan, frames=8, points=120)
    rng = np.random.default_rng(1)
    shared = np.array([*plan.lever_m, 0.04, 0.02])
    nearness, growth = rng.normal(0, 0.01, len(camera.nearness)), rng.normal(0, 1e-3, len(camera.nearness))
    return replace(camera, shared=shared, nearness=nearness, growth=growth), clip


@pytest.mark.parametrize("index", range(len(LENS)))
def test_derivatives_by_the_lens_are_those_of_the_pixels(scene, index):
    camera, clip = scene
    by_lens, _, _ = camera.derivatives(clip.seen)
    step = np.eye(len(LENS))[index] * [1e-5, 0.01, 0.01, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-4, 1e-4][index]
    still = np.zeros((clip.seen.frames, 3)), np.zeros((len(camera.nearness), 4))
    ends = [camera.moved(sign * step, *still).residuals(clip.seen) for sign in (-1, 1)]
    found = (ends[0] - ends[1]) / (2 * step[index])
    np.testing.assert_allclose(by_lens[:, :, index], found, rtol=2e-3, atol=2e-3 * np.abs(found).max())


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_the_turns_are_those_of_the_pixels(scene, axis):
    camera, clip = scene
    _, by_turn, _ = camera.derivatives(clip.seen)
    turns = np.tile(np.eye(3)[axis] * 1e-5, (clip.seen.frames, 1))
    still = np.zeros((len(camera.nearness), 4))
    ends = [camera.moved(np.zeros(len(LENS)), sign * turns, still).residuals(clip.seen) for sign in (-1, 1)]
    found = (ends[0] - ends[1]) / 2e-5
    # The turn within a frame is left out of these: a hundredth of a radian.
    np.testing.assert_allclose(by_turn[:, :, axis], found, atol=0.02 * np.abs(found).max())


@pytest.mark.parametrize("value", range(4))
def test_derivatives_by_the_points_are_those_of_the_pixels(scene, value):
    camera, clip = scene
    _, _, by_point = camera.derivatives(clip.seen)
    reach = [1e-5, 1e-5, 1e-4, 1e-5][value]
    points = np.tile(np.eye(4)[value] * reach, (len(camera.nearness), 1))
    still = np.zeros(len(LENS)), np.zeros((clip.seen.frames, 3))
    ends = [camera.moved(*still, sign * points).residuals(clip.seen) for sign in (-1, 1)]
    found = (ends[0] - ends[1]) / (2 * reach)
    np.testing.assert_allclose(by_point[:, :, value], found, atol=0.02 * np.abs(found).max())


def test_tangents_are_unit_vectors_across():
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    frames = np.concatenate([directions[:, :, None], tangents(directions)], axis=2)
    np.testing.assert_allclose(frames.swapaxes(1, 2) @ frames, np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)


def test_mirrored_scene_looks_the_same(scene):
    camera, clip = scene
    np.testing.assert_allclose(camera.mirrored().residuals(clip.seen), camera.residuals(clip.seen), atol=1e-9)


def test_sums_over_points():
    np.testing.assert_array_equal(PointSums(np.array([0, 0, 1, 2, 2]))(np.arange(5.0)), [1, 2, 7])


def test_volume_of_the_deviations_grows_with_the_lever_and_its_precision_is_its_slope(scene):
    camera, clip = scene
    weights = np.full(len(clip.seen), 16.0)

    def volume(share):
        moved = replace(camera, shared=camera.shared * [share, share, share, 1, 1])
        return volume_of_points(moved, clip, weights).log(moved)

    assert 0 == volume(0.0) < volume(0.5) < volume(1.0)
    # d/dshare of the volume at 1 is lever' precision lever, but for the few that the rays change.
    slope = (volume(1.001) - volume(0.999)) / 0.002
    here = volume_of_points(camera, clip, weights)
    assert slope == pytest.approx(camera.lever @ here.lever_precision(camera) @ camera.lever, rel=0.02)


def test_volume_is_a_straight_line_in_all_but_the_lever(scene):
    camera, clip = scene
    slope = np.arange(1.0, len(LENS) + 1) * (np.arange(len(LENS)) < 5)
    volume = volume_of_points(camera, clip, np.full(len(clip.seen), 16.0), slope=slope)
    step = np.eye(len(LENS))[1] * 0.5
    moved = camera.moved(step, np.zeros((clip.seen.frames, 3)), np.zeros((len(camera.nearness), 4)))
    assert volume.log(moved) - volume.log(camera) == pytest.approx(slope[1] * 0.5, rel=1e-6)


def test_points_take_two_to_four_values(scene):
    camera, clip = scene
    taken = taken_by_points(camera, clip, np.full(len(clip.seen), 16.0))
    assert taken.min() > 2
    assert taken.max() < 4
    alone = replace(camera, shared=camera.shared * [0, 0, 0, 1, 1])
    narrow = replace(clip, growth_std=1e-9)
    np.testing.assert_allclose(taken_by_points(alone, narrow, np.full(len(clip.seen), 16.0)), 2, atol=1e-4)
