"""Corners found in pictures with exact truth."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boards import BOARD, PATTERN, SQUARE_M, render_board
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.cameras.chessboard.detection import board_points, detect_corners

CAMERA = Camera(np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]), (640, 480))


@pytest.fixture(scope="module")
def picture():
    """A rendered board, and where its corners are."""
    R = Rotation.from_euler("xyz", [15, -20, 8], degrees=True).as_matrix()
    pose = np.column_stack([R, [0.02, -0.01, 0.42] - R @ np.append(BOARD.mean(axis=0), 0.0)])
    truth = CAMERA.project(np.column_stack([BOARD, np.zeros(len(BOARD))]) @ R.T + pose[:, 3])
    return render_board(CAMERA, pose), truth


def in_order(corners, truth):
    return min((corners, corners[::-1]), key=lambda c: np.abs(c - truth).max())


class TestBoardPoints:
    def test_row_by_row_from_the_origin(self):
        points = board_points((4, 3), 0.1)
        assert points.shape == (12, 2)
        np.testing.assert_allclose(points[[0, 1, 3, 4, 11]], [[0, 0], [0.1, 0], [0.3, 0], [0, 0.1], [0.3, 0.2]])

    @pytest.mark.parametrize("square", [0.0, -0.01, np.nan])
    def test_square_without_size_is_refused(self, square):
        with pytest.raises(CameraError, match="square_m: expected a length above 0 m"):
            board_points(PATTERN, square)

    def test_too_small_a_pattern_is_refused(self):
        with pytest.raises(CameraError, match=r"pattern: expected at least 3 inner corners .* got 9 and 2"):
            board_points((9, 2), SQUARE_M)
        with pytest.raises(CameraError, match="pattern: expected at least 3 inner corners"):
            detect_corners([], (2, 9))


class TestDetect:
    def test_error_is_below_a_tenth_of_a_pixel(self, picture):
        image, truth = picture
        corners = detect_corners([image], PATTERN)[0].corners
        error = in_order(corners, truth) - truth
        assert np.sqrt((error**2).mean()) < 0.07
        assert np.abs(error.mean(axis=0)).max() < 0.05  # the detector leans a little, but not by a half-pixel origin

    def test_gradient_refinement_removes_much_of_it_and_the_bias(self, picture):
        blurred = cv2.GaussianBlur(picture[0], (0, 0), 1.0)
        errors = []
        for refine_px in (0, 5):
            corners = detect_corners([blurred], PATTERN, refine_px=refine_px)[0].corners
            errors.append(in_order(corners, picture[1]) - picture[1])
        plain, refined = (np.sqrt((error**2).mean()) for error in errors)
        assert refined < 0.03
        assert refined < 0.6 * plain
        assert np.abs(errors[1].mean(axis=0)).max() < 0.01

    def test_negative_window_is_refused(self, picture):
        with pytest.raises(CameraError, match="refine_px: expected 0 or a window in pixels, got -1"):
            detect_corners([picture[0]], PATTERN, refine_px=-1)

    def test_ten_bit_picture_gives_the_same_corners(self, picture):
        image, truth = picture
        corners = detect_corners([image.astype(np.uint16) * 4], PATTERN)[0].corners
        assert np.sqrt(((in_order(corners, truth) - truth) ** 2).mean()) < 0.07

    def test_picture_without_a_board_has_a_reason(self, picture):
        image, _ = picture
        found, missing, black = detect_corners(
            [image, np.full_like(image, 128), np.zeros((50, 60), np.uint16)], PATTERN
        )
        assert found.reason == ""
        assert missing.corners is None
        assert missing.reason == "no board of 9x6 inner corners found"
        assert black.corners is None

    def test_pictures_are_taken_one_at_a_time(self, picture):
        image, _ = picture
        assert len(detect_corners((image for _ in range(2)), PATTERN)) == 2

    @pytest.mark.parametrize("image", [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4)), np.zeros((4, 4), np.int32)])
    def test_no_plane_of_brightness_is_refused(self, image):
        with pytest.raises(CameraError, match=r"images: expected planes \(height, width\) of 8 or 16 bit"):
            detect_corners([image], PATTERN)
