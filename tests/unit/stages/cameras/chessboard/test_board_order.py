"""Corner orders that agree between two views."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boards import BOARD, board_poses, make_rig
from vfm_sdm.core.statuses import BoardStatus
from vfm_sdm.stages.cameras.chessboard.detection import board_points
from vfm_sdm.stages.cameras.chessboard.order import agree_on_order, board_symmetries

RELATIVE = make_rig().cameras[1].cam_from_world


def compose(a, b):
    return np.concatenate([a[..., :3] @ b[..., :3], a[..., :3] @ b[..., 3:] + a[..., 3:]], axis=-1)


def seen_poses(first, *, noise_deg=0.5, seed=0):
    """Poses of the board in the second camera, a little wrong as those of one picture are."""
    rng = np.random.default_rng(seed)
    second = compose(RELATIVE, first)
    second[:, :, :3] = (
        Rotation.from_rotvec(np.radians(rng.normal(0, noise_deg, (len(first), 3)))).as_matrix() @ (second[:, :, :3])
    )
    return second


def turned(poses, indices, board=BOARD, symmetry=1):
    motion = board_symmetries(board)[symmetry][0]
    changed = poses.copy()
    changed[indices] = compose(poses[indices], motion)
    return changed


class TestSymmetries:
    def test_rectangle_has_the_half_turn_only(self):
        symmetries = board_symmetries(BOARD)
        assert len(symmetries) == 2
        np.testing.assert_array_equal(symmetries[0][1], np.arange(len(BOARD)))
        np.testing.assert_array_equal(symmetries[1][1], np.arange(len(BOARD))[::-1])

    def test_square_has_four_quarter_turns_that_move_each_corner_onto_another(self):
        board = board_points((7, 7), 0.02)
        symmetries = board_symmetries(board)
        assert len(symmetries) == 4
        for motion, onto in symmetries:
            moved = np.column_stack([board, np.zeros(49)]) @ motion[:, :3].T + motion[:, 3]
            np.testing.assert_allclose(moved[:, :2], board[onto], atol=1e-12)

    def test_irregular_board_has_none(self):
        assert len(board_symmetries(BOARD[:-1])) == 1


class TestAgree:
    def test_right_order_is_kept(self):
        first = board_poses(np.random.default_rng(1), 8)
        order = agree_on_order(first, seen_poses(first), BOARD)
        np.testing.assert_array_equal(order.turns, 0)
        assert not any(order.reasons)
        np.testing.assert_allclose(order.second_from_first[:, 3], RELATIVE[:, 3], atol=0.02)

    @pytest.mark.parametrize("wrong", [[0], [1, 4, 6], [0, 1, 2, 3, 4, 5]])
    def test_turned_pictures_are_found_even_when_most_are(self, wrong):
        first = board_poses(np.random.default_rng(1), 8)
        order = agree_on_order(first, turned(seen_poses(first), wrong), BOARD)
        np.testing.assert_array_equal(np.flatnonzero(order.turns), wrong)
        assert not any(order.reasons)

    def test_all_turned_is_all_put_right(self):
        first = board_poses(np.random.default_rng(1), 8)
        order = agree_on_order(first, turned(seen_poses(first), np.arange(8)), BOARD)
        np.testing.assert_array_equal(order.turns, 1)

    def test_quarter_turn_of_a_square_board(self):
        board = board_points((7, 7), 0.02)
        first = board_poses(np.random.default_rng(1), 8)
        order = agree_on_order(first, turned(seen_poses(first), [2], board, 2), board)
        np.testing.assert_array_equal(order.turns, [0, 0, 2, 0, 0, 0, 0, 0])
        assert not any(order.reasons)

    def test_boards_held_alike_leave_the_turned_one_ambiguous(self):
        # Parallel to each other, so that a turned board is explained by a turned camera just as well.
        first = board_poses(np.random.default_rng(1), 8, tilt_deg=0.0)
        order = agree_on_order(first, turned(seen_poses(first), [3]), BOARD)
        assert order.reasons[3] == BoardStatus.AMBIGUOUS_ORDER
        assert [reason for i, reason in enumerate(order.reasons) if i != 3] == [""] * 7
        np.testing.assert_array_equal(np.delete(order.turns, 3), 0)

    def test_picture_of_another_pose_is_given_up(self):
        first = board_poses(np.random.default_rng(1), 8)
        second = seen_poses(first)
        second[5, :, :3] = second[5, :, :3] @ Rotation.from_euler("x", 55, degrees=True).as_matrix()
        order = agree_on_order(first, second, BOARD)
        assert order.reasons[5] == BoardStatus.INCONSISTENT_POSE
        assert sum(map(bool, order.reasons)) == 1
