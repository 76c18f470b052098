import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simulation import project_all, scene_points, simple_rig
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import compute_reprojection_error, in_front_of_all, sampson_error, triangulate


@pytest.mark.parametrize("views", [2, 3, 5])
@pytest.mark.parametrize("distortion", [False, True])
def test_noise_free_points_come_back_exactly(views, distortion):
    rig = simple_rig(views, distortion=distortion)
    X = scene_points(np.random.default_rng(0), 50)
    np.testing.assert_allclose(triangulate(project_all(rig, X), rig), X, atol=1e-8)


def test_equals_opencv_on_noisy_pixels():
    rng = np.random.default_rng(1)
    rig = simple_rig()
    u = project_all(rig, scene_points(rng, 100)) + rng.normal(0, 0.5, (2, 100, 2))
    P = [c.K @ c.cam_from_world for c in rig.cameras]
    expected = cv2.triangulatePoints(P[0], P[1], u[0].T, u[1].T)
    np.testing.assert_allclose(triangulate(u, rig), (expected[:3] / expected[3]).T, rtol=1e-6)


def test_leading_axes_are_kept():
    rig = simple_rig()
    X = scene_points(np.random.default_rng(2), 24).reshape(4, 6, 3)
    np.testing.assert_allclose(triangulate(project_all(rig, X), rig), X, atol=1e-8)


def test_missing_pixel_is_a_missing_point():
    rig = simple_rig()
    u = project_all(rig, scene_points(np.random.default_rng(3), 3))
    u[1, 1, 0] = np.nan
    assert np.isnan(triangulate(u, rig)).all(axis=1).tolist() == [False, True, False]


@pytest.mark.parametrize("distortion", [False, True])
def test_a_point_comes_from_the_views_that_see_it(distortion):
    """As if the others were not there, whichever they are and whatever other points do."""
    rig = simple_rig(4, distortion=distortion)
    rng = np.random.default_rng(9)
    u = project_all(rig, scene_points(rng, 16)) + rng.normal(0, 0.3, (4, 16, 2))
    seen = (np.arange(16)[None] >> np.arange(4)[:, None]) & 1 == 1
    missing = np.where(seen[..., None], u, np.nan)
    missing[0, 6, 1] = np.nan  # half a pixel is none
    found = triangulate(missing, rig)
    for point in range(16):
        views = np.flatnonzero(seen[:, point])
        if len(views) < 2:
            assert np.isnan(found[point]).all()
            continue
        part = Rig(tuple(rig.names[v] for v in views), tuple(rig.cameras[v] for v in views), metric=True)
        np.testing.assert_allclose(found[point], triangulate(u[views, point], part), rtol=1e-12)


def test_all_views_of_many_are_what_they_were():
    rig = simple_rig(3)
    rng = np.random.default_rng(10)
    u = project_all(rig, scene_points(rng, 20)) + rng.normal(0, 0.3, (3, 20, 2))
    partly = u.copy()
    partly[1, 0] = np.nan
    np.testing.assert_array_equal(triangulate(partly, rig)[1:], triangulate(u, rig)[1:])


def test_weights_draw_towards_the_heavier_views():
    rig = simple_rig(3)
    rng = np.random.default_rng(11)
    X = scene_points(rng, 4000)
    u = project_all(rig, X) + rng.normal(0, 1, (3, 4000, 2)) * np.array([0.05, 0.05, 0.5])[:, None, None]
    errors = {
        name: np.sqrt(np.mean((triangulate(u, rig, weights=weights) - X) ** 2))
        for name, weights in (("equal", None), ("of noise", [[20.0], [20.0], [2.0]]), ("of two", [[1], [1], [1e-9]]))
    }
    pair = Rig(rig.names[:2], rig.cameras[:2], metric=True)
    assert errors["of noise"] < 0.6 * errors["equal"]
    assert errors["of noise"] < errors["of two"]
    np.testing.assert_allclose(triangulate(u, rig, weights=[[1], [1], [1e-9]]), triangulate(u[:2], pair), rtol=1e-9)


def test_parallel_rays_are_nan_not_a_far_point():
    camera = simple_rig().cameras[0]
    beside = Camera(camera.K, camera.image_size, cam_from_world=np.column_stack([np.eye(3), [-4.0, 0, 0]]))
    rig = Rig(("a", "b"), (camera, beside), metric=True)
    assert np.isnan(triangulate(np.full((2, 1, 2), 1000.0), rig)).all()


