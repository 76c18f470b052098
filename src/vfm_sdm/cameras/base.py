"""What a camera estimator is, what it returns, and how one is found by name."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from vfm_sdm.arrays import FloatArray, LumaArray, as_float_array
from vfm_sdm.backends import Backend, find_backend
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.session import Method, Session

__all__ = ["ESTIMATORS", "CameraEstimate", "CameraEstimator", "Matches", "estimator_of", "find_estimator"]

ESTIMATORS = {
    "file": Backend("vfm_sdm.cameras.file", "FileCameras"),
    "chessboard": Backend("vfm_sdm.cameras.chessboard", "ChessboardCameras"),
    "two-view": Backend("vfm_sdm.cameras.two_view", "TwoViewCameras"),
    "vggt": Backend("vfm_sdm.cameras.vggt", "VggtCameras", ("network",)),
    "sfm": Backend("vfm_sdm.cameras.sfm", "SfmCameras", ("sfm",)),
}
"""Every estimator by its name."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Pixels of the same scene points in two views.

    Parameters
    ----------
    first, second
        Indices of the two views in the rig; they differ.
    points_first, points_second
        Shape (N, 2) each [px], full-image pixels; row i of both is the same scene point.

    Raises
    ------
    CameraError
        The two views are the same or negative, or the two arrays differ in length.
    DatasetError
        An array is not of shape (N, 2).
    """

    first: int
    second: int
    points_first: FloatArray
    points_second: FloatArray

    def __post_init__(self) -> None:
        if self.first == self.second or min(self.first, self.second) < 0:
            raise CameraError(
                f"matches: expected two different views, got {self.first} and {self.second}; "
                "give the index of each view in the rig"
            )
        for name in ("points_first", "points_second"):
            frozen = as_float_array(getattr(self, name), name, (None, 2)).copy()
            frozen.flags.writeable = False
            object.__setattr__(self, name, frozen)
        if len(self.points_first) != len(self.points_second):
            raise CameraError(
                f"matches: expected as many points in both views, got {len(self.points_first)} and "
                f"{len(self.points_second)}; keep only the points found in both"
            )

    def __len__(self) -> int:
        return len(self.points_first)


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """Cameras of all views as an estimator found them.

    Parameters
    ----------
    rig
        Cameras in the order of the session's views, the first one the reference. ``rig.covariance`` is ordered as
        `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, ten parameters a camera. ``None`` where the images did not allow
        an estimate; the status says why.
    matches
        What was matched between views, for later adjustment; empty where the estimator matched nothing.
    status
        ``"ok"``, or the name of what makes the estimate doubtful or impossible.
    notes
        Sentences for the summary and the audit.
    """

    rig: Rig | None
    matches: tuple[Matches, ...] = ()
    status: str = "ok"
    notes: tuple[str, ...] = ()


class CameraEstimator(Protocol):
    """Finds the cameras of a session's views."""

    name: str

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Cameras of all views.

        Parameters
        ----------
        session
            The measurement session.
        frames
            First frame of each view by view name, in the session's order; shape (H, W) each.

        Raises
        ------
        CameraError
            The input does not suffice for an estimate.
        """
        ...


def estimator_of(method: Method) -> CameraEstimator:
    """The camera estimator that a session asks for, with the session's settings.

    Raises
    ------
    BackendUnavailableError
        No estimator has this name, or it cannot run here.
    """
    estimator: CameraEstimator = find_backend(ESTIMATORS, "cameras", method.cameras).make_for(method)
    return estimator


def find_estimator(name: str, **options: Any) -> CameraEstimator:
    """The camera estimator of this name, made with the given options.

    Raises
    ------
    BackendUnavailableError
        No estimator has this name, or it cannot run here.
    """
    estimator: CameraEstimator = find_backend(ESTIMATORS, "cameras", name).make(**options)
    return estimator
