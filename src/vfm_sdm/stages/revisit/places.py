"""The places of an earlier visit in the pictures of a later one, view by view."""

from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.cameras.relative_pose import estimate_relative_pose
from vfm_sdm.stages.matching.correspondence import find_correspondences
from vfm_sdm.stages.matching.detection import detect_features
from vfm_sdm.stages.matching.features import match_detected
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.pyramid import ViewPair
from vfm_sdm.stages.registration.records import Starts
from vfm_sdm.stages.registration.subsets import register_subset

__all__ = ["find_again"]

_SMALLER = (0.75, 0.5)
"""Sides of smaller subsets, as shares of the side [1]."""
_LEAST_PX = 15


def find_again(
    images: tuple[LumaArray, LumaArray],
    cameras: tuple[Camera, Camera],
    places: FloatArray,
    named: FloatArray,
    *,
    subset_px: int,
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Where places of the earlier picture of a view are in the later one.

    Parameters
    ----------
    images
        First frames of the view at the earlier and the later visit, shape (H, W) each.
    cameras
        The view's camera at the two visits; of their poses nothing is used.
    places
        Places in the earlier picture, shape (P, 2) [px].
    named
        Where the later session has the same points, shape (P, 2) [px]; NaN where it has none.
    subset_px
        Side of the compared square [px].

    Returns
    -------
    found, covariance, status
        Places in the later picture, shape (P, 2) [px], their covariance, shape (P, 2, 2) [px2], and a `PointStatus`
        each: ``ok`` or why there is no place.

    Notes
    -----
    Both visits name a point by a click, some pixels beside each other; what is found is the place of the earlier click.
    Anything farther than half a subset from the later click is another place that looks alike.

    Where a subset holds something nearer than the point, such as a stiffener, and the camera stands elsewhere, its
    parts move against each other and the place found is off. Smaller subsets hold less of it: by how much they find
    another place counts in the covariance.
    """
    count = len(places)
    found, covariance = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
    status: list[str] = [PointStatus.NOT_FOUND] * count
    pair = _match_visits(images, cameras)
    if pair is None:
        return found, covariance, status
    # Of places that look alike, in a second round, the one at which the later session points.
    for pointed in (False, True):
        rows = [n for n in range(count) if status[n] != PointStatus.OK and np.isfinite([places[n], named[n]]).all()]
        if not rows:
            break
        given = {i: named[n] for i, n in enumerate(rows)} if pointed else None
        again = find_correspondences(pair, places[rows], subset_px=subset_px, given=given)
        for i, n in enumerate(rows):
            status[n] = again.status[i]
            if status[n] == PointStatus.OK and np.linalg.norm(again.points2d[i] - named[n]) > subset_px / 2:
                status[n] = PointStatus.AMBIGUOUS
            if status[n] == PointStatus.OK:
                found[n] = again.points2d[i]
                covariance[n] = again.covariance[i] + _disagreement(images, places[n], found[n], subset_px)
    return found, covariance, status


def _disagreement(
    images: tuple[LumaArray, LumaArray], place: FloatArray, found: FloatArray, subset_px: int
) -> FloatArray:
    """Mean square by which smaller subsets find another place, shape (2, 2) [px2]."""
    apart = []
    for share in _SMALLER:
        size = max(int(share * subset_px) // 2 * 2 + 1, _LEAST_PX)
        one = register_subset(*images, place[None], Starts(found[None]), subset_px=size)
        if one.converged[0]:
            apart.append(one.position[0] - found)
    return np.asarray(np.mean([np.outer(d, d) for d in apart], axis=0)) if apart else np.zeros((2, 2))


def _match_visits(images: tuple[LumaArray, LumaArray], cameras: tuple[Camera, Camera]) -> ViewPair | None:
    """Both pictures of a view with the pose between them; ``None`` where too little is the same in both."""
    # Features as they are: cameras about the same place see no surface at another angle.
    matches = match_detected(*map(detect_features, images))
    pose, agree = estimate_relative_pose(matches.points_first, matches.points_second, *cameras)
    if not agree.any():
        return None
    moved = tuple(replace(c, cam_from_world=at) for c, at in zip(cameras, (np.eye(3, 4), pose), strict=True))
    rig = Rig(("earlier", "later"), moved)
    return ViewPair(images, rig, Matches(0, 1, matches.points_first[agree], matches.points_second[agree]))
