"""Cameras from the first frames of two or more views, without a calibration object.

The classical stand-in for the paper's section "VFM-based sparse-view camera parameter estimation": features on the
first frames, a robust relative pose, and priors for everything that two views of one spot cannot tell.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import poselib

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.matching.features import match_features
from vfm_sdm.stages.matching.matches import Matches

__all__ = [
    "MIN_INLIERS",
    "NO_COMMON_SCALE",
    "TOO_FEW_MATCHES",
    "RelatedView",
    "TwoViewCameras",
    "estimate_relative_pose",
    "relate_to_first",
]

TOO_FEW_MATCHES = "too few matches between the views"
NO_COMMON_SCALE = "too few points seen in three views"

MIN_INLIERS = 30
"""Matches that agree with one pose from which a pair of views counts as related."""


class TwoViewCameras:
    """Estimator ``two-view``.

    Notes
    -----
    Every further view is related to the first by its matches; how far away it stands, beside the second, follows from
    points that both see. The covariance of the result is the prior for the adjustment on site: focal length from the
    lens, the camera's file or EXIF, principal point and radial distortion as nuisance parameters, and a relative pose
    that is free.
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
        names, first = priors.names, priors.cameras[0]
        related: list[RelatedView] = []
        for view in relate_to_first(frames, priors.cameras):
            if view.fault:
                return CameraEstimate(None, (), TOO_FEW_MATCHES, (*priors.notes, view.fault))
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
                return CameraEstimate(None, (), NO_COMMON_SCALE, (*priors.notes, note))
            pose = view.camera.cam_from_world * np.array([1.0, 1.0, 1.0, np.median(ratios)])
            cameras[index] = replace(view.camera, cam_from_world=pose)
            matches.append(common)
        return CameraEstimate(priors.metric_rig(cameras), tuple(matches), "ok", priors.notes)


@dataclass(frozen=True, eq=False)
class RelatedView:
    """A view beside the first one.

    Parameters
    ----------
    camera
        With its pose in the first camera's frame, at a distance of one.
    matches
        Features of both that agree with this pose.
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
        Intrinsics and distortion of each.
    """
    names, images = list(frames), list(frames.values())
    for index in range(1, len(images)):
        first, second = match_features(images[0], images[index])
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
