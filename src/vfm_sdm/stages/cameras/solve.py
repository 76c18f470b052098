"""Cameras and points found together (B and A of Figure 4).

The estimated poses help to find the points in the other views, and the points on the structure take part in the
adjustment of the cameras to the site. The adjusted cameras may find points that the first poses missed; then the
adjustment is repeated once.

A point that comes into view later is found in pictures of that time, and takes part as well, because cameras stand
still; but as no more than a click, because they do so to some pixels only.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import CameraStatus, PointStatus
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.inputs.session import FirstFrames, Session, Site
from vfm_sdm.stages.cameras.base import CameraEstimator, Hypothesis
from vfm_sdm.stages.cameras.confusions import FREE_STD, Statements
from vfm_sdm.stages.cameras.contradictions import explain_contradiction
from vfm_sdm.stages.cameras.hypotheses import list_behind, list_turned, weigh_hypotheses
from vfm_sdm.stages.cameras.profile_checks import compare_with_profiles
from vfm_sdm.stages.cameras.site import SiteAdjustment, adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.base import PointMatcher
from vfm_sdm.stages.matching.framed_points import FramedFinder
from vfm_sdm.stages.matching.points import NAMED_STD_PX, check_inside, named_points
from vfm_sdm.stages.matching.straight_edges import StraightEdges, find_straight_edges

__all__ = ["solve_cameras"]

_NO_COVARIANCE = "the camera file states no covariance: the scale has no stated uncertainty"


def solve_cameras(
    session: Session,
    frames: FirstFrames,
    estimator: CameraEstimator,
    *,
    matcher: PointMatcher | None = None,
    reference_frames: Mapping[str, Mapping[str, int]] | None = None,
) -> CameraSolution:
    """Cameras, structural axes and the points' pixels in every view, from the first frames and the site's lengths.

    Parameters
    ----------
    session
        Session with the points and everything measured on site.
    frames
        First frame of every view by name, shape (H, W) each, in the session's order.
    estimator
        Estimator of the cameras before the adjustment.
    matcher
        Matcher that gives approximate pixels of points in the other views; ``None`` where the session asks for none.
    reference_frames
        Numbers of the frames in which points are named that come into view later, by view and point, see
        `vfm_sdm.inputs.session.find_reference_frames`.

    Returns
    -------
    solution
        Cameras, axes and points [px]; with a status, and without cameras, where there is one view or the images did not
        allow an estimate.

    Raises
    ------
    SessionError
        A point lies outside its view's image.
    CameraError, BackendUnavailableError
        The settings of the camera estimator do not suffice.
    """
    check_inside(session, frames)
    given = named_points(session, list(frames), reference_frames)
    if len(frames) == 1:
        return CameraSolution(None, None, None, given, status=CameraStatus.ONE_VIEW)
    estimate = estimator.estimate(session, frames)
    if estimate.rig is None:
        return CameraSolution(None, None, None, given, status=estimate.status, notes=estimate.notes)
    # A rig of unknown accuracy takes no part in the adjustment, and its scale has no stated uncertainty.
    known = estimate.rig.covariance is not None
    hypotheses = [Hypothesis(_with_prior(estimate.rig), estimate.matches, estimate.halves), *estimate.others]
    edges = _find_edges(session, frames)
    weighed = weigh_hypotheses(session, hypotheses, lambda one: _adjust(session, one, given, edges).adjusted)
    finder = FramedFinder.of(session, frames, matcher, reference_frames or {})
    matches = weighed.hypothesis.matches
    start = Hypothesis(_with_poses_of(weighed.hypothesis.rig, weighed.adjusted.rig), matches)
    points = finder.find(weighed.adjusted.rig, matches)
    solved = _adjust(session, start, points, edges)
    if solved.adjusted.frame is not None:
        again = finder.find_on_face(points, solved.adjusted.rig, solved.adjusted.frame)
        if not again.identical(points):
            points = again
            solved = _adjust(session, start, points, edges)
    lenses = {view.name: view.lens for view in session.view}
    adjusted = weighed.widened(explain_contradiction(solved.stated, solved.adjusted, lenses))
    behind = list_behind(adjusted.rig, matches)
    turned = list_turned(weighed.hypothesis.rig, adjusted.rig)
    notes = [
        *estimate.notes,
        *adjusted.notes,
        *behind,
        *turned,
        *compare_with_profiles(session, frames, weighed.hypothesis.rig, adjusted.rig),
        *solved.unused,
        *([] if known else [_NO_COVARIANCE]),
        *_list_missing(points),
    ]
    status = adjusted.status if estimate.status == CameraStatus.OK else estimate.status
    if turned and status in (CameraStatus.OK, CameraStatus.DISAGREE):
        status = CameraStatus.TURNED
    status = CameraStatus.BEHIND if behind else status
    solution = replace(CameraSolution.of(adjusted, points), status=status, notes=tuple(notes))
    if known:
        return solution
    return replace(solution, rig=replace(adjusted.rig, covariance=None), covariance=None, contributions=())


def _find_edges(session: Session, frames: FirstFrames) -> tuple[StraightEdges, ...]:
    """Straight edges of every first frame, where the session says that they keep the structure's axes."""
    if session.site.lines is None:
        return ()
    return tuple(find_straight_edges(luma, view) for view, luma in enumerate(frames.values()))


