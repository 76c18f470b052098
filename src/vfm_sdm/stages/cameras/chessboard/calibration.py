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
        Intrinsics and distortion; the pose is the identity.
    covariance
        Shape (10, 10), in the order of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`; pose rows and columns are zero.
    rms
        Root mean square distance between seen and reprojected corner [px].
    reprojection_error
        The same for each picture that was used, by name [px].
    dropped
        Why a picture was not used, by name.
    pose_scatter
        See `vfm_sdm.stages.cameras.chessboard.adjustment.AdjustedBoards` [1].
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
        Metric, with covariance; the first view is the reference.
    rms
        Root mean square distance between seen and reprojected corner, by view [px].
    reprojection_error
        The same for each pair that was used: by pair, then by view [px].
    dropped
        Why a pair was not used, by pair. With more than two views the key also names the two views.
    reordered
        Pairs in which one view's corners came turned and were put in order.
    baseline_m, baseline_std_m
        Between the first two views [m]; NaN for a single view.
    pose_scatter
        See `vfm_sdm.stages.cameras.chessboard.adjustment.AdjustedBoards` [1].
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
    """Intrinsics, distortion and their covariance from one camera's pictures of the board.

    Parameters
    ----------
    corners
        One array of shape (N, 2) [px] a picture, NaN for hidden corners; ``None`` where the board was not found.
    board_xy
        The corners on the board, shape (N, 2) [m].
    image_size
        Width and height [px].
    names
        Of the pictures; numbered when not given.
    fix_tangential, fix_k3
        Keep p1 and p2, or k3, at zero.

    Raises
    ------
    CameraError
        Fewer than three usable pictures, corners outside the image, or poses that do not determine the camera.
    DatasetError
        The board or a picture's corners have another shape.
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
    """Cameras, their relative poses and covariance from pictures that all views took of the same board poses.

    Parameters
    ----------
    corners_by_view
        By view name, the first one the reference: one array of shape (N, 2) [px] a picture, NaN for hidden corners;
        ``None`` where the board was not found. Equal places are the same pose of the board.
    board_xy
        The corners on the board, shape (N, 2) [m].
    image_sizes
        Width and height by view name [px].
    names
        Of the pairs; numbered when not given.
    fix_tangential, fix_k3
        Keep p1 and p2, or k3, at zero.

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
    is adjusted anew. All intrinsics, relative poses and board poses are adjusted together, from the start that
    OpenCV's calibration of each camera alone gives. The board counts as exact: an error of its squares or its
    flatness is the same in all pictures, changes the baseline and is not in the covariance.
    """
    board = as_float_array(board_xy, "board_xy", (None, 2))
    pairs = PairSet(corners_by_view, board, image_sizes, names)
    free = np.array([i for i, name in enumerate(INTRINSICS) if not _is_fixed(name, fix_tangential, fix_k3)])
    while True:
        scene, points2d = pairs.start(free)
        adjusted = adjust_boards(scene, points2d, free_intrinsics=free)
        if not pairs.drop_worst(_rms(adjusted.residuals, axis=2)):
            return _result(pairs, adjusted)


def _is_fixed(name: str, fix_tangential: bool, fix_k3: bool) -> bool:
    return (fix_tangential and name in ("p1", "p2")) or (fix_k3 and name == "k3")


def _rms(residuals: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Root mean square length of residual vectors [px]; NaN where nothing was seen."""
    return np.asarray(np.sqrt(mean_of_known((residuals**2).sum(axis=-1), axis=axis)))


def _result(pairs: PairSet, adjusted: AdjustedBoards) -> ChessboardCalibration:
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
    errors = _rms(adjusted.residuals, axis=2)
    by_pair = {
        pairs.names[pose]: {
            view: float(errors[row, column]) for column, view in enumerate(pairs.views) if used[pose, column]
        }
        for row, pose in enumerate(np.flatnonzero(used.any(axis=1)))
    }
    baseline, std = _baseline(rig) if len(rig) > 1 else (np.nan, np.nan)
    rms = _rms(adjusted.residuals, axis=(0, 2))
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


def _baseline(rig: Rig) -> tuple[float, float]:
    """Length of the second camera's translation and its standard deviation [m]."""
    t = rig.cameras[1].translation
    length = float(np.linalg.norm(t))
    size = len(CAMERA_PARAMETERS)
    block = np.asarray(rig.covariance)[2 * size - 3 : 2 * size, 2 * size - 3 : 2 * size]
    return length, float(np.sqrt(t @ block @ t) / length)