def test_wrong_number_of_views_is_refused():
    with pytest.raises(DatasetError, match="expected one entry for each of at least two cameras"):
        triangulate(np.zeros((3, 5, 2)), simple_rig())


@settings(max_examples=25, deadline=None)
@given(angles=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.tuples(*[st.floats(-50, 50)] * 3))
def test_a_rigid_motion_of_the_world_changes_nothing(angles, shift):
    rig = simple_rig(3, distortion=True)
    rng = np.random.default_rng(4)
    u = project_all(rig, scene_points(rng, 10)) + rng.normal(0, 0.3, (3, 10, 2))
    moved_from_world = np.column_stack([Rotation.from_rotvec(angles).as_matrix(), shift])
    cameras = []
    for c in rig.cameras:
        R = c.rotation @ moved_from_world[:, :3].T
        cameras.append(Camera(c.K, c.image_size, c.distortion, np.column_stack([R, c.translation - R @ shift])))
    again = Rig.from_world(rig.names, cameras, metric=True)
    np.testing.assert_allclose(triangulate(u, again), triangulate(u, rig), atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(factor=st.floats(0.01, 100))
def test_the_baseline_scales_everything(factor):
    rig = simple_rig()
    rng = np.random.default_rng(5)
    u = project_all(rig, scene_points(rng, 10)) + rng.normal(0, 0.3, (2, 10, 2))
    # The linear method minimises |A X| at |X| = 1, and that norm depends a little on the unit of length.
    np.testing.assert_allclose(triangulate(u, rig.scaled(factor)), factor * triangulate(u, rig), rtol=1e-6)


def test_swapped_views_agree():
    rig = simple_rig()
    rng = np.random.default_rng(6)
    u = project_all(rig, scene_points(rng, 10)) + rng.normal(0, 0.3, (2, 10, 2))
    swapped = Rig.from_world(rig.names[::-1], rig.cameras[::-1], metric=True)
    second = rig.cameras[1]
    expected = triangulate(u, rig) @ second.rotation.T + second.translation
    np.testing.assert_allclose(triangulate(u[::-1], swapped), expected, atol=1e-6)


def test_reprojection_error_is_the_root_mean_square_over_views():
    rig = simple_rig()
    X = scene_points(np.random.default_rng(7), 4)
    u = project_all(rig, X)
    u[0, :, 0] += 3.0
    u[1, :, 1] += 4.0
    np.testing.assert_allclose(compute_reprojection_error(X, u, rig), np.sqrt((9 + 16) / 2), rtol=1e-9)


def test_cheirality_tells_points_behind_a_camera():
    rig = simple_rig()
    X = np.array([[0.0, 0.0, 22.0], [0.0, 0.0, -22.0], [np.nan] * 3])
    assert in_front_of_all(X, rig).tolist() == [True, False, False]
    assert np.isnan(compute_reprojection_error(X[1:2], np.zeros((2, 1, 2)), rig)).all()


def test_views_that_do_not_see_a_point_do_not_count():
    rig = simple_rig(3)
    X = scene_points(np.random.default_rng(12), 3)
    u = project_all(rig, X)
    u[0, :, 0] += 3.0
    u[2, 0] = np.nan
    expected = np.sqrt([9 / 2, 9 / 3, 9 / 3])
    np.testing.assert_allclose(compute_reprojection_error(X, u, rig), expected, rtol=1e-9)
    behind = np.array([[0.0, 0.0, 22.0], [0.0, 0.0, -22.0], [np.nan] * 3])
    blind = np.zeros((3, 3), dtype=bool)
    assert in_front_of_all(behind, rig, seen=blind).tolist() == [True, True, False]
    assert in_front_of_all(behind, rig, seen=~blind).tolist() == [True, False, False]


def test_sampson_error_has_the_size_of_pixel_noise():
    rig = simple_rig(distortion=True)
    rng = np.random.default_rng(8)
    u = project_all(rig, scene_points(rng, 20000))
    np.testing.assert_allclose(sampson_error(u[0], u[1], rig), 0, atol=1e-7)
    noisy = u + rng.normal(0, 0.4, u.shape)
    assert np.std(sampson_error(noisy[0], noisy[1], rig)) == pytest.approx(0.4, rel=0.03)