def _with_prior(rig: Rig) -> Rig:
    """The rig with its prior covariance; held fixed where it has none."""
    size = len(CAMERA_PARAMETERS) * len(rig)
    return rig if rig.covariance is not None else replace(rig, covariance=np.zeros((size, size)))


def _with_poses_of(prior: Rig, adjusted: Rig) -> Rig:
    """The prior rig, begun at the adjusted poses where poses are free: its intrinsics are what was known before."""
    cameras = []
    for index, (camera, found) in enumerate(zip(prior.cameras, adjusted.cameras, strict=True)):
        pose = slice(len(CAMERA_PARAMETERS) * index + 4, len(CAMERA_PARAMETERS) * (index + 1))
        std = np.sqrt(np.diag(np.asarray(prior.covariance))[pose])
        free = bool((std >= FREE_STD).all())
        cameras.append(replace(camera, cam_from_world=found.cam_from_world) if free else camera)
    return replace(prior, cameras=tuple(cameras))


@dataclass(frozen=True, eq=False)
class _Solved:
    """Everything stated of cameras and points, the cameras adjusted to it, and sentences on what was left out."""

    stated: Statements
    adjusted: SiteAdjustment
    unused: list[str]


def _adjust(session: Session, one: Hypothesis, points: xr.Dataset, edges: tuple[StraightEdges, ...]) -> _Solved:
    """The cameras adjusted to everything measured on site to points seen in two views."""
    position, std = (points[name].transpose("point", "view", "pixel").values for name in ("position", "position_std"))
    if "frame" in points:
        std = np.where(
            points["frame"].transpose("point", "view").values[..., None] > 0, np.hypot(std, NAMED_STD_PX), std
        )
    moving = {p.name for p in session.point if not p.static}
    seen = {
        str(name): SitePoint(pixels, std_px, str(name) in moving)
        for name, pixels, std_px in zip(points["point"].values, position, std, strict=True)
        if np.isfinite(pixels).all(axis=1).sum() >= 2
    }
    site, unused = _drop_unseen_lengths(session.site, seen)
    seen |= _list_corners(site, [view.name for view in session.view])
    readings = {view.name: view for view in session.view[1:]}
    stated = Statements(one.rig, one.matches, site, seen, readings, edges)
    adjusted = adjust_to_site(stated.rig, stated.matches, site, seen, readings=readings, edges=edges)
    return _Solved(stated, adjusted, unused)


def _list_corners(site: Site, views: list[str]) -> dict[str, SitePoint]:
    """Corners of rectangles that were clicked in the pictures."""
    found = {}
    for number, rectangle in enumerate(site.rectangle, start=1):
        if rectangle.corners is None:
            continue
        for corner, name in enumerate(rectangle.corner_names(number)):
            nowhere = (float("nan"), float("nan"))
            pixels = [rectangle.corners[view][corner] if view in rectangle.corners else nowhere for view in views]
            found[name] = SitePoint(np.array(pixels), rectangle.std_px)
    return found


def _drop_unseen_lengths(site: Site, seen: Mapping[str, SitePoint]) -> tuple[Site, list[str]]:
    """Site without lengths to points that are not seen in two views, and sentences about those lengths."""
    ranges = tuple(r for r in site.range if r.point in seen)
    lengths = tuple(one for one in site.length if set(one.points) <= set(seen))
    rectangles = tuple(one for one in site.rectangle if set(one.points or ()) <= set(seen))
    lost = [f"range to {r.point!r}" for r in site.range if r not in ranges]
    lost += [f"length {one.points[0]!r} to {one.points[1]!r}" for one in site.length if one not in lengths]
    lost += [f"rectangle of {', '.join(one.points or ())}" for one in site.rectangle if one not in rectangles]
    notes = [f"{what} not used: its point was not found in a second view" for what in lost]
    return site.model_copy(update={"range": ranges, "length": lengths, "rectangle": rectangles}), notes


def _list_missing(points: xr.Dataset) -> list[str]:
    """Notes on points that were not found in a view."""
    status = points["status"]
    return [
        f"point {str(point)!r}, view {str(view)!r}: {why}"
        for point in points["point"].values
        for view in points["view"].values
        if (why := status.sel(view=view, point=point).item()) != PointStatus.OK
    ]
