"""VGGT's pose vectors and cameras."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vfm_sdm.networks.vggt.pose import decode_pose, encode_pose

UNIT_QUATERNION = [0.0, 0.0, 0.0, 1.0]
numbers = st.floats(-2, 2, allow_subnormal=False)
quaternions = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: np.linalg.norm(q) > 1e-2)
pose_vectors = st.tuples(st.tuples(numbers, numbers, numbers), quaternions, st.tuples(*[st.floats(0.05, 3.0)] * 2))


@given(st.lists(pose_vectors, min_size=1, max_size=4))
def test_cameras_return_to_their_pose_vectors(parts):
    poses = np.array([[*translation, *quaternion, *fov] for translation, quaternion, fov in parts])
    cameras = decode_pose(poses, (518, 294))
    again = encode_pose(*cameras, (518, 294))
    length = np.linalg.norm(poses[:, 3:7], axis=1, keepdims=True)
    np.testing.assert_allclose(again[:, [0, 1, 2, 7, 8]], poses[:, [0, 1, 2, 7, 8]], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(again[:, 3:7] * poses[:, 3:7] / length, axis=1)), 1, atol=1e-9)
    assert (again[:, 6] >= 0).all()
    for camera, same_camera in zip(cameras, decode_pose(again, (518, 294)), strict=True):
        np.testing.assert_allclose(same_camera, camera, rtol=1e-9, atol=1e-7)


def test_camera_of_a_known_pose():
    quarter_about_z = [0, 0, 3.0, 3.0]
    poses = np.array([[1, 2, 3, *quarter_about_z, np.pi / 2, 2 * np.arctan(0.5)]])
    cam_from_world, intrinsics = decode_pose(poses, (600, 400))
    np.testing.assert_allclose(cam_from_world[0], [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], atol=1e-12)
    np.testing.assert_allclose(intrinsics[0], [[600, 0, 300], [0, 200, 200], [0, 0, 1]], atol=1e-9)


@pytest.mark.parametrize("fov", [0.0, -0.3, np.pi, 4.0, np.nan, np.inf])
@pytest.mark.parametrize("axis", ["vertical", "horizontal"])
def test_impossible_field_of_view_is_no_focal_length(fov, axis):
    fields = [fov, 1.0] if axis == "vertical" else [1.0, fov]
    cam_from_world, intrinsics = decode_pose(np.array([[0, 0, 1, *UNIT_QUATERNION, *fields]]), (600, 400))
    missing = (1, 1) if axis == "vertical" else (0, 0)
    assert np.isnan(intrinsics[0][missing])
    assert np.isnan(intrinsics).sum() == 1
    assert np.isfinite(cam_from_world).all()


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_impossible_quaternion_is_no_rotation(value):
    poses = np.array([[0, 0, 1, *UNIT_QUATERNION, 1, 1], [0, 0, 1, *[value] * 4, 1, 1]])
    cam_from_world, _ = decode_pose(poses, (600, 400))
    assert np.isfinite(cam_from_world[0]).all()
    assert np.isnan(cam_from_world[1, :, :3]).all()
