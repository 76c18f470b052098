"""Cameras from the first frames of two or more views, without a calibration object.

The classical stand-in for the paper's section "VFM-based sparse-view camera parameter estimation": features on the
first frames, a robust relative pose, and priors for everything that two views of one place cannot tell.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import poselib

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.matching.features import match_features
from vfm_sdm.stages.matching.matches import Matches

__all__ = [
    "MIN_INLIERS",
    "RelatedView",
    "TwoViewCameras",
    "estimate_relative_pose",
    "relate_to_first",
]


MIN_INLIERS = 30
"""Number of matches in agreement with one pose from which a pair of views counts as related."""


class TwoViewCameras:
    """Estimator ``two-view``: robust relative poses of views from matched features.

    Notes
    -----
    Every further view is related to the first by its matches; its distance over that of the second view follows from
    points that all three see. The covariance of the result is the prior for the adjustment on site: focal length from
    the lens, the camera's file or EXIF, principal point and radial distortion as nuisance parameters, and a relative
    pose that is free.
    """

    name = "two-view"

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Rig with the measured baseline, its prior covariance, and the inlier matches.

        Parameters
        ----------
        session
            Lens priors and baseline [m].
        frames
            First frame of every view, shape (H, W), in the session's order.

        Raises
        ------
        CameraError
            Fewer than two views, or no baseline in the session.
        """
        priors = read_priors(session, frames, estimator=self.name)
        names, first = priors.names, priors.cameras[0]
        related: list[RelatedView] = []
        for view in relate_to_first(frames, priors.cameras):
            if view.fault:
                return CameraEstimate(None, (), CameraStatus.TOO_FEW_MATCHES, (*priors.notes, view.fault))
            related.append(view)
        cameras = [first, *(view.camera for view in related)]
        matches = [view.matches for view in related]
        for index, view in enumerate(related[1:], start=2):
            ratios, common = _compare_distances(first, related[0], view)
            if len(common) < MIN_INLIERS:
                note = (
                    f"{names[0]}, {names[1]} and {names[index]}: {len(common)} matches go through all three, "
                    f"{MIN_INLIERS} are needed; choose views that overlap more"
                )
                return CameraEstimate(None, (), CameraStatus.NO_COMMON_SCALE, (*priors.notes, note))
            pose = view.camera.cam_from_world * np.array([1.0, 1.0, 1.0, np.median(ratios)])
            cameras[index] = replace(view.camera, cam_from_world=pose)
            matches.append(common)
        return CameraEstimate(priors.metric_rig(cameras), tuple(matches), CameraStatus.OK, priors.notes)


@dataclass(frozen=True, eq=False)
class RelatedView:
    """A view beside the first one.

    Parameters
    ----------
    camera
        The camera with its pose in the first camera's frame, at a distance of one baseline.
    matches
        Features of both views that agree with this pose.
    fault
        Why the two do not count as related, in a sentence; empty where they do.
    """

    camera: Camera
    matches: Matches
    fault: str


def relate_to_first(frames: Mapping[str, LumaArray], cameras: Sequence[Camera]) -> Iterator[RelatedView]:
    """Every further view beside the first one, each by itself.

    Parameters
    ----------
    frames
        Luma by view name, shape (H, W) each.
    cameras
        Intrinsics and distortion of each [px, 1].
    """
    names, images = list(frames), list(frames.values())
    for index in range(1, len(images)):
        found = match_features(images[0], images[index])
        first, second = found.points_first, found.points_second
        pose, agree = estimate_relative_pose(first, second, cameras[0], cameras[index])
        count, fault = int(agree.sum()), ""
        if count < MIN_INLIERS:
            fault = (
                f"{names[0]} and {names[index]}: {count} of {len(agree)} matches agree, {MIN_INLIERS} are needed; "
                "choose views that overlap more"
            )
        posed = replace(cameras[index], cam_from_world=pose)
        yield RelatedView(posed, Matches(0, index, first[agree], second[agree]), fault)


def _compare_distances(first: Camera, second: RelatedView, other: RelatedView) -> tuple[FloatArray, Matches]:
    """The other view's distance over the second's, from every point that all three see, and its pixels in these two.

    Without those pixels the adjustment on site would not know the ratio.
    """
    pair = (second.matches, other.matches)
    # Each pair found the first view's features by itself, at the same places to the last digit.
    places = [np.ascontiguousarray(matches.points_first).view(np.complex128)[:, 0] for matches in pair]
    _, row, other_row = np.intersect1d(places[0], places[1], return_indices=True)
    u = np.stack([pair[0].points_first[row], pair[0].points_second[row], pair[1].points_second[other_row]])
    # Each depth is in units of its pair's distance: the farther pair gives the smaller one.
    depth = triangulate(u[[0, 1]], Rig(("first", "second"), (first, second.camera)))[:, 2]
    other_depth = triangulate(u[[0, 2]], Rig(("first", "other"), (first, other.camera)))[:, 2]
    ahead = (depth > 0) & (other_depth > 0)
    return (depth / other_depth)[ahead], Matches(pair[0].second, pair[1].second, u[1, ahead], u[2, ahead])


def estimate_relative_pose(
    points_first: FloatArray, points_second: FloatArray, first: Camera, second: Camera
) -> tuple[FloatArray, BoolArray]:
    """Pose of the second camera in the first one's frame, with unit translation, and the matches that agree.

    Parameters
    ----------
    points_first, points_second
        Matched pixels in the two views, shape (N, 2) [px].
    first, second
        Intrinsics and distortion of the cameras.

    Returns
    -------
    cam2_from_cam1
        Rotation and unit translation, shape (3, 4) [1].
    inliers
        Which matches agree, shape (N,); all False when no pose was found.

    Notes
    -----
    LO-RANSAC [2]_ over the five-point solver [1]_, as in PoseLib, on undistorted pixels. The threshold is wide (a
    thousandth of the image width) because the focal lengths may still be some per cent off.

    References
    ----------
    .. [1] Nistér, D. (2004). An efficient solution to the five-point relative pose problem. IEEE Transactions on
       Pattern Analysis and Machine Intelligence 26(6), 756-770.
    .. [2] Chum, O., Matas, J., Kittler, J. (2003). Locally optimized RANSAC. DAGM Symposium on Pattern Recognition.

    Examples
    --------
    >>> first = Camera(np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]]), (640, 480))
    >>> second = Camera(first.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> points3d = np.random.default_rng(0).uniform([-3, -2, 10], [3, 2, 20], (50, 3))
    >>> pose, inliers = estimate_relative_pose(first.project(points3d), second.project(points3d), first, second)
    >>> bool(np.allclose(pose[:, 3], [-1, 0, 0], atol=1e-4)), int(inliers.sum())
    (True, 50)
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
        *(_make_poselib_camera(c) for c in (first, second)),
        {"max_epipolar_error": threshold, "max_iterations": 20000, "min_iterations": 500, "seed": 0},
        {},
    )
    translation = np.asarray(pose.t, dtype=np.float64)
    length = float(np.linalg.norm(translation))
    inliers = np.asarray(info["inliers"], dtype=bool)
    if length == 0:
        return np.eye(3, 4), np.zeros(len(points_first), dtype=bool)
    return np.column_stack([np.asarray(pose.R), translation / length]), inliers


def _make_poselib_camera(camera: Camera) -> dict[str, object]:
    """PoseLib's camera with the intrinsics of ours [px], without distortion."""
    width, height = camera.image_size
    K = camera.K
    return {"model": "PINHOLE", "width": width, "height": height, "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}
