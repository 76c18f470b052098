"""Cameras and rigs: against OpenCV, closed forms, and what must be refused."""

import csv
import tomllib
import warnings
from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vfm_sdm.errors import CameraError, DatasetError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.geometry.distortion import distort, distort_derivative, undistort
from vfm_sdm.geometry.triangulation import triangulate

K = np.array([[1200.0, 0.0, 630.0], [0.0, 1190.0, 370.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.28, 0.11, 0.0012, -0.0007, 0.03])
POSE = np.column_stack([Rotation.from_euler("xyz", [4, -11, 7], degrees=True).as_matrix(), [0.1, -0.2, 0.3]])
SIZE = (1280, 720)


@pytest.fixture
def camera():
    return Camera(K, SIZE, DISTORTION, POSE)


@pytest.fixture
def points3d():
    return np.random.default_rng(1).uniform([-1.5, -0.9, 3.5], [1.5, 0.9, 6], (200, 3))


def some_rig(covariance=None):
    second = Camera(K * [[1.02, 1, 1], [1, 1.02, 1], [1, 1, 1]], SIZE, DISTORTION / 2, POSE)
    return Rig(("left", "right"), (Camera(K, SIZE, DISTORTION), second), False, covariance)


class TestProjection:
    def test_project_agrees_with_opencv(self, camera, points3d):
        rotation, _ = cv2.Rodrigues(camera.rotation)
        expected = cv2.projectPoints(points3d, rotation, camera.translation, K, DISTORTION)[0].reshape(-1, 2)
        np.testing.assert_allclose(camera.project(points3d), expected, atol=1e-8)

    def test_normalize_agrees_with_opencv(self, camera, points3d):
        seen = camera.project(points3d)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
        iterate = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 5 has one function for both
        expected = iterate(seen[:, None], K, DISTORTION, R=None, P=None, criteria=criteria).reshape(-1, 2)
        np.testing.assert_allclose(camera.normalize(seen), expected, atol=1e-9)

    def test_normalize_undoes_project(self, camera, points3d):
        in_camera = points3d @ camera.rotation.T + camera.translation
        expected = in_camera[:, :2] / in_camera[:, 2:]
        np.testing.assert_allclose(camera.normalize(camera.project(points3d)), expected, atol=1e-12)

    def test_principal_axis_falls_on_principal_point(self):
        assert Camera(K, SIZE, DISTORTION).project([0.0, 0.0, 2.0]) == pytest.approx([630.0, 370.0], abs=1e-12)

    def test_skew_shifts_u_by_y_and_is_undone(self):
        skewed = K.copy()
        skewed[0, 1] = 5.0
        camera = Camera(skewed, SIZE, DISTORTION)
        plain = Camera(K, SIZE, DISTORTION)
        point = [0.2, 0.4, 2.0]
        y = (plain.project(point)[1] - 370.0) / 1190.0
        np.testing.assert_allclose(camera.project(point) - plain.project(point), [5.0 * y, 0.0], atol=1e-12)
        np.testing.assert_allclose(camera.normalize(camera.project(point)), [0.1, 0.2], atol=1e-13)

    def test_leading_axes_are_kept(self, camera, points3d):
        grid = points3d.reshape(4, 50, 3)
        assert camera.project(grid).shape == (4, 50, 2)
        np.testing.assert_allclose(camera.project(grid)[1, 2], camera.project(grid[1, 2]), rtol=0, atol=1e-9)

    def test_point_behind_the_camera_is_nan(self):
        assert np.isnan(Camera(K, SIZE).project([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])).all()

    def test_nan_pixel_stays_nan_without_a_warning(self, camera):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            normalized = camera.normalize([[np.nan, 1.0], [640.0, 360.0]])
        assert np.isnan(normalized[0]).all()
        assert np.isfinite(normalized[1]).all()

    @pytest.mark.parametrize("points", [np.zeros(2), np.zeros((4, 2))])
    def test_wrong_shape_is_refused(self, camera, points):
        with pytest.raises(DatasetError, match=r"points3d: expected shape \(\.\.\., 3\)"):
            camera.project(points)
        with pytest.raises(DatasetError, match=r"points2d: expected shape \(\.\.\., 2\)"):
            camera.normalize(np.zeros((4, 3)))

    def test_center_is_where_the_rays_start(self, camera):
        np.testing.assert_allclose(camera.rotation @ camera.center + camera.translation, 0.0, atol=1e-12)

    def test_focal_is_the_geometric_mean(self, camera):
        assert camera.focal_px == pytest.approx(np.sqrt(1200.0 * 1190.0))


class TestDistortion:
    def test_derivative_agrees_with_differences(self):
        points = np.random.default_rng(2).uniform(-0.5, 0.5, (20, 2))
        step = 1e-6
        numeric = np.stack(
            [
                (distort(points + step * axis, DISTORTION) - distort(points - step * axis, DISTORTION)) / (2 * step)
                for axis in np.eye(2)
            ],
            axis=-1,
        )
        np.testing.assert_allclose(distort_derivative(points, DISTORTION), numeric, atol=1e-9)

    @given(
        st.floats(-0.4, 0.4),
        st.floats(-0.2, 0.2),
        st.floats(-0.5, 0.5),
        st.floats(-0.4, 0.4),
    )
    @settings(max_examples=200, deadline=None)
    def test_undistort_is_the_inverse_inside_the_fold_and_never_another_point(self, k1, k2, x, y):
        coefficients = np.array([k1, k2, 0.0, 0.0, 0.0])
        point = np.array([x, y])
        back = undistort(distort(point, coefficients), coefficients)
        radii = np.linspace(0, 1.001 * np.hypot(x, y), 400)
        grows = (np.diff(radii * (1 + k1 * radii**2 + k2 * radii**4)) > 0).all()
        if grows and np.isfinite(back).all():
            np.testing.assert_allclose(back, point, atol=1e-6)
        elif grows:
            # Only right before the fold may Newton fail to settle.
            assert abs(1 + 3 * k1 * radii[-1] ** 2 + 5 * k2 * radii[-1] ** 4) < 1e-2

    @pytest.mark.parametrize("radius", [0.75, 0.95, 1.05, 1.2])
    def test_pixel_outside_the_described_field_is_nan_not_a_mirrored_point(self, radius):
        # r (1 - 0.33 r^2) never exceeds 0.67; on its far branch it reaches these values again, at negative r.
        assert np.isnan(undistort(np.array([[radius, 0.0]]), np.array([-0.33, 0, 0, 0, 0]))).all()

    def test_world_point_beyond_the_fold_is_not_projected_into_the_image(self):
        camera = Camera(K, SIZE, np.array([-0.33, 0, 0, 0, 0]))
        assert np.isnan(camera.project([1.7, 0.0, 1.0])).all()
        assert np.isfinite(camera.project([0.9, 0.0, 1.0])).all()

    def test_short_coefficients_are_padded_and_trailing_zeros_dropped(self):
        np.testing.assert_array_equal(Camera(K, SIZE, np.array([0.1, 0.2])).distortion, [0.1, 0.2, 0, 0, 0])
        np.testing.assert_array_equal(Camera(K, SIZE, np.array([0.1] + [0.0] * 13)).distortion, [0.1, 0, 0, 0, 0])


class TestPerturbed:
    def test_each_parameter_does_what_its_name_says(self, camera):
        delta = np.array([0.01, 2.0, -3.0, 0.05, 0.0, 0.0, 0.0, 0.1, 0.2, -0.3])
        moved = camera.perturbed(delta)
        np.testing.assert_allclose(moved.K[[0, 1], [0, 1]], np.exp(0.01) * K[[0, 1], [0, 1]])
        np.testing.assert_allclose(moved.K[:2, 2], [632.0, 367.0])
        np.testing.assert_allclose(moved.distortion, [DISTORTION[0] + 0.05, *DISTORTION[1:]])
        np.testing.assert_allclose(moved.translation - camera.translation, [0.1, 0.2, -0.3])
        np.testing.assert_array_equal(moved.rotation, camera.rotation)

    def test_rotation_is_a_vector_in_the_cameras_own_frame(self, camera):
        turned = camera.perturbed([0, 0, 0, 0, 0, 0, np.pi / 2, 0, 0, 0])
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        np.testing.assert_allclose(turned.rotation, quarter @ camera.rotation, atol=1e-12)
        np.testing.assert_array_equal(turned.translation, camera.translation)

    def test_zero_changes_nothing(self, camera, points3d):
        np.testing.assert_array_equal(camera.perturbed(np.zeros(10)).project(points3d), camera.project(points3d))

    def test_original_is_left_alone(self, camera):
        camera.perturbed(np.ones(10) * 0.01)
        np.testing.assert_array_equal(camera.K, K)
        np.testing.assert_array_equal(camera.distortion, DISTORTION)

    def test_rig_takes_the_parameters_camera_by_camera(self):
        delta = np.zeros(20)
        delta[10] = 0.1
        moved = some_rig().perturbed(delta)
        assert moved.cameras[0].focal_px == some_rig().cameras[0].focal_px
        assert moved.cameras[1].focal_px == pytest.approx(np.exp(0.1) * some_rig().cameras[1].focal_px)

    def test_wrong_length_is_refused(self, camera):
        with pytest.raises(DatasetError, match=r"delta: expected shape \(10\)"):
            camera.perturbed(np.zeros(9))
        with pytest.raises(DatasetError, match=r"delta: expected shape \(20\)"):
            some_rig().perturbed(np.zeros(10))


class TestRig:
    def test_scaled_multiplies_lengths_and_their_covariance_only(self):
        spread = np.diag(np.arange(1.0, 21.0)) + 0.5
        rig = some_rig(spread).scaled(3.0)
        assert rig.metric
        assert rig.baseline() == pytest.approx(3 * some_rig().baseline())
        np.testing.assert_array_equal(rig.cameras[1].rotation, some_rig().cameras[1].rotation)
        lengths = np.tile([1.0] * 7 + [3.0] * 3, 2)
        np.testing.assert_allclose(rig.covariance, spread * np.outer(lengths, lengths))

    def test_scaling_the_rig_and_the_scene_leaves_the_pixels(self, points3d):
        rig, points = some_rig(), points3d
        for before, after in zip(rig.cameras, rig.scaled(2.5).cameras, strict=True):
            np.testing.assert_allclose(after.project(2.5 * points), before.project(points), atol=1e-9)

    def test_from_world_keeps_pixels_and_puts_the_first_camera_at_the_origin(self, points3d):
        world = [Camera(K, SIZE, DISTORTION, POSE), Camera(K, SIZE)]
        rig = Rig.from_world(("a", "b"), world, metric=True)
        np.testing.assert_allclose(rig.cameras[0].cam_from_world, np.eye(3, 4), atol=1e-12)
        in_first = points3d @ world[0].rotation.T + world[0].translation
        for before, after in zip(world, rig.cameras, strict=True):
            np.testing.assert_allclose(after.project(in_first), before.project(points3d), atol=1e-9)
        assert rig.metric

    def test_baseline_is_the_distance_of_the_centres(self):
        assert some_rig().baseline() == pytest.approx(np.linalg.norm([0.1, -0.2, 0.3]))

    def test_camera_by_name(self):
        rig = some_rig()
        assert rig.camera("right") is rig.cameras[1]
        assert len(rig) == 2
        with pytest.raises(CameraError, match=r"view 'top': expected one of \['left', 'right'\]"):
            rig.camera("top")

    @pytest.mark.parametrize("names", [("left",), ("left", "left"), ("left", "right", "top")])
    def test_names_must_fit_the_cameras(self, names):
        with pytest.raises(CameraError, match="rig: expected one distinct name a camera"):
            Rig(names, some_rig().cameras)

    def test_no_camera_is_refused(self):
        with pytest.raises(CameraError, match="rig: expected one distinct name a camera"):
            Rig((), ())

    def test_covariance_of_another_size_is_refused(self):
        with pytest.raises(DatasetError, match=r"rig covariance: expected shape \(20, 20\)"):
            some_rig(np.eye(10))

    def test_ten_parameters_a_camera(self):
        assert len(CAMERA_PARAMETERS) == 10


class TestRefused:
    @pytest.mark.parametrize("change", [(0, 0, 0.0), (1, 1, -5.0), (0, 2, np.nan)])
    def test_bad_focal_or_nan(self, change):
        bad = K.copy()
        bad[change[0], change[1]] = change[2]
        with pytest.raises(CameraError, match="K: expected finite values and positive focal lengths"):
            Camera(bad, SIZE)

    @pytest.mark.parametrize("bad", [K.T, K * 2])
    def test_transposed_or_scaled_matrix(self, bad):
        with pytest.raises(CameraError, match="K: expected an upper triangle"):
            Camera(bad, SIZE)

    def test_more_than_five_coefficients(self):
        with pytest.raises(CameraError, match="distortion: expected at most k1, k2, p1, p2, k3, got 8"):
            Camera(K, SIZE, np.full(8, 0.1))

    def test_not_a_rotation(self):
        for matrix in (np.diag([1.0, 1.0, -1.0]), 1.01 * np.eye(3)):
            with pytest.raises(CameraError, match="cam_from_world: expected a rotation"):
                Camera(K, SIZE, cam_from_world=np.column_stack([matrix, np.zeros(3)]))

    def test_nan_in_pose_or_distortion(self):
        with pytest.raises(CameraError, match="expected a finite pose and finite distortion"):
            Camera(K, SIZE, cam_from_world=np.column_stack([np.eye(3), [0, np.nan, 0]]))
        with pytest.raises(CameraError, match="expected a finite pose and finite distortion"):
            Camera(K, SIZE, np.array([np.inf]))

    def test_image_without_size(self):
        with pytest.raises(CameraError, match="image_size: expected width and height above 0 px"):
            Camera(K, (0, 720))

    def test_wrong_shapes(self):
        with pytest.raises(DatasetError, match=r"K: expected shape \(3, 3\)"):
            Camera(np.eye(4), SIZE)
        with pytest.raises(DatasetError, match=r"cam_from_world: expected shape \(3, 4\)"):
            Camera(K, SIZE, cam_from_world=np.eye(4))

    def test_arrays_cannot_be_changed_afterwards(self, camera):
        mine = K.copy()
        kept = Camera(mine, SIZE)
        mine[0, 0] = 1.0
        assert kept.K[0, 0] == 1200.0
        with pytest.raises(ValueError, match="read-only"):
            camera.K[0, 0] = 1.0


def test_four_unlike_cameras_measure_the_board(shared_data):
    """Real corners of a 54 mm grid in four wide-angle cameras; the stored calibration is a rig of four."""
    folder = shared_data("caliscope_4cam_charuco")
    stored = tomllib.loads((folder / "camera_array.toml").read_text())["cameras"]
    cameras = []
    for entry in stored.values():
        rotation = np.array(entry["rotation"])
        R = rotation if rotation.shape == (3, 3) else Rotation.from_rotvec(rotation).as_matrix()
        pose = np.column_stack([R, entry["translation"]])
        cameras.append(Camera(np.array(entry["matrix"]), tuple(entry["size"]), np.array(entry["distortions"]), pose))
    names = tuple(stored)
    rig = Rig.from_world(names, cameras, metric=True)
    assert len(rig) == 4
    baselines = [rig.baseline(i, j) for i in range(4) for j in range(i)]
    assert min(baselines) == pytest.approx(0.417, abs=0.001)
    assert max(baselines) == pytest.approx(1.438, abs=0.001)

    ratios = _distance_ratios(folder / "xy.csv", rig, ("0", "2"))
    assert len(ratios) > 100
    assert np.median(ratios) == pytest.approx(1.0, abs=0.006)


def _distance_ratios(path, rig, pair):
    """Triangulated over true distance between corners at least 10 cm apart of the board seen in both views."""
    seen = {}
    with path.open(newline="") as stream:
        for row in csv.DictReader(stream):
            corner = seen.setdefault((row["sync_index"], row["keypoint_id"]), {})
            corner[row["cam_id"]] = [float(row["img_loc_x"]), float(row["img_loc_y"])]
            corner["board"] = [float(row["board_loc_x"]), float(row["board_loc_y"])]
    both = {key: value for key, value in seen.items() if set(pair) <= set(value)}
    indices = [rig.names.index(name) for name in pair]
    two = Rig.from_world(pair, [rig.cameras[i] for i in indices], metric=True)
    points = triangulate(np.array([[value[name] for value in both.values()] for name in pair]), two)
    ratios = []
    keys = list(both)
    for i, j in combinations(range(len(keys)), 2):
        if keys[i][0] != keys[j][0]:
            continue
        true = np.linalg.norm(np.subtract(both[keys[i]]["board"], both[keys[j]]["board"]))
        if true > 0.1:
            ratios.append(np.linalg.norm(points[i] - points[j]) / true)
    return ratios
