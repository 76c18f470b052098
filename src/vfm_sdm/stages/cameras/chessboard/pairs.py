"""Pictures of a board that can be used together, and the start that they give an adjustment."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, as_float_array
from vfm_sdm.core.statuses import BoardStatus
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.poses import pose_array
from vfm_sdm.stages.cameras.chessboard.order import agree_on_order, board_symmetries
from vfm_sdm.stages.cameras.chessboard.scene import INTRINSICS, BoardScene

__all__ = ["MIN_POSES", "PairSet"]

MIN_POSES = 3
"""Least number of poses; fewer poses of a plane do not determine focal length and principal point."""

_MIN_CORNERS = 8
_FAR_ABOVE = 2.5
"""Reprojection error over the median of all, above which a pair is dropped."""
_ERROR_FLOOR_PX = 0.1
"""Reprojection error below which no pair is dropped."""


class PairSet:
    """Corners of all views and poses, with the pairs of views that are still in use.

    Every view is paired with the first; a single view's pictures count as pairs of their own.

    Parameters
    ----------
    corners_by_view
        Corners by view: for each picture an array of shape (N, 2) [px], NaN for hidden corners, or ``None`` where the
        board was not found.
    board
        Corners in the board's plane, shape (N, 2) [m].
    image_sizes
        Width and height by view name [px].
    names
        Names of the poses; they are numbered when not given.

    Raises
    ------
    CameraError
        Views or names differ in number of pictures, or corners lie outside the image.
    """

    def __init__(
        self,
        corners_by_view: Mapping[str, Sequence[FloatArray | None]],
        board: FloatArray,
        image_sizes: Mapping[str, tuple[int, int]],
        names: Sequence[str] | None,
    ) -> None:
        counts = {view: len(corners) for view, corners in corners_by_view.items()}
        if names is not None:
            counts["names"] = len(names)
        if len(set(counts.values())) != 1:
            raise CameraError(
                f"chessboard: expected as many pictures in every view, got {counts}; "
                "remove pictures without a partner, so that equal places show the same pose of the board"
            )
        self.views = tuple(corners_by_view)
        kind = "pair" if len(self.views) > 1 else "picture"
        numbered = [f"{kind} {index + 1}" for index in range(next(iter(counts.values())))]
        self.names = tuple(numbered if names is None else names)
        self.board = board
        self.image_sizes = image_sizes
        self.points2d = np.stack(
            [_stack_corners(corners, len(board), image_sizes[view], view) for view, corners in corners_by_view.items()],
            axis=1,
        )
        self.dropped: dict[str, str] = {}
        self.reordered: list[str] = []
        self._links = np.ones((len(self.names), len(self.views)), dtype=bool)
        self._links[:, 0] = len(self.views) == 1
        self._drop_unseen()

    @property
    def used(self) -> BoolArray:
        """Whether a view's picture of a pose is in use, shape (P, V)."""
        used = self._links.copy()
        used[:, 0] = self._links.any(axis=1)
        return used

    def label(self, pose: int, view: int) -> str:
        """Name of a pair for messages and results.

        Parameters
        ----------
        pose, view
            Index of the board's pose, and of the view that is paired with the first.

        Returns
        -------
        label
            Name of the pose; with more than two views also the names of the two views.
        """
        return self.names[pose] if len(self.views) <= 2 else f"{self.names[pose]} ({self.views[0]}, {self.views[view]})"

    def start(self, free_intrinsics: IntArray) -> tuple[BoardScene, FloatArray]:
        """Approximate scene of the poses in use, and their corners.

        Pairs that cannot be used are dropped on the way, and corners that came turned are put in order.

        Parameters
        ----------
        free_intrinsics
            Indices into `vfm_sdm.stages.cameras.chessboard.scene.INTRINSICS` of the parameters that are estimated.

        Returns
        -------
        scene
            Cameras, and the P' poses of the board that are in use.
        points2d
            Corners of these poses, shape (P', V, N, 2) [px]; NaN where a picture is not in use.

        Raises
        ------
        CameraError
            Too few pairs remain.
        """
        while True:
            self._require_enough()
            alone = [_CameraAlone(self, view, free_intrinsics) for view in range(len(self.views))]
            if self._drop_worst(np.stack([camera.errors for camera in alone], axis=1)):
                continue
            orders = [self._agree_on_pose(alone[0], alone[view], view) for view in range(1, len(self.views))]
            if any(changed for changed, _ in orders):
                continue
            kept = self.used.any(axis=1)
            scene = BoardScene(
                np.stack([camera.intrinsics for camera in alone]),
                np.stack([np.eye(3, 4), *(pose for _, pose in orders)]),
                alone[0].cam_from_board[kept],
                np.column_stack([self.board, np.zeros(len(self.board))]),
            )
            return scene, np.where(self.used[..., None, None], self.points2d, np.nan)[kept]

    def drop_worst(self, errors: FloatArray) -> bool:
        """Whether a pair's reprojection error was far above the others, so that it was dropped.

        Parameters
        ----------
        errors
            Root mean square error of each picture in use, shape (P', V) [px].

        Returns
        -------
        dropped
            Whether there was such a pair; the remaining ones then have to be adjusted anew.
        """
        everything = np.full(self.used.shape, np.nan)
        everything[self.used.any(axis=1)] = errors
        return self._drop_worst(everything)

    def _drop_worst(self, errors: FloatArray) -> bool:
        limit = max(_FAR_ABOVE * float(np.nanmedian(errors)), _ERROR_FLOOR_PX)
        # A pair is as bad as the worse of its two pictures.
        by_link = np.where(self._links, np.fmax(errors, errors[:, :1]), -np.inf)
        pose, view = np.unravel_index(int(np.nanargmax(by_link)), by_link.shape)
        worst = float(by_link[pose, view])
        if worst <= limit:
            return False
        self._drop(
            int(pose), int(view), f"reprojection error {worst:.2f} px, far above the others (limit {limit:.2f} px)"
        )
        return True

    def _drop(self, pose: int, view: int, reason: str) -> None:
        label = self.label(pose, view)
        self._links[pose, view] = False
        self.dropped[label] = reason
        if label in self.reordered:
            self.reordered.remove(label)

    def _drop_unseen(self) -> None:
        count = np.isfinite(self.points2d).all(axis=-1).sum(axis=-1)
        for pose, view in np.argwhere(self._links):
            short = [v for v in dict.fromkeys((0, int(view))) if count[pose, v] < _MIN_CORNERS]
            if short:
                names = " and ".join(repr(self.views[v]) for v in short)
                none = not count[pose, short].any()
                what = "no corners" if none else f"fewer than {_MIN_CORNERS} corners"
                self._drop(int(pose), int(view), f"{what} in {names}")

    def _require_enough(self) -> None:
        columns = range(1, len(self.views)) if len(self.views) > 1 else [0]
        counts = {self.views[view]: int(self._links[:, view].sum()) for view in columns}
        short = [view for view, count in counts.items() if count < MIN_POSES]
        if short:
            why = "; ".join(f"{name}: {reason}" for name, reason in self.dropped.items()) or "none dropped"
            raise CameraError(
                f"chessboard: expected at least {MIN_POSES} usable pairs for {short}, got "
                f"{[counts[view] for view in short]} of {len(self.names)} ({why}); take more pictures of the board"
            )

    def _agree_on_pose(self, first: "_CameraAlone", second: "_CameraAlone", view: int) -> tuple[bool, FloatArray]:
        """Whether pairs were dropped or reordered, and the relative pose on which the rest agrees, shape (3, 4)."""
        poses = self._links[:, view].nonzero()[0]
        order = agree_on_order(first.cam_from_board[poses], second.cam_from_board[poses], self.board)
        symmetries = board_symmetries(self.board)
        changed = False
        for pose, turn, reason in zip(poses, order.turns, order.reasons, strict=True):
            label = self.label(int(pose), view)
            if turn != 0 and label in self.reordered:
                # Turned back and forth: two orders explain it, and the loop would not end.
                self._drop(int(pose), view, BoardStatus.AMBIGUOUS_ORDER)
            elif reason:
                self._drop(int(pose), view, reason)
            elif turn != 0:
                onto = symmetries[turn][1]
                self.points2d[pose, view, onto] = self.points2d[pose, view].copy()
                self.reordered.append(label)
            changed = changed or bool(reason) or turn != 0
        return changed, order.second_from_first


