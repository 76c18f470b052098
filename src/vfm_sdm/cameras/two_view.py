"""Cameras from the first frames of two or more views, without a calibration object.

The classical stand-in for the paper's section "VFM-based sparse-view camera parameter estimation": features on the
first frames, a robust relative pose, and priors for everything that two views of one spot cannot tell.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import poselib

from vfm_sdm.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.cameras.base import CameraEstimate, Matches
from vfm_sdm.cameras.features import match_features
from vfm_sdm.cameras.priors import read_priors
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.session import Session

__all__ = ["MIN_INLIERS", "TOO_FEW_MATCHES", "TwoViewCameras", "estimate_relative_pose"]

TOO_FEW_MATCHES = "too few matches between the views"

MIN_INLIERS = 30
"""Matches that agree with one pose from which a pair of views counts as related."""


class TwoViewCameras:
    """Estimator ``two-view``.

    Notes
    -----
    Every further view is related to the first by its matches. The covariance of the result is the prior for the
    adjustment on site: focal length from the lens, the camera's file or EXIF, principal point and radial distortion as
    nuisance parameters, and a relative pose that is free.
    """

    name = "two-view"

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Rig with the tape's baseline, its prior covariance, and the inlier matches.

        Parameters
        ----------
        session
            Lens priors and baseline.
        frames
            First frame of every view, in the session's order.

        Raises
        ------
        CameraError
            Fewer than two views, or no baseline in the session.
        """
        priors = read_priors(session, frames, estimator=self.name)
        names, intrinsics, notes = priors.names, priors.cameras, list(priors.notes)
        cameras, matches = [intrinsics[0]], []
        for index in range(1, len(names)):
            found = match_features(frames[names[0]], frames[names[index]])
            pose, inliers = estimate_relative_pose(*found, intrinsics[0], intrinsics[index])
            if inliers.sum() < MIN_INLIERS:
                notes.append(
                    f"{names[0]} and {names[index]}: {int(inliers.sum())} of {len(inliers)} matches agree, "
                    f"{MIN_INLIERS} are needed; choose views that overlap more"
                )
                return CameraEstimate(None, (), TOO_FEW_MATCHES, tuple(notes))
            cameras.append(replace(intrinsics[index], cam_from_world=pose))
            matches.append(Matches(0, index, found[0][inliers], found[1][inliers]))
        return CameraEstimate(priors.metric_rig(cameras), tuple(matches), "ok", tuple(notes))


def estimate_relative_pose(
    points_first: FloatArray, points_second: FloatArray, first: Camera, second: Camera
) -> tuple[FloatArray, BoolArray]:
    """Pose of the second camera in the first one's frame, with unit translation, and the matches that agree.

    Parameters
    ----------
    points_first, points_second
        Shape (N, 2) [px].
    first, second
        Intrinsics and distortion.

    Returns
    -------
    cam2_from_cam1
        Shape (3, 4).
    inliers
        Shape (N,); all False when no pose was found.

    Notes
    -----
    LO-RANSAC over the five-point solver, as in PoseLib, on undistorted pixels. The threshold is wide (a thousandth of
    the image width) because the focal lengths may still be some per cent off.
    """
    if len(points_first) < 8:
        return np.eye(3, 4), np.zeros(len(points_first), dtype=bool)
    threshold = max(1.0, 1e-3 * first.image_size[0])
    pixels = [
        c.normalize(points) * [c.K[0, 0], c.K[1, 1]] + c.K[:2, 2]
        for c, points in ((first, points_first), (second, points_second))
    ]
    pose, info = poselib.estimate_relative_pose(
        *pixels,
        *(_poselib_camera(c) for c in (first, second)),
        {"max_epipolar_error": threshold, "max_iterations": 20000, "min_iterations": 500, "seed": 0},
        {},
    )
    translation = np.asarray(pose.t, dtype=np.float64)
    length = float(np.linalg.norm(translation))
    inliers = np.asarray(info["inliers"], dtype=bool)
    if length == 0:
        return np.eye(3, 4), np.zeros(len(points_first), dtype=bool)
    return np.column_stack([np.asarray(pose.R), translation / length]), inliers


def _poselib_camera(camera: Camera) -> dict[str, object]:
    width, height = camera.image_size
    K = camera.K
    return {"model": "PINHOLE", "width": width, "height": height, "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}
