"""Calibration of one camera, or of a rig of cameras, from the corners of a chessboard seen in several poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, as_float_array, mean_of_known
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.stages.cameras.chessboard.adjustment import AdjustedBoards, adjust_boards
from vfm_sdm.stages.cameras.chessboard.pairs import PairSet
from vfm_sdm.stages.cameras.chessboard.scene import INTRINSICS

__all__ = ["CameraCalibration", "ChessboardCalibration", "calibrate_camera", "calibrate_rig"]


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """One camera calibrated alone.

    Parameters
    ----------
    camera
        Camera with intrinsics and distortion; its pose is the identity.
    covariance
        Covariance of the camera's parameters, shape (10, 10), in the order and units of
        `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`; the rows and columns of the pose are zero.
    rms
        Root mean square distance between seen and reprojected corners [px].
    reprojection_error
        Root mean square distance in each picture that was used, by name [px].
    dropped
        Why a picture was not used, by name.
    pose_scatter
        Scatter of the pictures over that of independent errors [1]; see
        `vfm_sdm.stages.cameras.chessboard.adjustment.AdjustedBoards`.
    """

    camera: Camera
    covariance: FloatArray
    rms: float
    reprojection_error: Mapping[str, float]
    dropped: Mapping[str, str]
    pose_scatter: float


@dataclass(frozen=True, eq=False)
class ChessboardCalibration:
    """Cameras calibrated together.

    Parameters
    ----------
    rig
        Metric rig with covariance; the first view's camera is its frame.
    rms
        Root mean square distance between seen and reprojected corners, by view [px].
    reprojection_error
        Root mean square distance in each pair that was used: by pair, then by view [px].
    dropped
        Why a pair was not used, by pair. With more than two views the key also names the two views.
    reordered
        Pairs in which one view's corners came turned and were put in order.
    baseline_m, baseline_std_m
        Distance between the first two views and its standard deviation [m]; NaN for a single view.
    pose_scatter
        Scatter of the pairs over that of independent errors [1]; see
        `vfm_sdm.stages.cameras.chessboard.adjustment.AdjustedBoards`.
    """

    rig: Rig
    rms: Mapping[str, float]
    reprojection_error: Mapping[str, Mapping[str, float]]
    dropped: Mapping[str, str]
    reordered: tuple[str, ...]
    baseline_m: float
    baseline_std_m: float
    pose_scatter: float


def calibrate_camera(
    corners: Sequence[FloatArray | None],
    board_xy: npt.ArrayLike,
    image_size: tuple[int, int],
    *,
    names: Sequence[str] | None = None,
    fix_tangential: bool = True,
    fix_k3: bool = True,
) -> CameraCalibration:
    """Camera's intrinsics, distortion and their covariance from its pictures of the board.

    Parameters
    ----------
    corners
        Corners in each picture, shape (N, 2) [px], NaN for hidden corners; ``None`` where the board was not found.
    board_xy
        Corners in the board's plane, shape (N, 2) [m].
    image_size
        Width and height [px].
    names
        Names of the pictures; they are numbered when not given.
    fix_tangential, fix_k3
        Whether p1 and p2, or k3, stay zero.

    Returns
    -------
    calibration
        Camera with its covariance, and the errors of the pictures [px].

    Raises
    ------
    CameraError
        Fewer than three usable pictures, corners outside the image, or poses that do not determine the camera.
    DatasetError
        The board or a picture's corners have another shape.

    Notes
    -----
    The method of `calibrate_rig` with one view.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> from vfm_sdm.stages.cameras.chessboard.scene import BoardScene, linearize
    >>> angles = [[25, 0, 0], [0, 30, 0], [15, -25, 40], [-25, 15, -30], [-30, -20, 10]]
    >>> R = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    >>> boards = np.concatenate([R, np.full((5, 3, 1), [[-0.1], [0.0], [2.0]])], axis=-1)
    >>> board = np.array([[x, y, 0.0] for y in range(4) for x in range(5)]) * 0.1
    >>> scene = BoardScene(np.array([[1000.0, 1000, 320, 240, 0, 0, 0, 0, 0]]), np.eye(3, 4)[None], boards, board)
    >>> pixels = linearize(scene)[0]
    >>> calibration = calibrate_camera(list(pixels[:, 0]), board[:, :2], (640, 480))
    >>> K = calibration.camera.K
    >>> [round(float(value), 2) for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])]
    [1000.0, 1000.0, 320.0, 240.0]
    """
    view = "camera"
    calibration = calibrate_rig(
        {view: corners}, board_xy, {view: image_size}, names=names, fix_tangential=fix_tangential, fix_k3=fix_k3
    )
    return CameraCalibration(
        calibration.rig.cameras[0],
        np.asarray(calibration.rig.covariance),
        calibration.rms[view],
        {name: errors[view] for name, errors in calibration.reprojection_error.items()},
        calibration.dropped,
        calibration.pose_scatter,
    )


def calibrate_rig(
    corners_by_view: Mapping[str, Sequence[FloatArray | None]],
    board_xy: npt.ArrayLike,
    image_sizes: Mapping[str, tuple[int, int]],
    *,
    names: Sequence[str] | None = None,
    fix_tangential: bool = True,
    fix_k3: bool = True,
) -> ChessboardCalibration:
    """Cameras, their relative poses and their covariance from pictures that all views took of the same board poses.

    Parameters
    ----------
    corners_by_view
        Corners by view name: for each picture an array of shape (N, 2) [px], NaN for hidden corners, or ``None`` where
        the board was not found. Pictures at equal places of two views show the same pose of the board. The first view's
        camera is the frame of the rig.
    board_xy
        Corners in the board's plane, shape (N, 2) [m].
    image_sizes
        Width and height by view name [px].
    names
        Names of the pairs; they are numbered when not given.
    fix_tangential, fix_k3
        Whether p1 and p2, or k3, stay zero.

    Returns
    -------
    calibration
        Rig with its covariance, the errors of the pairs [px] and the baseline [m].

    Raises
    ------
    CameraError
        Fewer than three usable pairs (the message names the dropped ones), views with different numbers of pictures,
        corners outside the image, or poses that do not determine the cameras.
    DatasetError
        The board or a picture's corners have another shape.

    Notes
    -----
    Every view is paired with the first. A pair is dropped when a view found no corners, when their order cannot be
    made to agree with the other pairs, or when its reprojection error is above 2.5 times the median of all; the rest
    is adjusted anew. The calibration of each camera alone, by OpenCV with the method of [1]_, gives the start. From
    there all intrinsics, relative poses and board poses are adjusted together
    (`vfm_sdm.stages.cameras.chessboard.adjustment.adjust_boards`). The board counts as exact: an error of its squares
    or its flatness is the same in all pictures, changes the baseline and is not in the covariance.

    References
    ----------
    .. [1] Z. Zhang, "A flexible new technique for camera calibration", IEEE Transactions on Pattern Analysis and
       Machine Intelligence 22(11), 1330-1334, 2000.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> from vfm_sdm.stages.cameras.chessboard.scene import BoardScene, linearize
    >>> angles = [[25, 0, 0], [0, 30, 0], [15, -25, 40], [-25, 15, -30], [-30, -20, 10]]
    >>> R = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    >>> boards = np.concatenate([R, np.full((5, 3, 1), [[-0.1], [0.0], [2.0]])], axis=-1)
    >>> board = np.array([[x, y, 0.0] for y in range(4) for x in range(5)]) * 0.1
    >>> cameras = np.stack([np.eye(3, 4), np.column_stack([np.eye(3), [-0.3, 0.0, 0.0]])])
    >>> scene = BoardScene(np.array([[1000.0, 1000, 320, 240, 0, 0, 0, 0, 0]] * 2), cameras, boards, board)
    >>> pixels = linearize(scene)[0]
    >>> corners = {"left": list(pixels[:, 0]), "right": list(pixels[:, 1])}
    >>> calibration = calibrate_rig(corners, board[:, :2], {"left": (640, 480), "right": (640, 480)})
    >>> print(f"{calibration.baseline_m:.4f} m")
    0.3000 m
    """
    board = as_float_array(board_xy, "board_xy", (None, 2))
    pairs = PairSet(corners_by_view, board, image_sizes, names)
    free = np.array([i for i, name in enumerate(INTRINSICS) if not _is_fixed(name, fix_tangential, fix_k3)])
    while True:
        scene, points2d = pairs.start(free)
        adjusted = adjust_boards(scene, points2d, free_intrinsics=free)
        if not pairs.drop_worst(_compute_rms(adjusted.residuals, axis=2)):
            return _make_calibration(pairs, adjusted)


def _is_fixed(name: str, fix_tangential: bool, fix_k3: bool) -> bool:
    return (fix_tangential and name in ("p1", "p2")) or (fix_k3 and name == "k3")


def _compute_rms(residuals: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Root mean square length of residual vectors [px]; NaN where nothing was seen."""
    return np.asarray(np.sqrt(mean_of_known((residuals**2).sum(axis=-1), axis=axis)))


