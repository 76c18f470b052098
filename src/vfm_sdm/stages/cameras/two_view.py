"""Cameras from the first frames of two or more views, without a calibration object.

The classical stand-in for the paper's section "VFM-based sparse-view camera parameter estimation": features on the
first frames, a robust relative pose, and priors for everything that two views of one place cannot tell.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.base import CameraEstimate, Hypothesis
from vfm_sdm.stages.cameras.priors import CameraPriors, read_priors
from vfm_sdm.stages.cameras.related_views import MIN_INLIERS, RelatedView, relate_to_first
from vfm_sdm.stages.matching.base import FeatureMatcher
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["TwoViewCameras"]


class TwoViewCameras:
    """Estimator ``two-view``: robust relative poses of views from matched features.

    Parameters
    ----------
    features
        What matches features; SIFT by default.

    Notes
    -----
    Every further view is related to the first by its matches; its distance over that of the second view follows from
    points that all three see. The covariance of the result is the prior for the adjustment on site: focal length from
    the lens, the camera's file or EXIF, principal point and radial distortion as nuisance parameters, and a relative
    pose that is free.
    """

    name = "two-view"

    def __init__(self, *, features: FeatureMatcher | None = None) -> None:
        self._matcher = features

    @property
    def weights_id(self) -> str:
        """Identity of the matcher's weights, which keys contain; empty without such."""
        return str(getattr(self._matcher, "weights_id", ""))

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
        related = list(relate_to_first(session, frames, priors.cameras, matcher=self._matcher))
        faulty = [views[0] for views in related if views[0].fault]
        if faulty:
            notes = (*priors.notes, *(view.fault for view in faulty))
            return CameraEstimate(None, (), faulty[0].status, notes)
        if len(related) > 1:
            return _estimate_several(priors, [views[0] for views in related])
        first = priors.cameras[0]
        best, *others = (_suppose(priors, first, one) for one in related[0])
        return CameraEstimate(best.rig, best.matches, CameraStatus.OK, priors.notes, tuple(others), best.halves)


def _suppose(priors: CameraPriors, first: Camera, one: RelatedView) -> Hypothesis:
    """Cameras of two views with the prior covariance, and those of either half of the matches."""
    halves = tuple((_suppose(priors, first, half), _suppose(priors, first, rest)) for half, rest in one.halves)
    return Hypothesis(priors.metric_rig([first, one.camera]), one.all_matches, halves)


def _estimate_several(priors: CameraPriors, related: list[RelatedView]) -> CameraEstimate:
    """Three views or more: the distance of each further one from points that it shares with the first two."""
    names, first = priors.names, priors.cameras[0]
    cameras = [first, *(view.camera for view in related)]
    matches = [m for view in related for m in view.all_matches]
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
