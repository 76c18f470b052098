"""Estimator ``chessboard``: cameras from pictures of a chessboard, or from its ready corners."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.lib.npyio import NpzFile

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import CameraError, VideoError
from vfm_sdm.inputs.session import Chessboard, Session
from vfm_sdm.inputs.video.images import find_images
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.chessboard.calibration import (
    CameraCalibration,
    ChessboardCalibration,
    calibrate_camera,
    calibrate_rig,
)
from vfm_sdm.stages.cameras.chessboard.detection import BoardDetection, board_points, detect_corners

__all__ = [
    "BoardDetection",
    "CameraCalibration",
    "ChessboardCalibration",
    "ChessboardCameras",
    "board_points",
    "calibrate_camera",
    "calibrate_rig",
    "detect_corners",
]


_DISAGREEMENT = 3.0
"""Standard deviations between the two baselines from which they count as contradicting each other."""

_Corners = Mapping[str, Sequence[FloatArray | None]]


class ChessboardCameras:
    """Estimator ``chessboard``: a metric rig from pictures of a chessboard, or from its ready corners.

    Parameters
    ----------
    fix_tangential, fix_k3
        Whether the tangential terms, or the third radial one, stay zero; free them for wide-angle lenses with many
        pictures.
    refine_px
        Half side of the window of `detect_corners` [px].
    """

    name = "chessboard"

    def __init__(self, *, fix_tangential: bool = True, fix_k3: bool = True, refine_px: int = 0) -> None:
        self.fix_tangential = fix_tangential
        self.fix_k3 = fix_k3
        self.refine_px = refine_px

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Metric rig with covariance from the session's chessboard.

        Parameters
        ----------
        session
            Session whose ``chessboard`` names the pictures or the file of corners. That file is an npz with one array
            of shape (poses, corners, 2) [px] for each view, named as the view, and ``board_xy_mm`` of shape (corners,
            2) [mm]; the centre of the top-left pixel is (0, 0).
        frames
            Brightness of the first frame of each view, shape (H, W); only the sizes are used.

        Returns
        -------
        estimate
            Metric rig with covariance, without shared points, and notes on the pairs.

        Raises
        ------
        CameraError
            No chessboard in the session, pictures missing or of another size than the recording, views with different
            numbers of pictures, or fewer than three usable pairs.
        """
        board = session.chessboard
        if board is None:
            raise CameraError("chessboard: expected a [chessboard] in the session, got none; add it or use two-view")
        if len(frames) < 2:
            raise CameraError(f"chessboard: expected at least two views, got {list(frames)}; add a [[view]]")
        sizes = {view: (luma.shape[1], luma.shape[0]) for view, luma in frames.items()}
        names: list[str] | None = None
        if board.corners is not None:
            corners, board_xy = _read_corners(session.resolve(board.corners), board, tuple(frames))
        else:
            board_xy = board_points(board.pattern, board.square_mm * 1e-3)
            corners, names = _detect_all(session, board, sizes, self.refine_px)
        calibration = calibrate_rig(
            corners, board_xy, sizes, names=names, fix_tangential=self.fix_tangential, fix_k3=self.fix_k3
        )
        notes = _write_notes(calibration)
        status = CameraStatus.OK
        disagreement = _compare_baseline(session, calibration)
        if disagreement:
            notes.append(disagreement)
            status = CameraStatus.BASELINES_DISAGREE
        return CameraEstimate(calibration.rig, (), status, tuple(notes))


def _detect_all(
    session: Session, board: Chessboard, sizes: Mapping[str, tuple[int, int]], refine_px: int
) -> tuple[_Corners, list[str]]:
    """Corners by view, and the names of the pairs."""
    patterns = board.images or {}
    missing = [view for view in sizes if view not in patterns]
    if missing:
        raise CameraError(f"chessboard.images: expected a pattern for every view, got none for {missing}; add them")
    try:
        files = {view: find_images(session.resolve_pattern(patterns[view])) for view in sizes}
    except VideoError as error:
        raise CameraError(f"chessboard.images: {error}") from error
    counts = {view: len(paths) for view, paths in files.items()}
    if len(set(counts.values())) != 1:
        raise CameraError(
            f"chessboard.images: expected as many pictures in every view, got {counts}; "
            "remove pictures without a partner, because pairs are made in the order of the file names"
        )
    corners = {}
    for view, paths in files.items():
        detections = detect_corners(_read_images(paths, sizes[view]), board.pattern, refine_px=refine_px)
        corners[view] = [detection.corners for detection in detections]
    return corners, ["/".join(path.stem for path in row) for row in zip(*files.values(), strict=True)]


