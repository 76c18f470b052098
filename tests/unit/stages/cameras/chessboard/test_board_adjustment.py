"""The joint adjustment of cameras and board poses, and its covariance."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boards import BOARD, IMAGE_SIZE, add_noise, board_poses, make_rig, see_board
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.cameras.chessboard.adjustment import adjust_boards
from vfm_sdm.stages.cameras.chessboard.scene import BoardScene, linearize

FREE = np.arange(6)
FLAT = np.column_stack([BOARD, np.zeros(len(BOARD))])


def true_scene(rig, poses):
    intrinsics = [[c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2], *c.distortion] for c in rig.cameras]
    return BoardScene(np.array(intrinsics), np.stack([c.cam_from_world for c in rig.cameras]), poses, FLAT)


def disturbed(scene, rng):
    """A start some per cent and degrees off."""
    turn = Rotation.from_rotvec(rng.normal(0, 0.01, (len(scene.first_from_board), 3))).as_matrix()
    poses = np.concatenate([turn @ scene.first_from_board[:, :, :3], 1.01 * scene.first_from_board[:, :, 3:]], axis=-1)
    relative = scene.cam_from_first.copy()
    relative[1:, :, 3] *= 1.02
    intrinsics = scene.intrinsics * np.array([1.02, 1.01, 1.01, 0.99, 1, 1, 1, 1, 1])
    return BoardScene(intrinsics, relative, poses, FLAT)


def problem(seed=0, views=2, poses=8, noise_px=0.0):
    rng = np.random.default_rng(seed)
    rig = make_rig(views)
    board = board_poses(rng, poses)
    corners = add_noise(see_board(rig, board), rng, noise_px)
    return rig, true_scene(rig, board), np.stack([np.array(c) for c in corners.values()], axis=1), rng


class TestLinearize:
    def test_prediction_agrees_with_the_camera(self):
        _, scene, points2d, _ = problem(views=3)
        np.testing.assert_allclose(linearize(scene)[0], points2d, atol=1e-9)

    @pytest.mark.parametrize("column", range(15))
    def test_derivative_by_the_camera(self, column):
        _, scene, _, _ = problem()
        scene.intrinsics[1, 6:] = [1e-3, -2e-3, 0.03]
        step = 1e-6 * (100 if column < 4 else 1)

        def moved(sign):
            delta = np.zeros(15)
            delta[column] = sign * step
            intrinsics, poses = scene.intrinsics.copy(), scene.cam_from_first.copy()
            intrinsics[1] += delta[:9]
            poses[1, :, :3] = Rotation.from_rotvec(delta[9:12]).as_matrix() @ poses[1, :, :3]
            poses[1, :, 3] += delta[12:]
            return linearize(BoardScene(intrinsics, poses, scene.first_from_board, FLAT))[0][:, 1]

        numeric = (moved(1) - moved(-1)) / (2 * step)
        np.testing.assert_allclose(linearize(scene)[1][:, 1, ..., column], numeric, atol=1e-3, rtol=1e-6)

    @pytest.mark.parametrize("column", range(6))
    def test_derivative_by_the_board(self, column):
        _, scene, _, _ = problem()
        step = 1e-6

        def moved(sign):
            delta = np.zeros(6)
            delta[column] = sign * step
            poses = scene.first_from_board.copy()
            poses[:, :, :3] = Rotation.from_rotvec(delta[:3]).as_matrix() @ poses[:, :, :3]
            poses[:, :, 3] += delta[3:]
            return linearize(BoardScene(scene.intrinsics, scene.cam_from_first, poses, FLAT))[0]

        numeric = (moved(1) - moved(-1)) / (2 * step)
        np.testing.assert_allclose(linearize(scene)[2][..., column], numeric, atol=1e-3, rtol=1e-6)

    def test_board_behind_a_camera_is_nan(self):
        _, scene, _, _ = problem()
        scene.first_from_board[0, 2, 3] = -1.0
        assert np.isnan(linearize(scene)[0][0]).all()


class TestAdjust:
    @pytest.mark.parametrize("views", [1, 2, 3])
    def test_exact_corners_give_the_truth(self, views):
        rig, scene, points2d, rng = problem(views=views)
        found = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE)
        np.testing.assert_allclose(found.scene.intrinsics, scene.intrinsics, atol=1e-5)
        np.testing.assert_allclose(found.scene.cam_from_first, scene.cam_from_first, atol=1e-9)
        assert np.abs(found.residuals).max() < 1e-6
        assert len(rig) == views

    def test_agrees_with_opencv_on_noisy_corners(self):
        _, scene, points2d, rng = problem(noise_px=0.3)
        found = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE)
        start = [(np.array([[v[0], 0, v[2]], [0, v[1], v[3]], [0, 0, 1]]), v[4:9].copy()) for v in scene.intrinsics]
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
        rms, K1, _, K2, _, R, T, _, _ = cv2.stereoCalibrate(
            [FLAT.astype(np.float32)] * len(points2d),
            list(points2d[:, 0].astype(np.float32)),
            list(points2d[:, 1].astype(np.float32)),
            *start[0],
            *start[1],
            IMAGE_SIZE,
            np.eye(3),
            np.zeros((3, 1)),
            flags=flags,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14),
        )
        # OpenCV takes single-precision corners and stops a little early, along the weak direction in which a turn of
        # the camera makes up for its principal point; its cost is not below ours.
        np.testing.assert_allclose(found.scene.cam_from_first[1][:, :3], R, atol=5e-5)
        np.testing.assert_allclose(found.scene.cam_from_first[1][:, 3], T.ravel(), atol=5e-6)
        np.testing.assert_allclose(found.scene.intrinsics[0, :4], K1[[0, 1, 0, 1], [0, 1, 2, 2]], atol=0.05)
        np.testing.assert_allclose(found.scene.intrinsics[1, :4], K2[[0, 1, 0, 1], [0, 1, 2, 2]], atol=0.05)
        assert np.sqrt((found.residuals**2).sum(axis=-1).mean()) < rms * (1 + 2e-6)

    def test_hidden_corners_do_not_count(self):
        _, scene, points2d, rng = problem()
        hidden = points2d.copy()
        hidden[2, 1, :20] = np.nan
        hidden[3, 1] = np.nan
        found = adjust_boards(disturbed(scene, rng), hidden, free_intrinsics=FREE)
        np.testing.assert_allclose(found.scene.cam_from_first, scene.cam_from_first, atol=1e-9)
        assert np.isnan(found.residuals[3, 1]).all()

    def test_fixed_parameters_stay(self):
        _, scene, points2d, rng = problem(noise_px=0.2)
        found = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=np.arange(5))
        np.testing.assert_array_equal(found.scene.intrinsics[:, 5:], scene.intrinsics[:, 5:])

    def test_one_camera_has_opencvs_standard_deviations(self):
        _, scene, points2d, rng = problem(views=1, poses=15, noise_px=0.2)
        found = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE)
        result = cv2.calibrateCameraExtended(
            [FLAT.astype(np.float32)] * len(points2d),
            list(points2d[:, 0].astype(np.float32)),
            IMAGE_SIZE,
            np.eye(3),
            np.zeros(5),
            flags=cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
        )
        fx_std, fy_std, cx_std, cy_std = result[5].ravel()[:4]
        std = np.sqrt(np.diag(found.covariance))
        assert found.pose_scatter == 1.0
        np.testing.assert_allclose(std[1:3], [cx_std, cy_std], rtol=0.02)
        focal = np.sqrt(found.scene.intrinsics[0, 0] * found.scene.intrinsics[0, 1])
        assert focal * std[0] == pytest.approx((fx_std + fy_std) / 2, rel=0.05)


class TestCovariance:
    def test_first_pose_is_known_and_the_rest_is_positive(self):
        _, scene, points2d, rng = problem(noise_px=0.2)
        covariance = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE).covariance
        assert covariance.shape == (20, 20)
        np.testing.assert_array_equal(covariance[4:10], 0.0)
        kept = np.r_[0:4, 10:20]
        scale = np.sqrt(np.diag(covariance)[kept])
        correlation = covariance[np.ix_(kept, kept)] / np.outer(scale, scale)
        np.testing.assert_allclose(correlation, correlation.T, rtol=0, atol=1e-9)
        assert np.linalg.eigvalsh(correlation).min() > 0

    def test_doubles_with_the_noise(self):
        stds = []
        for noise in (0.1, 0.2):
            _, scene, points2d, rng = problem(noise_px=noise)
            found = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE)
            stds.append(np.sqrt(np.diag(found.covariance)[[0, 17]]))
        np.testing.assert_allclose(stds[1] / stds[0], 2.0, rtol=0.02)

    def test_errors_alike_within_a_picture_are_noticed(self):
        # The same smooth bend of the board's image, other in each picture: 0.2 px in size, but not independent.
        _, scene, points2d, rng = problem(poses=15, noise_px=0.05)
        bend = (BOARD - BOARD.mean(axis=0)) / np.ptp(BOARD, axis=0)
        shapes = np.stack([bend[:, 0] ** 2, bend[:, 1] ** 2, bend[:, 0] * bend[:, 1]], axis=-1)
        errors = shapes @ rng.normal(0, 1.5, (15, 2, 3, 2))
        plain = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE)
        bent = adjust_boards(disturbed(scene, rng), points2d + errors, free_intrinsics=FREE)
        assert plain.pose_scatter == 1.0
        assert bent.pose_scatter > 3.0
        size = np.sqrt((bent.residuals**2).mean()) / np.sqrt((plain.residuals**2).mean())
        ratio = np.sqrt(np.diag(bent.covariance)[17] / np.diag(plain.covariance)[17])
        assert ratio > 1.3 * size

    def test_equivalent_k1_moves_the_corners_as_k1_and_k2_do(self):
        # With k2 adjusted, k1 and k2 are each badly known, but not what they do together to the seen corners.
        _, scene, points2d, rng = problem(poses=15, noise_px=0.2)
        both = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=FREE).covariance
        one = adjust_boards(disturbed(scene, rng), points2d, free_intrinsics=np.arange(5)).covariance
        assert np.sqrt(both[3, 3]) < 2.5 * np.sqrt(one[3, 3])


class TestRefused:
    def test_start_behind_a_camera(self):
        _, scene, points2d, _ = problem()
        scene.first_from_board[0, 2, 3] = -1.0
        with pytest.raises(CameraError, match="expected the board in front of all cameras"):
            adjust_boards(scene, points2d, free_intrinsics=FREE)

    def test_poses_all_alike(self):
        rig = make_rig()
        pose = np.column_stack([np.eye(3), [-0.1, -0.06, 0.8]])
        poses = np.stack([pose + np.array([[0, 0, 0, 1e-13 * i]] * 3) for i in range(5)])
        points2d = np.stack([np.array(c) for c in see_board(rig, poses).values()], axis=1)
        noise = np.random.default_rng(0).normal(0, 0.1, points2d.shape)
        with pytest.raises(CameraError, match=r"singular adjustment|poses all alike|expected convergence"):
            adjust_boards(true_scene(rig, poses), points2d + noise, free_intrinsics=FREE)

    def test_too_few_corners(self):
        _, scene, points2d, _ = problem(poses=3)
        few = np.where(np.arange(len(BOARD))[:, None] % 14 == 0, points2d, np.nan)
        few[..., 28:, :] = np.nan
        with pytest.raises(CameraError, match=r"expected more observations than unknowns|singular adjustment"):
            adjust_boards(scene, few, free_intrinsics=FREE)


def test_projection_is_that_of_the_camera_class():
    rig, scene, points2d, _ = problem()
    camera = rig.cameras[1]
    rebuilt = Camera(camera.K, IMAGE_SIZE, scene.intrinsics[1, 4:], scene.cam_from_first[1])
    points3d = FLAT @ scene.first_from_board[0, :, :3].T + scene.first_from_board[0, :, 3]
    np.testing.assert_allclose(rebuilt.project(points3d), points2d[0, 1], atol=1e-9)