def _make_calibration(pairs: PairSet, adjusted: AdjustedBoards) -> ChessboardCalibration:
    """Calibration from the pairs in use and their adjustment."""
    scene = adjusted.scene
    cameras = tuple(
        Camera(
            np.array([[values[0], 0.0, values[2]], [0.0, values[1], values[3]], [0.0, 0.0, 1.0]]),
            pairs.image_sizes[view],
            values[4:],
            pose,
        )
        for view, values, pose in zip(pairs.views, scene.intrinsics, scene.cam_from_first, strict=True)
    )
    rig = Rig(pairs.views, cameras, True, adjusted.covariance)
    used = pairs.used
    errors = _compute_rms(adjusted.residuals, axis=2)
    by_pair = {
        pairs.names[pose]: {
            view: float(errors[row, column]) for column, view in enumerate(pairs.views) if used[pose, column]
        }
        for row, pose in enumerate(np.flatnonzero(used.any(axis=1)))
    }
    baseline, std = _measure_baseline(rig) if len(rig) > 1 else (np.nan, np.nan)
    rms = _compute_rms(adjusted.residuals, axis=(0, 2))
    return ChessboardCalibration(
        rig,
        {view: float(value) for view, value in zip(pairs.views, rms, strict=True)},
        by_pair,
        dict(pairs.dropped),
        tuple(pairs.reordered),
        baseline,
        std,
        adjusted.pose_scatter,
    )


def _measure_baseline(rig: Rig) -> tuple[float, float]:
    """Length of the second camera's translation and its standard deviation [m]."""
    t = rig.cameras[1].translation
    length = float(np.linalg.norm(t))
    size = len(CAMERA_PARAMETERS)
    block = np.asarray(rig.covariance)[2 * size - 3 : 2 * size, 2 * size - 3 : 2 * size]
    return length, float(np.sqrt(t @ block @ t) / length)