def _read_images(paths: Sequence[Path], size: tuple[int, int]) -> Iterator[LumaArray]:
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise CameraError(
                f"{path}: expected a picture of 8 or 16 bit, got none that can be read; remove or replace it"
            )
        found = (image.shape[1], image.shape[0])
        if found != size:
            raise CameraError(
                f"{path}: expected {size[0]} x {size[1]} pixels as in the recording, got {found[0]} x {found[1]}; "
                "take the chessboard pictures with the mode of the recording"
            )
        yield np.asarray(image, np.uint8) if image.dtype == np.uint8 else np.asarray(image, np.uint16)


def _read_corners(path: Path, board: Chessboard, views: tuple[str, ...]) -> tuple[_Corners, FloatArray]:
    """Corners by view [px] and on the board, shape (N, 2) [m]."""
    arrays = _read_arrays(path)
    missing = [name for name in (*views, "board_xy_mm") if name not in arrays]
    if missing:
        raise CameraError(f"{path}: expected arrays {[*views, 'board_xy_mm']}, got no {missing}; add them")
    board_mm = arrays["board_xy_mm"]
    count = board.pattern[0] * board.pattern[1]
    if board_mm.shape != (count, 2):
        raise CameraError(
            f"{path}: expected board_xy_mm of shape ({count}, 2) for pattern {list(board.pattern)}, "
            f"got {board_mm.shape}; correct the pattern or the file"
        )
    spacing = np.linalg.norm(board_mm[1:] - board_mm[0], axis=-1).min()
    if not np.isclose(spacing, board.square_mm, rtol=1e-3):
        raise CameraError(
            f"{path}: expected corners {board.square_mm:g} mm apart as in the session, got {spacing:g} mm; "
            "correct square_mm or the file"
        )
    corners = {}
    for view in views:
        if arrays[view].ndim != 3 or arrays[view].shape[1:] != (count, 2):
            raise CameraError(
                f"{path}: expected {view!r} of shape (poses, {count}, 2), got {arrays[view].shape}; reshape it"
            )
        corners[view] = list(arrays[view])
    return corners, board_mm * 1e-3


def _read_arrays(path: Path) -> dict[str, FloatArray]:
    try:
        archive = np.load(path, allow_pickle=False)
        if isinstance(archive, NpzFile):
            with archive:
                return {name: np.asarray(archive[name], dtype=np.float64) for name in archive.files}
    except (OSError, ValueError, BadZipFile) as error:
        raise CameraError(f"{path}: expected an npz file of numbers, got none that can be read; {error}") from error
    raise CameraError(f"{path}: expected an npz file of numbers, got a single array; save it with numpy.savez")


def _write_notes(calibration: ChessboardCalibration) -> list[str]:
    """Sentences about the used, dropped and reordered pairs."""
    used, dropped = len(calibration.reprojection_error), len(calibration.dropped)
    rms = ", ".join(f"{view} {value:.3f}" for view, value in calibration.rms.items())
    notes = [
        f"chessboard: {used} pairs used, {dropped} dropped; reprojection error {rms} px; baseline "
        f"{calibration.baseline_m * 1e3:.3f} mm with standard deviation {calibration.baseline_std_m * 1e3:.3f} mm"
    ]
    notes += [f"chessboard pair {name} dropped: {reason}" for name, reason in calibration.dropped.items()]
    notes += [f"chessboard pair {name}: corners turned in one view, put in order" for name in calibration.reordered]
    if calibration.pose_scatter > 1:
        notes.append(
            "chessboard: the pictures contradict each other more than independent corner errors would; variances are "
            f"{calibration.pose_scatter:.1f} times those of independent errors on average"
        )
    return notes


def _compare_baseline(session: Session, calibration: ChessboardCalibration) -> str:
    """A sentence where the measured baseline contradicts the chessboard's, else nothing."""
    measured = session.site.baseline
    if measured is None:
        return ""
    std = float(np.hypot(measured.std, calibration.baseline_std_m))
    difference = abs(measured.value - calibration.baseline_m)
    if difference <= _DISAGREEMENT * std:
        return ""
    return (
        f"chessboard: baseline {calibration.baseline_m:.4f} m, measured {measured.value:.4f} m: they differ by "
        f"{difference / std:.1f} standard deviations; check the size of the squares and the tape"
    )
