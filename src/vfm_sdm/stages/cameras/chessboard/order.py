"""Orders of a chessboard's corners made to agree between two views, as a detector may start at either end."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.statuses import BoardStatus
from vfm_sdm.geometry.poses import pose_array, rigid_transform

__all__ = ["BoardOrder", "agree_on_order", "board_symmetries"]


_TOLERANCE_DEG = 20.0
"""Poses of a board seen in one view are off by some degrees at most; a wrong order turns it by 90 or 180."""
_DISTINCT = 3.0
"""Factor by which a rival candidate must scatter more to be ruled out."""


@dataclass(frozen=True, eq=False)
class BoardOrder:
    """Reordering of the second view's corners that makes both views agree.

    Parameters
    ----------
    turns
        Index into the symmetries of the board for each pose, shape (P,); 0 keeps the order.
    reasons
        Why a pose cannot be used, shape (P,); empty where it can.
    second_from_first
        Pose of the second camera in the first one's frame on which the poses agree, shape (3, 4) [1, m].
    """

    turns: IntArray
    reasons: tuple[str, ...]
    second_from_first: FloatArray


def board_symmetries(board: FloatArray) -> tuple[tuple[FloatArray, IntArray], ...]:
    """Quarter turns that lay the board's corners onto themselves.

    Parameters
    ----------
    board
        Corners in the board's plane, shape (N, 2) [m].

    Returns
    -------
    symmetries
        Motions of the board's plane, shape (3, 4) [1, m], each with the index of the corner that every corner comes to
        lie on, shape (N,). The first one keeps all corners in place.

    Examples
    --------
    >>> board = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    >>> [onto.tolist() for _, onto in board_symmetries(board)]
    [[0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0]]
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
    """Order of the second view's corners in which the two cameras keep one relative pose.

    Parameters
    ----------
    first_from_board, second_from_board
        Pose of the board in each camera's frame as the corners came, shape (P, 3, 4) [1, m].
    board
        Corners in the board's plane, shape (N, 2) [m].

    Returns
    -------
    order
        Reordering of each pose, and the relative pose of the cameras on which the poses agree.

    Notes
    -----
    Each pose of the board gives one candidate of the cameras' relative pose for each symmetry of the board. The
    candidate with which most poses agree is taken. Boards that are all held alike also agree on a turned candidate;
    then the poses whose order is explained as it came are kept, and the others are rejected.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> board = np.array([[x, y] for y in range(3) for x in range(4)], dtype=float)
    >>> tilts = Rotation.from_euler("xyz", [[20, 0, 0], [0, 30, 0], [10, -20, 40], [-25, 15, -30]], degrees=True)
    >>> first = np.concatenate([tilts.as_matrix(), np.full((4, 3, 1), [[0.0], [0.0], [9.0]])], axis=-1)
    >>> second = first.copy()
    >>> second[2, :, 3] += second[2, :, :3] @ [3.0, 2.0, 0.0]  # this board was read from its other end
    >>> second[2, :, :2] *= -1
    >>> order = agree_on_order(first, second, board)
    >>> order.turns.tolist()
    [0, 0, 1, 0]
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
    """Angle between rotation matrices, shape (..., 3, 3) each [deg]."""
    trace = (first * second).sum(axis=(-1, -2))
    return np.asarray(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))))
