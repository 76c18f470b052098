"""Cameras that hover by decimetres and degrees: poses, lens and places against the truth, on tracks without films."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulation import intrinsics, looking_at
from stated_tracks import stated_tracks
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.stages.camera_motion import follow_depths, remove_camera_motion
from vfm_sdm.stages.camera_motion.far import moves_far
from vfm_sdm.stages.camera_motion.poses import StaticView, find_poses, look_from
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.studies.synthetic.hovering import Hover

SIZE, FPS, FRAMES, NOISE_PX = (1920, 1080), 30.0, 240, 0.01
RIG = Rig.from_world(
    ("left", "right"),
    [
        Camera(intrinsics(3300.0, SIZE), SIZE, np.array([k1]), looking_at(center, np.array([0.0, 0.0, 20.0])))
        for center, k1 in ((np.zeros(3), -0.05), (np.array([6.0, -0.2, 1.0]), 0.03))
    ],
    metric=True,
)
MOVING = np.array([[0.0, 0.0, 20.0], [-1.2, 0.3, 20.2], [1.5, -0.2, 19.8]])
STATIC = np.array([[-2.4, 1.4, 16.0], [2.3, 1.2, 20.0], [-2.0, -1.4, 26.0], [2.2, -1.3, 20.5]])
"""Four at three depths: before, beside and behind what moves."""
COLLINEAR = np.array([[-2.0, 0.9, 20.0], [-0.7, 0.9, 20.0], [0.7, 0.9, 20.0], [2.0, 0.9, 20.0]])
MOTION_MM = np.array([3.0, 6.0, 2.0]) * np.sin(2 * np.pi * np.arange(FRAMES)[:, None] / FPS * [1.6, 2.3, 2.9])


def names(static=STATIC):
    return [*("quarter", "middle", "end"), *(f"static {k}" for k in range(len(static)))]


@cache
def poses(seed, still=()):
    """Rotations (T, 3, 3) and translations (T, 3) of each view; of a tripod, none."""
    found = {}
    for number, view in enumerate(RIG.names):
        turns, way = Hover(seed=2 * seed + number).motion(np.arange(FRAMES) / FPS)
        stays = 0.0 if view in still else 1.0
        found[view] = Rotation.from_rotvec(stays * turns).as_matrix(), stays * way
    return found


def hovering(seed=0, *, static=STATIC, noise_px=NOISE_PX, still=(), rig=RIG):
    """Tracks of cameras that hover, with white noise."""
    rng = np.random.default_rng(seed)
    places = np.repeat(np.vstack([MOVING, static])[None], FRAMES, axis=0)
    places[:, : len(MOVING)] += MOTION_MM[:, None] / 1e3
    tracks = {}
    for view, camera in zip(rig.names, rig.cameras, strict=True):
        R, s = poses(seed, still)[view]
        X = np.einsum("tij,tpj->tpi", R, places @ camera.rotation.T + camera.translation) + s[:, None]
        pixels = look_from(camera, X)
        noisy = pixels + rng.normal(0, noise_px, pixels.shape)
        tracks[view] = stated_tracks(noisy, max(noise_px, 1e-4), FPS, names=names(static), view=view)
    return tracks


def displacement(tracks, rig=RIG):
    return compute_displacement(follow_depths(align_views(tracks), rig), rig)


def errors_mm(tracks, rig=RIG):
    """Errors of the moving points about their mean (T, 3, 3), and what is stated [mm]."""
    found = displacement(tracks, rig).isel(point=slice(0, len(MOVING)))
    error = found["displacement"].values - MOTION_MM[:, None]
    return error - error.mean(axis=0), found["displacement_std"].values


def rms(values, axis=None):
    return np.sqrt(np.mean(np.square(values), axis=axis))


def test_poses_are_found_from_far_away_and_through_a_lens():
    camera = RIG.cameras[1]
    X = STATIC @ camera.rotation.T + camera.translation
    R = Rotation.from_rotvec(np.deg2rad([[0, 0, 0], [3, -20, 8], [0, 0, 35]])).as_matrix()
    s = np.array([[0.0, 0.0, 0.0], [2.0, -1.0, 1.5], [0.4, 0.1, -0.5]])
    pixels = look_from(camera, np.einsum("tij,pj->tpi", R, X) + s[:, None])
    found = find_poses(StaticView(camera, X, pixels, np.tile(1e8 * np.eye(2), (3, 4, 1, 1))))
    assert found.found.all()
    np.testing.assert_allclose(found.translation, s, atol=1e-4)
    np.testing.assert_allclose(found.rotation, R, atol=1e-5)


def test_the_covariance_of_a_pose_is_that_of_its_errors():
    camera = RIG.cameras[0]
    noise = np.random.default_rng(0).normal(0, NOISE_PX, (2000, 4, 2))
    weight = np.tile(np.eye(2) / NOISE_PX**2, (2000, 4, 1, 1))
    found = find_poses(StaticView(camera, STATIC, look_from(camera, STATIC) + noise, weight))
    stated = np.sqrt(np.einsum("taa->ta", found.covariance).mean(axis=0))
    # Of 2000 draws a standard deviation is known to 1.6 %.
    np.testing.assert_allclose(rms(found.rotation_vector, axis=0), stated[:3], rtol=0.06)
    np.testing.assert_allclose(rms(found.translation, axis=0), stated[3:], rtol=0.06)


def test_without_noise_what_is_left_is_nothing():
    found = remove_camera_motion(hovering(noise_px=0.0), RIG, names()[3:])
    for view, one in found.views.items():
        assert one.status == "followed"
        assert one.applied
        assert one.far
        assert one.rms_before_px > 40
        assert one.rms_after_px < 1e-3
        np.testing.assert_allclose(one.translation, poses(0)[view][1], atol=1e-4)
    error, _ = errors_mm(found.tracks)
    assert np.abs(error).max() < 1e-3  # 6 mm of motion


def test_depths_that_points_take_as_they_move_are_followed():
    tracks = remove_camera_motion(hovering(noise_px=0.0), RIG, names()[3:]).tracks
    without = compute_displacement(align_views(tracks), RIG).isel(point=slice(0, 3))["displacement"].values
    left = without - MOTION_MM[:, None]
    # 6 mm along the right camera's depth, seen from 0.3 m beside: some hundredths of a millimetre.
    assert rms(left - left.mean(axis=0)) > 20 * rms(errors_mm(tracks)[0])


@pytest.mark.parametrize("seed", range(2))
def test_errors_are_as_large_as_stated(seed):
    found = remove_camera_motion(hovering(seed), RIG, names()[3:])
    error, stated = errors_mm(found.tracks)
    assert (rms(error, axis=(0, 1))[:2] < 0.1).all()  # across the line of sight, of cameras that are 17 degrees apart
    ratio = rms(error, axis=(0, 1)) / rms(stated, axis=(0, 1))
    assert (ratio > 0.75).all()
    assert (ratio < 1.2).all()
    for one in found.views.values():
        assert one.rms_after_px < 0.15


def test_a_rig_that_is_wrong_is_corrected_by_the_cameras_own_motion():
    std = dict.fromkeys(CAMERA_PARAMETERS, 0.0) | {"log_focal": 0.01, "cx": 2.0, "cy": 2.0, "k1": 0.005}
    further = std | dict.fromkeys(("rx", "ry", "rz"), 0.002) | dict.fromkeys(("tx", "ty", "tz"), 0.02)
    every = np.array([*std.values(), *further.values()])
    wrong = RIG.perturbed(every * np.random.default_rng(3).uniform(-1.5, 1.5, 20))
    tracks = hovering(1)
    errors = []
    for rig in (wrong, replace(wrong, covariance=np.diag(every**2))):
        steady = remove_camera_motion(tracks, rig, names()[3:]).tracks
        of_rig = []
        for view, camera in zip(RIG.names, RIG.cameras, strict=True):
            true = camera.project(MOVING + MOTION_MM[:, None] / 1e3)
            left = steady[view]["position"].values[:, : len(MOVING)] - true
            stated = steady[view]["position_covariance"].values[:, : len(MOVING)]
            of_rig.append((rms(left - left.mean(axis=0)), np.sqrt(np.einsum("tpii->tp", stated).mean() / 2)))
        errors.append(np.mean(of_rig, axis=0))
    (taken_as_exact, _), (corrected, stated) = errors
    assert corrected < 0.016  # 0.01 px of noise, and as much of the pose
    assert 0.7 < corrected / stated < 1.2
    assert corrected < 0.8 * taken_as_exact


def test_one_camera_may_stand_still():
    found = remove_camera_motion(hovering(still=("left",)), RIG, names()[3:])
    assert [found.views[view].status for view in RIG.names] == ["still", "followed"]
    error, _ = errors_mm(found.tracks)
    assert (rms(error, axis=(0, 1))[:2] < 0.1).all()


def test_three_points_are_enough_but_nothing_checks_them():
    found = remove_camera_motion(hovering(), RIG, names()[3:6])
    for one in found.views.values():
        assert one.status == "followed by three static points"
        assert one.applied
        assert np.isnan(one.rms_after_px)
    assert rms(errors_mm(found.tracks)[0], axis=(0, 1))[0] < 0.3


def test_fewer_are_too_few():
    tracks = hovering()
    found = remove_camera_motion(tracks, RIG, names()[3:5])
    for view, one in found.views.items():
        assert one.status == "too few static points"
        assert not one.applied
        assert (found.tracks[view]["status"].values == Status.UNRELIABLE).all()
        np.testing.assert_array_equal(found.tracks[view]["position"].values, tracks[view]["position"].values)


def test_points_on_one_line_do_not_determine_the_pose():
    found = remove_camera_motion(hovering(static=COLLINEAR), RIG, names(COLLINEAR)[3:])
    for view, one in found.views.items():
        assert one.status == "static points do not determine the pose"
        assert not one.applied
        assert (found.tracks[view]["status"].values == Status.UNRELIABLE).all()


def test_a_static_point_that_moves_is_found_out():
    tracks = hovering()
    swing = 30 * np.sin(2 * np.pi * np.arange(FRAMES) / FPS * 0.4)
    for one in tracks.values():
        one["position"].values[:, 4] += swing[:, None]
    found = remove_camera_motion(tracks, RIG, names()[3:])
    for one in found.views.values():
        assert one.status in {"no gain", "followed"}
        assert one.rms_after_px > 5


def test_frames_that_show_too_few_static_points_are_lost():
    tracks = hovering()
    tracks["left"]["position"].values[50:60, 3:5] = np.nan
    tracks["left"]["status"].values[50:60, 3:5] = Status.OUTSIDE
    steady = remove_camera_motion(tracks, RIG, names()[3:]).tracks["left"]
    assert np.isnan(steady["position"].values[50:60, 0]).all()
    assert (steady["status"].values[50:60, 0] == Status.LOST).all()
    assert (steady["status"].values[50:60, 3:5] == Status.OUTSIDE).all()
    others = np.delete(np.arange(FRAMES), np.arange(50, 60))
    assert (steady["status"].values[others, 0] == Status.OK).all()


def test_a_later_part_goes_on_where_the_first_ended():
    tracks = hovering()
    whole = remove_camera_motion(tracks, RIG, names()[3:])
    rest = {view: one.places for view, one in whole.views.items()}
    later = {view: one.isel(time=slice(120, None)) for view, one in tracks.items()}
    part = remove_camera_motion(later, RIG, names()[3:], rest)
    for view in RIG.names:
        apart = part.tracks[view]["position"].values - whole.tracks[view]["position"].values[120:]
        assert part.views[view].status == "followed"
        assert rms(apart[:, :3]) < 0.01


def test_small_shifts_stay_with_the_linear_model():
    shifts = 17.0 * np.sin(np.arange(200) / 9)[:, None, None] * np.ones((200, 4, 2)) / np.sqrt(2)
    rest = np.zeros((4, 2))
    assert not moves_far(shifts, rest, 3300.0)  # 17 px: 0.044 px
    assert moves_far(2 * shifts, rest, 3300.0)
    assert not moves_far(np.full((200, 4, 2), np.nan), rest, 3300.0)


def test_one_static_point_that_slips_is_no_camera_that_moves_far():
    shifts = np.full((200, 4, 2), 1.0)
    shifts[50:, 2] = 40.0
    assert not moves_far(shifts, np.zeros((4, 2)), 3300.0)
    assert moves_far(40 * shifts, np.zeros((4, 2)), 3300.0)


def test_one_or_two_points_keep_the_linear_model_for_longer():
    shifts = np.full((200, 2, 2), 25.0)
    rest = np.zeros((2, 2))
    assert not moves_far(shifts, rest, 3300.0)  # 35 px: 0.19 px
    assert moves_far(2 * shifts, rest, 3300.0)
