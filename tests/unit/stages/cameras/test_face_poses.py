"""Poses that matches on a structure's face propose, on simulated girders seen through long lenses."""

from dataclasses import replace

import numpy as np
import pytest

from rooms import angle_between_deg
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.structure_frame import compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Level, Readings, Site
from vfm_sdm.stages.cameras.face_poses import propose_poses
from vfm_sdm.stages.cameras.face_votes import count_votes
from vfm_sdm.stages.cameras.relative_pose import count_places, number_cells
from vfm_sdm.stages.matching.face import Face
from vfm_sdm.stages.matching.matches import Matches

SIZE, FOCAL, BASELINE = (1280, 720), 7000.0, 4.0
ACROSS, ALONG = 9.0, 21.0
SITE = Site(
    perpendicular_distance={"value": ACROSS, "std": 0.02},
    longitudinal_distance={"value": ALONG, "std": 0.05},
    reference_camera_level={"pitch_deg": 2.0, "roll_deg": 0.5, "std_deg": 0.2},
)
AXES = structure_from_cam1(compute_view_angle(ACROSS, ALONG), pitch_rad=np.radians(2.0), roll_rad=np.radians(0.5))
LENS = Camera([[FOCAL, 0, 639.5], [0, FOCAL, 359.5], [0, 0, 1]], SIZE)


def second_camera(*, across=6.0, height=0.05, roll_deg=-0.4, pitch_deg=2.4):
    """A camera nearer to the face that looks at the middle of what the first one sees."""
    centre = np.array([ACROSS - across, height, -np.sqrt(BASELINE**2 - (ACROSS - across) ** 2 - height**2)])
    sight = np.array([ACROSS, 0.0, ALONG]) - centre
    turned = structure_from_cam1(
        np.arctan2(sight[0], sight[2]), pitch_rad=np.radians(pitch_deg), roll_rad=np.radians(roll_deg)
    )
    rotation = turned.T @ AXES
    return replace(LENS, cam_from_world=np.column_stack([rotation, -rotation @ AXES.T @ centre]))


def matches_on(rng, second, *, right, wrong, relief=0.05):
    """Matches on the face, in random order among wrong ones; and how many of them are right."""
    pixels = rng.uniform([20, 20], [1260, 700], (4000, 2))
    rays = np.column_stack([LENS.normalize(pixels), np.ones(len(pixels))]) @ AXES.T
    points = rays * ((ACROSS + rng.normal(0, relief, len(pixels))) / rays[:, 0])[:, None]
    seen = second.project(points @ AXES) + rng.normal(0, 0.5, pixels.shape)
    inside = ((seen > 0) & (seen < SIZE)).all(axis=1)
    pixels, seen = pixels[inside][: right + wrong], seen[inside][: right + wrong]
    # What repeats lies at its own height and anywhere along the structure.
    seen[right:, 0] = rng.uniform(0, 1280, wrong)
    order = rng.permutation(right + wrong)
    return Matches(0, 1, pixels[order], seen[order])


@pytest.mark.parametrize("across", [5.6, 7.5])
@pytest.mark.parametrize("seed", range(3))
def test_the_true_pose_stands_out_among_four_wrong_matches_of_five(across, seed):
    second = second_camera(across=across)
    matches = matches_on(np.random.default_rng(seed), second, right=50, wrong=200)
    best, *others = propose_poses(matches, (LENS, LENS), Face.of(SITE), BASELINE, Readings())
    assert angle_between_deg(best.camera.rotation, second.rotation) < 1.5
    assert np.linalg.norm(best.camera.center - second.center) < 0.6
    assert best.matches.on_face.all()
    assert all(best.support > 1.5 * other.support for other in others)


def test_votes_are_places_of_matches_that_a_pose_explains():
    second = second_camera()
    matches = matches_on(np.random.default_rng(2), second, right=80, wrong=0, relief=0.0)
    face = Face.of(SITE)
    centre = AXES @ second.center
    near, far = (face.points(LENS, matches.points_first, beyond) - centre for beyond in (0.0, 0.1))
    rotations = np.stack([AXES @ second.rotation.T, AXES @ second.rotation.T @ np.diag([-1.0, -1.0, 1.0])])
    cells = number_cells(matches, (LENS, LENS))
    places = np.zeros(2, np.int64)
    count_votes(rotations, (near, far, LENS.normalize(matches.points_second)), (FOCAL, 6.0), cells, places)
    assert places[0] == count_places(np.ones((1, 80), np.bool_), matches, (LENS, LENS))[0]
    assert places[1] < places[0] / 4


def test_without_a_right_match_no_pose_stands_out():
    matches = matches_on(np.random.default_rng(5), second_camera(), right=0, wrong=250)
    best, *others = propose_poses(matches, (LENS, LENS), Face.of(SITE), BASELINE, Readings())
    assert others
    assert best.support < 1.5 * others[0].support + 3


def test_readings_exclude_directions():
    second = second_camera()
    matches = matches_on(np.random.default_rng(0), second, right=50, wrong=200)
    read = Readings(perpendicular_distance={"value": 8.9, "std": 0.02}, level=Level(std_deg=0.2, pitch_deg=2.4))
    proposals = propose_poses(matches, (LENS, LENS), Face.of(SITE), BASELINE, read)
    assert all(abs(ACROSS - (AXES @ p.camera.center)[0] - 8.9) < 1.0 for p in proposals)
    left = propose_poses(matches, (LENS, LENS), Face.of(SITE), BASELINE, Readings(stands="left"))
    assert all(p.camera.center[0] < 0.5 for p in left)


def test_without_distances_there_is_no_face():
    assert Face.of(Site(baseline={"value": 4.0, "std": 0.01})) is None


def test_no_match_on_the_face_is_no_proposal():
    nothing = Matches(0, 1, np.empty((0, 2)), np.empty((0, 2)))
    assert propose_poses(nothing, (LENS, LENS), Face.of(SITE), BASELINE, Readings()) == []
