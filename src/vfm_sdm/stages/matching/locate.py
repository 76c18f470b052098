"""Points named in one view, carried into all others (section Overall pipeline, step A of Figure 4)."""

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.registry import make
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.session import Point, Session, first_color_frames
from vfm_sdm.stages.matching.base import PointMatcher
from vfm_sdm.stages.matching.correspondence import NOT_FOUND, NOT_RETURNED, OK, Surface, find_correspondences
from vfm_sdm.stages.matching.features import match_features
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["transfer_on_face", "transfer_points"]

_EPIPOLAR_BAND = 5e-3
"""Matches within this share of the image width from a known rig's epipolar lines help to find points."""


def transfer_points(
    session: Session, frames: Mapping[str, LumaArray], rig: Rig, matches: Sequence[Matches]
) -> tuple[dict[str, FloatArray], dict[str, dict[str, str]]]:
    """Pixels of every point in every view, (V, 2) by name, and by name and view why one is missing.

    Parameters
    ----------
    session
        Names the points.
    frames
        First frame of every view by name, in the session's order.
    rig
        Approximate cameras; the scale does not matter.
    matches
        Feature matches between views; looked for where there are none.
    """
    views = list(frames)
    matches = matches or _features_near(rig, list(frames.values()))
    located = _located(session, views)
    pixels = {p.name: np.full((len(views), 2), np.nan) for p in session.point}
    states: dict[str, dict[str, str]] = {p.name: {} for p in session.point}
    for source, source_view in enumerate(views):
        named = [p for p in session.point if p.view == source_view]
        for p in named:
            pixels[p.name][source] = p.pixel
        for target, target_view in enumerate(views):
            if target == source or not named:
                continue
            found = find_correspondences(
                (frames[source_view], frames[target_view]),
                np.array([p.pixel for p in named]),
                rig,
                matches=_pair(matches, source, target),
                subset_px=session.method.subset_px,
                given={
                    i: np.array(places[target_view])
                    for i, p in enumerate(named)
                    if target_view in (places := {**located[p.name], **p.pixel_in})
                },
            )
            for p, position, state in zip(named, found.points2d, found.status, strict=True):
                pixels[p.name][target] = position
                states[p.name][target_view] = state
    return pixels, states


def transfer_on_face(
    session: Session,
    frames: Mapping[str, LumaArray],
    rig: Rig,
    frame: StructureFrame,
    pixels: dict[str, FloatArray],
    states: dict[str, dict[str, str]],
) -> bool:
    """A second look for missing points of the structure, on its face, whose distance was measured.

    Parameters
    ----------
    session, frames
        As in `transfer_points`.
    rig, frame
        Adjusted to the site, in metres.
    pixels, states
        Of `transfer_points`; what is found is entered.

    Returns
    -------
    found
        Whether any point was.
    """
    distance = session.site.perpendicular_distance
    if distance is None or not rig.metric:
        return False
    views = list(frames)
    # The lateral axis points away from the reference camera, where the world has its origin.
    face = Surface(frame.rotation[0], distance.value, float(np.hypot(distance.std, session.site.face_offset_std)))
    any_found = False
    for target, view in enumerate(views):
        for source, source_view in enumerate(views):
            missing = [p for p in session.point if p.view == source_view and _is_missing(p, view, states)]
            if not missing:
                continue
            found = find_correspondences(
                (frames[source_view], frames[view]),
                np.array([p.pixel for p in missing]),
                rig,
                matches=_pair((), source, target),
                subset_px=session.method.subset_px,
                surface=face,
            )
            for p, position, state in zip(missing, found.points2d, found.status, strict=True):
                if state == OK:
                    pixels[p.name][target], states[p.name][view] = position, OK
                    any_found = True
    return any_found


def _located(session: Session, views: Sequence[str]) -> dict[str, dict[str, FloatArray]]:
    """Pixels (2,) by point and view where the matcher that the session asks for sees the points."""
    located: dict[str, dict[str, FloatArray]] = {p.name: {} for p in session.point}
    matcher: PointMatcher | None = make("matchers", session.resolved_method)
    if matcher is None:
        return located
    colors = first_color_frames(session)
    for source, target in permutations(views, 2):
        named = [p for p in session.point if p.view == source]
        if not named:
            continue
        places = matcher.locate(colors[source], colors[target], np.array([p.pixel for p in named]))
        for p, place in zip(named, places, strict=True):
            if np.isfinite(place).all():
                located[p.name][target] = place
    return located


def _is_missing(point: Point, view: str, states: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether a point of the structure was not found in a view where nobody named it."""
    return not point.static and view not in point.pixel_in and states[point.name].get(view) in (NOT_FOUND, NOT_RETURNED)


def _features_near(rig: Rig, images: Sequence[LumaArray]) -> tuple[Matches, ...]:
    """Matches of every view with the reference that agree with a known rig."""
    found = []
    for index in range(1, len(images)):
        first, second = match_features(images[0], images[index])
        near = np.abs(sampson_error(first, second, rig, second=index)) < _EPIPOLAR_BAND * images[0].shape[1]
        found.append(Matches(0, index, first[near], second[near]))
    return tuple(found)


def _pair(matches: Sequence[Matches], first: int, second: int) -> Matches:
    """The matches between two views in this order; empty when there are none."""
    for m in matches:
        if (m.first, m.second) == (first, second):
            return m
        if (m.first, m.second) == (second, first):
            return Matches(first, second, m.points_second, m.points_first)
    return Matches(first, second, np.empty((0, 2)), np.empty((0, 2)))
