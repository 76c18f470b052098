"""Points suggested by what they should measure: places, motion, face, choice, and their faults by name."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from simulation import intrinsics, looking_at
from vfm_sdm.errors import CameraError, DatasetError, SessionError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session
from vfm_sdm.inputs.video import open_images
from vfm_sdm.measurement import measure
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.points import named_points
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.studies.planning.candidates import find_textured
from vfm_sdm.studies.planning.choosing import choose_spread_along, choose_spread_out, judge_motion
from vfm_sdm.studies.planning.face_of_matches import know_face_of_session
from vfm_sdm.studies.planning.suggestion import suggest_points
from vfm_sdm.studies.planning.trial_tracks import FrameRow, Tried, choose_row, try_candidates

SIZE = (640, 480)
NOISE_PX = 0.01


def texture(rng, height, width):
    return np.clip(128 + 200 * gaussian_filter(rng.normal(0, 1, (height, width)), 1.5), 0, 255)


def write_pictures(folder, pictures):
    folder.mkdir()
    for number, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / f"{number:03d}.png"), np.clip(np.rint(picture), 0, 255).astype(np.uint8))


def session(**changes):
    fields = {
        "name": "bridge",
        "view": [{"name": name, "images": f"{name}/*.png", "fps": 30.0} for name in ("left", "right")],
        "site": {"baseline": {"value": 3.6, "std": 0.01}},
    }
    return Session(**(fields | changes))


# Textured places.


def test_textured_places_leave_edges_plain_surfaces_borders_and_taken_places():
    picture = np.full((300, 500), 100.0)
    picture[:, 250:] = 180.0  # an edge, which shows one direction only
    rng = np.random.default_rng(0)
    picture[40:120, 40:120] = texture(rng, 80, 80)
    picture[180:260, 380:460] = texture(rng, 80, 80)
    luma = picture.astype(np.uint8)
    pixels, strength = find_textured(luma, subset_px=41, grid=(10, 6))
    left = (np.abs(pixels - 80) <= 60).all(axis=1)
    right = (np.abs(pixels - [420, 220]) <= 60).all(axis=1)
    assert left.any()
    assert right.any()
    assert (left | right).all()
    assert (np.diff(strength) <= 0).all()
    assert (np.abs(pixels[:, None] - pixels).max(axis=2)[~np.eye(len(pixels), dtype=bool)] > 20).all()
    others, _ = find_textured(luma, subset_px=41, grid=(10, 6), avoid=np.array([[80.0, 80.0], [np.nan, np.nan]]))
    assert (np.abs(others - [80, 80]).max(axis=1) > 41).all()
    assert len(others) > 0


# Motion in trial tracks.


def tried(motion, noise_px=NOISE_PX, seed=0):
    """Trial tracks (T, P, 2) of a motion with white noise."""
    moved = motion + np.random.default_rng(seed).normal(0, noise_px, motion.shape)
    moved = moved - np.median(moved, axis=0)
    count = motion.shape[1]
    return Tried(
        np.ones(count),
        np.tile(noise_px**2 * np.eye(2), (count, 1, 1)),
        True,
        moved,
        np.zeros(count),
        np.arange(len(moved)) / 30,
    )


def vertical(*amplitudes):
    """Vertical motion of these amplitudes [px], shape (120, P, 2)."""
    wave = np.sin(np.arange(120) / 7)
    return np.stack([np.zeros((120, len(amplitudes))), wave[:, None] * np.array(amplitudes)], axis=2)


ON_FACE = np.array([True, True, True, True, False, False, False])


def test_motion_tells_structure_from_background():
    found = judge_motion(
        [tried(vertical(1.0, 0.8, 0.1, 0, 0, 0, 0.3)), tried(vertical(0.5, 0.4, 0.05, 0, 0, 0, 0))], ON_FACE
    )
    assert found.tells
    assert found.with_structure.tolist() == [True, True, False, False, False, False, True]
    assert found.still.tolist() == [False, False, False, True, True, True, False]
    assert found.moved_px[:2] == pytest.approx(np.array([1.0, 0.8]) / np.sqrt(2), rel=0.05)


def test_motion_of_the_camera_is_no_motion_of_the_background():
    shaken = vertical(1.0, 0.8, 0.9, 0, 0, 0, 0) + 3 * np.cos(np.arange(120) / 3)[:, None, None]
    found = judge_motion([tried(shaken)], ON_FACE)
    assert found.tells
    assert found.still.tolist() == [False, False, False, True, True, True, True]
    assert found.moved_px[0] == pytest.approx(1 / np.sqrt(2), rel=0.1)


def test_motion_within_noise_tells_nothing():
    found = judge_motion([tried(vertical(0.01, 0.01, 0.01, 0, 0, 0, 0))], ON_FACE)
    assert not found.tells
    assert not judge_motion([tried(vertical(1, 1, 1, 1, 1, 0, 1))], ON_FACE).tells  # the background moves as much


def test_trial_tracks_state_noise_and_motion(tmp_path):
    rng = np.random.default_rng(1)
    structure, wall = texture(rng, 150, 150), texture(rng, 150, 150)
    frames = []
    for number in range(110):
        moved = shift(structure, (0.5 * np.sin(number / 4), 0), mode="reflect", order=3)
        frames.append(np.hstack([moved, wall]) + rng.normal(0, 2, (150, 300)))
    write_pictures(tmp_path / "left", frames)
    video = open_images(str(tmp_path / "left" / "*.png"), fps=30)
    pixels = np.array([[75.0, 75.0], [225.0, 75.0], [np.nan, np.nan]])
    found = try_candidates(video, pixels, IcgnTracker(threads=1))
    assert found.scattered
    assert found.followed.tolist() == [1.0, 1.0, 0.0]
    assert np.isnan(found.moved[:, 2]).all()
    assert np.nanstd(found.moved[:, 0, 1]) == pytest.approx(0.5 / np.sqrt(2), rel=0.1)
    scatter = found.moved[1:, 1].std(axis=0)
    assert found.std_px()[1] == pytest.approx(scatter.max(), rel=0.5)
    assert np.isinf(found.std_px()[2])
    quick = try_candidates(video, pixels, IcgnTracker(threads=1), row=FrameRow(count=1))
    assert 15 <= len(quick.moved) <= 22
    assert not quick.scattered
    late = try_candidates(video, pixels, IcgnTracker(threads=1), row=FrameRow(start=20, count=90))
    assert late.time_s[:2] == pytest.approx([0, 20 / 30])
    assert late.scattered


def test_the_row_is_where_the_motion_is(tmp_path):
    write_pictures(tmp_path / "left", [np.full((20, 20), 90.0)] * 300)
    video = open_images(str(tmp_path / "left" / "*.png"), fps=30)
    times = np.linspace(0, 299 / 30, 21)
    moved = np.where((times > 4)[:, None, None], 1.0, 0.0) * np.ones((21, 2, 2))
    looked = Tried(np.ones(2), np.zeros((2, 2, 2)), False, moved, np.zeros(2), times)
    assert 110 < choose_row(video, looked, np.array([True, False])).start <= 204
    assert choose_row(video, looked, np.zeros(2, dtype=bool)).start == 0


# The face.


def rig_and_matches(rng, *, plane, wall):
    """Cameras, and matches of points on a vertical plane across z = 10 + 0.3 x and on a wall behind."""
    right = Camera(
        intrinsics(1500.0, SIZE), SIZE, cam_from_world=looking_at(np.array([3.6, 0, 0]), np.array([1, 0, 10]))
    )
    rig = Rig(("left", "right"), (Camera(intrinsics(1500.0, SIZE), SIZE), right), metric=True)
    across, high = rng.uniform(-1.5, 1.5, plane + wall), rng.uniform(-1.2, 1.2, plane + wall)
    depth = np.where(np.arange(plane + wall) < plane, 10 + 0.3 * across, 14.0 + rng.uniform(-1, 1, plane + wall))
    points3d = np.column_stack([across, high, depth])
    pixels = [camera.project(points3d) + rng.normal(0, 0.2, (plane + wall, 2)) for camera in rig.cameras]
    return rig, Matches(0, 1, *pixels)


def solved(measured, rig):
    return CameraSolution(rig, None, None, named_points(measured, ["left", "right"]))


def test_the_face_is_found_where_nobody_measured_it():
    rig, matches = rig_and_matches(np.random.default_rng(2), plane=120, wall=60)
    found = know_face_of_session(session(), solved(session(), rig), [matches])
    normal = np.array([-0.3, 0.0, 1.0]) / np.hypot(1, 0.3)
    assert found.distance_m == pytest.approx(10 / np.hypot(1, 0.3), rel=0.01)
    assert np.degrees(np.arccos(found.frame.rotation[0] @ normal)) < 1
    assert np.abs(found.off_face(np.array([[0.0, 0.0, 10.0], [1.0, 0.5, 10.3]]))).max() < 0.15
    # The session that is looked through states the same plane.
    again = know_face_of_session(found.session, solved(session(), rig), [matches])
    assert np.degrees(np.arccos(np.clip(again.frame.rotation[0] @ found.frame.rotation[0], -1, 1))) < 0.1
    assert "the face was not measured" in found.notes[0]
    assert "level" in found.notes[0]


def test_no_face_is_named():
    rig, matches = rig_and_matches(np.random.default_rng(3), plane=3, wall=0)
    with pytest.raises(DatasetError, match=r"expected 12 matches between the views to find the face, got 3"):
        know_face_of_session(session(), solved(session(), rig), [matches])
    with pytest.raises(DatasetError, match="expected cameras, got none"):
        know_face_of_session(session(), CameraSolution(None, None, None, named_points(session(), ["left"])), [])


# The choice.


def test_the_choice_is_spread_and_takes_the_best():
    along = np.arange(12.0)
    cost = np.where(np.arange(12) % 3 == 1, 1.0, 2.0)
    usable = np.ones(12, dtype=bool)
    assert choose_spread_along(along, cost, usable, 4) == [1, 4, 7, 10]
    usable[4] = False
    assert choose_spread_along(along, cost, usable, 4)[1] in (3, 5)
    assert choose_spread_along(along, cost, np.zeros(12, dtype=bool), 4) == []
    assert choose_spread_along(along, cost, usable, 99) == [row for row in range(12) if row != 4]
    assert choose_spread_out(np.zeros((12, 2)), cost, usable, 0) == []


# Faults.


def test_faults_are_named(tmp_path):
    one = session(view=[{"name": "left", "images": "left/*.png", "fps": 30.0}], folder=tmp_path)
    with pytest.raises(SessionError, match="expected two views or more, got 1"):
        suggest_points(one)
    for numbers in ({"count": 0}, {"static": -1}):
        with pytest.raises(SessionError, match="expected a count >= 1 and static >= 0"):
            suggest_points(session(), **numbers)
    for view in ("left", "right"):
        write_pictures(tmp_path / view, [np.full(SIZE[::-1], 100.0)] * 2)
    with pytest.raises(CameraError, match="points suggest: expected cameras from the first frames, got none"):
        suggest_points(session(folder=tmp_path))
    with pytest.raises(SessionError, match="point: expected at least 1, got 0"):
        measure(session(folder=tmp_path))
