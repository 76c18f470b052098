"""Cameras from the first frames of two or more views, without a calibration object.

The classical stand-in for the paper's section "VFM-based sparse-view camera parameter estimation": features on the
first frames, a robust relative pose, and priors for everything that two views of one spot cannot tell.
"""

from collections.abc import Mapping
from dataclasses import replace
from glob import glob

import numpy as np
import poselib

from vfm_sdm.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.cameras.base import CameraEstimate, Matches
from vfm_sdm.cameras.features import match_features
from vfm_sdm.cameras.file import read_camera
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.session import Session, View, lens_from_exif

__all__ = ["TOO_FEW_MATCHES", "TwoViewCameras", "estimate_relative_pose"]

TOO_FEW_MATCHES = "too few matches between the views"

_MIN_INLIERS = 30
_UNKNOWN_FOCAL = 1.2
"""Focal length over the longer image side where nothing is known: a normal lens. Only a place to start from; its
standard deviation below says that it is no knowledge."""
_UNKNOWN_FOCAL_STD = 0.5
_CALIBRATED_STD = 0.003
_PRINCIPAL_POINT_STD = 0.015
"""Principal point from the image centre, over the image diagonal: usual for lenses that are not calibrated."""
_CORNER_DISTORTION_STD = 0.025
"""Radial distortion at the image corner, over the radius: usual for lenses that are not wide-angle."""
_ROTATION_STD = 1.0
_TRANSLATION_STD = 2.0


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
        if len(frames) < 2:
            raise CameraError(f"two-view: expected at least two views, got {list(frames)}; add a [[view]]")
        baseline = session.site.baseline
        if baseline is None:
            raise CameraError("two-view: expected site.baseline, got none; measure the distance between the cameras")
        names = tuple(frames)
        views = {view.name: view for view in session.view}
        intrinsics, covariances, notes = [], [], []
        for name, luma in frames.items():
            camera, std, note = _prior_camera(session, views[name], (luma.shape[1], luma.shape[0]))
            intrinsics.append(camera)
            covariances.append(std)
            notes += [note] if note else []
        cameras, matches = [intrinsics[0]], []
        for index in range(1, len(names)):
            found = match_features(frames[names[0]], frames[names[index]])
            pose, inliers = estimate_relative_pose(*found, intrinsics[0], intrinsics[index])
            if inliers.sum() < _MIN_INLIERS:
                notes.append(
                    f"{names[0]} and {names[index]}: {int(inliers.sum())} of {len(inliers)} matches agree, "
                    f"{_MIN_INLIERS} are needed; choose views that overlap more"
                )
                return CameraEstimate(None, (), TOO_FEW_MATCHES, tuple(notes))
            cameras.append(replace(intrinsics[index], cam_from_world=pose))
            matches.append(Matches(0, index, found[0][inliers], found[1][inliers]))
            covariances[index][4:] = [_ROTATION_STD] * 3 + [_TRANSLATION_STD * baseline.value] * 3
        rig = Rig(names, tuple(cameras), False, np.diag(np.concatenate(covariances) ** 2))
        # The baseline is the distance of the first two views; it scales all of them (s = B_true / B_est). The prior of
        # the translations is stated in metres already.
        scaled = replace(rig.scaled(baseline.value / rig.baseline()), covariance=rig.covariance)
        return CameraEstimate(scaled, tuple(matches), "ok", tuple(notes))


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


def _prior_camera(session: Session, view: View, image_size: tuple[int, int]) -> tuple[Camera, FloatArray, str]:
    """What is known of a view's camera before looking: intrinsics, std of its ten parameters, a note."""
    width, height = image_size
    diagonal = float(np.hypot(width, height))
    if view.camera is not None:
        known = read_camera(session.resolve(view.camera), view.name, image_size=image_size)
        if known.image_size != image_size:
            raise CameraError(
                f"camera of view {view.name!r}: expected an image size of {image_size}, got {known.image_size}; "
                "calibrate at the size of the recording"
            )
        corner = diagonal / 2 / known.focal_px
        std = [_CALIBRATED_STD, 0.001 * diagonal, 0.001 * diagonal, 0.002 / corner**2, *[0.0] * 6]
        return replace(known, cam_from_world=np.eye(3, 4)), np.array(std), ""
    lens, note = view.lens, ""
    if lens is None and view.images is not None:
        first_image = min(glob(session.resolve_pattern(view.images)), default=None)
        lens = lens_from_exif(first_image) if first_image else None
        note = f"view {view.name!r}: focal length from EXIF, known to 5 %" if lens is not None else ""
    if lens is None:
        focal, relative_std = _UNKNOWN_FOCAL * max(width, height), _UNKNOWN_FOCAL_STD
        note = f"view {view.name!r}: nothing known of the lens; state `lens` in the session"
    else:
        focal, relative_std = lens.focal_prior_px(max(image_size)), lens.relative_std
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    corner = diagonal / 2 / focal
    centre_std = _PRINCIPAL_POINT_STD * diagonal
    std = [relative_std, centre_std, centre_std, _CORNER_DISTORTION_STD / corner**2, *[0.0] * 6]
    return Camera(K, image_size), np.array(std), note
