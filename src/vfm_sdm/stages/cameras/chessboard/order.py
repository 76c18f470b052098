"""Which end of a chessboard a detector began at: corner orders made to agree between two views."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.statuses import BoardStatus
from vfm_sdm.geometry.poses import pose_array, rigid_transform

__all__ = ["BoardOrder", "agree_on_order", "board_symmetries"]


_TOLERANCE_DEG = 20.0
"""Poses of a board seen in one view are off by some degrees at most; a wrong order turns it by 90 or 180."""
_DISTINCT = 3.0
"""How much wider a rival explanation must scatter to be ruled out."""


@dataclass(frozen=True, eq=False)
class BoardOrder:
    """How the second view's corners have to be reordered.

    Parameters
    ----------
    turns
        Index into the symmetries of the board for each pose, shape (P,); 0 keeps the order.
    reasons
        Why a pose cannot be used, shape (P,); empty where it can.
    second_from_first
        Pose of the second camera in the first one's frame on which the poses agree, shape (3, 4).
    """

    turns: IntArray
    reasons: tuple[str, ...]
    second_from_first: FloatArray


def board_symmetries(board: FloatArray) -> tuple[tuple[FloatArray, IntArray], ...]:
    """Quarter turns that lay the board's corners onto themselves.

    Parameters
    ----------
    board
        Shape (N, 2) [m].

    Returns
    -------
    symmetries
        Motions of the board's plane, shape (3, 4), each with the index of the corner that every corner comes to lie
        on, shape (N,). The first one keeps all in place.
    """
    center = (board.min(axis=0) + board.max(axis=0)) / 2
    extent = float(np.ptp(board, axis=0).max())
    symmetries = []
    for cosine, sine in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        turn = np.array([[cosine, -sine], [sine, cosine]], dtype=np.float64)
        turned = (board - center) @ turn.T + center
        distance = np.linalg.norm(turned[:, None] - board, axis=-1)
        onto = distance.argmin(axis=1)
        if distance.min(axis=1).max() < 1e-4 * extent:
            motion = np.eye(3, 4)
            motion[:2, :2] = turn
            motion[:2, 3] = center - turn @ center
            symmetries.append((motion, onto))
    return tuple(symmetries)


def agree_on_order(first_from_board: FloatArray, second_from_board: FloatArray, board: FloatArray) -> BoardOrder:
    """The order of the second view's corners in which the two cameras keep one relative pose.

    Parameters
    ----------
    first_from_board, second_from_board
        Pose of the board in each camera as the corners came, shape (P, 3, 4).
    board
        Corners on the board, shape (N, 2) [m].

    Notes
    -----
    Each pose offers one relative pose of the cameras for each symmetry of the board. The one that most poses can
    agree on is taken. Boards that are all held alike admit a turned explanation just as well; then poses stay as
    they came when that explains them, and the others are given up.
    """
    board_from_first, second = rigid_transform(first_from_board).inv(), rigid_transform(second_from_board)
    unturned = [rigid_transform(motion).inv() for motion, _ in board_symmetries(board)]
    offers = np.stack([pose_array(second * back * board_from_first) for back in unturned], axis=1)  # (P, S, 3, 4)
    poses, turns = offers.shape[:2]
    angles = _angle_deg(offers[:, :, None, None, :, :3], offers[None, None, :, :, :, :3])  # (P, S, P, S)
    nearest = angles.min(axis=-1)  # (P, S, P): how well each offer explains each pose
    votes = (nearest < _TOLERANCE_DEG).sum(axis=-1)
    spread = np.minimum(nearest, _TOLERANCE_DEG).mean(axis=-1)
    best = min(np.ndindex(poses, turns), key=lambda offer: (-votes[offer], spread[offer]))
    rivals = (
        (angles[best] > 2 * _TOLERANCE_DEG)
        & (votes >= votes[best])
        & (spread < _DISTINCT * max(float(spread[best]), 1e-6))
    )
    ambiguous = bool(rivals.any())
    if ambiguous:
        as_came = (angles[..., 0] < _TOLERANCE_DEG).sum(axis=-1)
        candidates = [best, *(offer for offer in np.ndindex(poses, turns) if rivals[offer])]
        best = min(candidates, key=lambda offer: (-as_came[offer], spread[offer]))
    turn = angles[best].argmin(axis=-1)
    reasons = tuple(
        BoardStatus.INCONSISTENT_POSE
        if nearest[best][pose] >= _TOLERANCE_DEG
        else (BoardStatus.AMBIGUOUS_ORDER if ambiguous and turn[pose] != 0 else "")
        for pose in range(poses)
    )
    return BoardOrder(turn, reasons, offers[best])


def _angle_deg(first: FloatArray, second: FloatArray) -> FloatArray:
    trace = (first * second).sum(axis=(-1, -2))
    return np.asarray(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))))