class _CameraAlone:
    """OpenCV's calibration of one view by itself."""

    intrinsics: FloatArray  # (9,)
    cam_from_board: FloatArray  # (P, 3, 4), NaN where not used
    errors: FloatArray  # (P,) px, NaN where not used

    def __init__(self, pairs: PairSet, view: int, free_intrinsics: IntArray) -> None:
        flags = 0 if 6 in free_intrinsics else cv2.CALIB_ZERO_TANGENT_DIST
        flags |= 0 if 8 in free_intrinsics else cv2.CALIB_FIX_K3
        poses = pairs.used[:, view].nonzero()[0]
        seen = [np.isfinite(pairs.points2d[pose, view]).all(axis=-1) for pose in poses]
        flat = np.column_stack([pairs.board, np.zeros(len(pairs.board))])
        try:
            _, K, distortion, rotations, translations, _, _, errors = cv2.calibrateCameraExtended(
                [flat[mask].astype(np.float32) for mask in seen],
                [pairs.points2d[pose, view, mask].astype(np.float32) for pose, mask in zip(poses, seen, strict=True)],
                pairs.image_sizes[pairs.views[view]],
                np.eye(3),
                np.zeros(5),
                flags=flags,
            )
        except cv2.error as error:
            raise CameraError(
                f"chessboard: expected corners of a flat board in {pairs.views[view]!r}, OpenCV could not start from "
                f"them ({error.err}); check the pattern and the order of the corners"
            ) from error
        self.intrinsics = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(distortion)[: len(INTRINSICS) - 4]])
        shape = pairs.points2d.shape[:1]
        self.cam_from_board = np.full((*shape, 3, 4), np.nan)
        turned = Rotation.from_rotvec(np.reshape(rotations, (-1, 3)))
        found = RigidTransform.from_components(np.reshape(translations, (-1, 3)), turned)
        self.cam_from_board[poses] = pose_array(found)
        self.errors = np.full(shape, np.nan)
        self.errors[poses] = np.ravel(errors)


def _stack_corners(
    corners: Sequence[FloatArray | None], count: int, image_size: tuple[int, int], view: str
) -> FloatArray:
    """Corners of one view, shape (P, N, 2) [px], NaN where there are none."""
    stacked = np.full((len(corners), count, 2), np.nan)
    for index, found in enumerate(corners):
        if found is not None:
            stacked[index] = as_float_array(found, f"corners of {view!r}, picture {index + 1}", (count, 2))
    outside = (stacked < -0.5) | (stacked > np.array(image_size) - 0.5)
    if outside.any():
        pose, corner = np.argwhere(outside)[0][:2]
        raise CameraError(
            f"corners of {view!r}, picture {pose + 1}: expected pixels inside the image of {image_size[0]} x "
            f"{image_size[1]}, got {stacked[pose, corner].round(1).tolist()}; calibrate at the size of the recording"
        )
    return stacked
