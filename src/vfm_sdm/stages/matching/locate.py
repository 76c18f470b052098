"""Points named in one view, found in all others (section Overall pipeline, step A of Figure 4)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.session import FirstFrames, Point, Session
from vfm_sdm.stages.matching.base import PointMatcher
from vfm_sdm.stages.matching.correspondence import Correspondence, Surface, find_correspondences
from vfm_sdm.stages.matching.expected import FAR_OUTSIDE_PX, Expected, expect_anywhere, expect_on_face
from vfm_sdm.stages.matching.face import Face, know_face
from vfm_sdm.stages.matching.features import match_features
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.placing import Known, Place, place_points
from vfm_sdm.stages.matching.points import named_points
from vfm_sdm.stages.matching.pyramid import ViewPair

__all__ = ["PointFinder", "features_near"]

_EPIPOLAR_BAND = 5e-3
"""Matches within this share of the image width from a known rig's epipolar lines help to find points."""
_EXCLUDED_STD = 5.0
"""Distance from where a point is expected beyond which it is another place [standard deviations]."""
_UNSEEN = (PointStatus.NOT_LOOKED_FOR, PointStatus.NOT_FOUND, PointStatus.NOT_RETURNED)
"""Statuses of points that another way of looking may find."""


@dataclass(frozen=True, eq=False)
class PointFinder:
    """Finds the points of a session in the views in which nobody named them.

    Parameters
    ----------
    session
        Names the points.
    frames
        First frame of every view by name, in the session's order.
    matcher
        What says where to look first; ``None`` leaves that to the geometry.
    """

    session: Session
    frames: Mapping[str, LumaArray]
    matcher: PointMatcher | None = None

    def find(self, rig: Rig, matches: Sequence[Matches]) -> xr.Dataset:
        """Points dataset of all views.

        Parameters
        ----------
        rig
            Approximate cameras; the scale does not matter.
        matches
            Feature matches between views; looked for where there are none and they are needed.

        Notes
        -----
        Where the face is known, all points are placed together (`place_points`); those that this does not find, and
        all where there is no face, are searched for along their epipolar lines one by one (`find_correspondences`).
        Places that the user named stay where they are within the user's accuracy. What such a search finds far from
        where cameras and face expect the point is another place that looks alike, and not it.
        """
        views, size = list(self.frames), self.session.method.usual_subset_px
        points = named_points(self.session, views)
        metric, face = know_face(self.session.site, rig)
        for source, target in _pairs(views):
            named = [p for p in self.session.point if p.view == source]
            suggested = self._suggested(named, source, target) if named else {}
            # A matcher that the session asks for is heard first.
            together = [p for i, p in enumerate(named) if i not in suggested or target in p.pixel_in]
            if face is None:
                together = [p for p in together if target in p.pixel_in]
            placed = self._place(together, points, metric, face, (source, target))
            _enter(points, together, target, placed, subset_px=size)
            alone = [i for i, p in enumerate(named) if points["status"].sel(view=target, point=p.name) in _UNSEEN]
            if alone:
                matches = matches or features_near(rig, list(self.frames.values()))
                between = _between(matches, views.index(source), views.index(target))
                given = {number: suggested[i] for number, i in enumerate(alone) if i in suggested}
                left = [named[i] for i in alone]
                found = self._correspondences(left, rig, between, given=given)
                if face is not None:
                    expected = self._expect(left, metric, face, (source, target))
                    found = _keep_expected(found, expected, [not p.static for p in left])
                _enter(points, left, target, found, subset_px=size)
        return points

    def find_on_face(self, points: xr.Dataset, rig: Rig, frame: StructureFrame) -> xr.Dataset:
        """Points dataset after a second look for missing points of the structure on its face, if its distance is known.

        Parameters
        ----------
        points
            Points dataset that `find` returned.
        rig, frame
            Cameras and axes after the adjustment to the site, lengths in metres.

        Returns
        -------
        points
            Copy of the dataset, with the pixels of points that were found on the face [px].
        """
        distance = self.session.site.perpendicular_distance
        points = points.copy(deep=True)
        if distance is None or not rig.metric:
            return points
        views, size = list(self.frames), self.session.method.usual_subset_px
        _, face = know_face(self.session.site, rig, frame)
        # The lateral axis points away from the reference camera, where the world has its origin.
        std = float(np.hypot(distance.std, self.session.site.face_offset_std))
        surface = Surface(frame.rotation[0], distance.value, std)
        for source, target in _pairs(views):
            missing = [p for p in self.session.point if p.view == source and _is_missing(p, target, points)]
            found = self._place(missing, points, rig, face, (source, target))
            _enter(points, missing, target, found, subset_px=size, only_found=True)
            missing = [p for p in missing if points["status"].sel(view=target, point=p.name) in _UNSEEN]
            if missing:
                between = _between((), views.index(source), views.index(target))
                found = self._correspondences(missing, rig, between, face=surface)
                _enter(points, missing, target, found, subset_px=size, only_found=True)
        return points

    def _place(
        self, wanted: Sequence[Point], points: xr.Dataset, rig: Rig, face: Face | None, views: tuple[str, str]
    ) -> Correspondence:
        """Places of points in the second of two views, chosen together; the points that have one there help."""
        source, target = views
        if not wanted:
            return _as_correspondence([])
        names = [p.name for p in wanted]
        helping = [p for p in self.session.point if p.view == source and p.name not in names]
        helping = [p for p in helping if points["status"].sel(view=target, point=p.name) == PointStatus.OK]
        everyone = [*wanted, *helping]
        pixels = np.array([p.pixel for p in everyone])
        given = {i: np.array(p.pixel_in[target]) for i, p in enumerate(wanted) if target in p.pixel_in}
        known = {i: _place_of(points, target, p.name) for i, p in enumerate(everyone) if i >= len(wanted)}
        expected = self._expect(everyone, rig, face, views)
        places = place_points(
            (self.frames[source], self.frames[target]),
            pixels,
            expected,
            subset_px=self.session.method.usual_subset_px,
            known=Known(given, known),
        )
        return _as_correspondence(places[: len(wanted)])

    def _expect(self, points: Sequence[Point], rig: Rig, face: Face | None, views: tuple[str, str]) -> Expected:
        """Where points of the first of two views are expected in the second."""
        source, target = (list(self.frames).index(view) for view in views)
        pixels = np.array([p.pixel for p in points])
        if face is None:
            return expect_anywhere(pixels, rig, (source, target))
        on_face = np.array([not p.static for p in points])
        return expect_on_face(pixels, rig, (source, target), face, on_face=on_face)

    def _correspondences(
        self,
        points: Sequence[Point],
        rig: Rig,
        matches: Matches,
        *,
        given: Mapping[int, FloatArray] | None = None,
        face: Surface | None = None,
    ) -> Correspondence:
        """Places of points in the second view of ``matches`` that were named in its first one."""
        images = list(self.frames.values())
        return find_correspondences(
            ViewPair((images[matches.first], images[matches.second]), rig, matches),
            np.array([p.pixel for p in points]),
            subset_px=self.session.method.usual_subset_px,
            given=given,
            surface=face,
        )

    def _suggested(self, points: Sequence[Point], source: str, target: str) -> dict[int, FloatArray]:
        """Places (2,) [px] in the target view where the matcher sees the points, by index."""
        if self.matcher is None or not isinstance(self.frames, FirstFrames):
            return {}
        colors = self.frames.colors
        places = self.matcher.locate(colors[source], colors[target], np.array([p.pixel for p in points]))
        return {i: place for i, place in enumerate(places) if np.isfinite(place).all()}


def _pairs(views: Sequence[str]) -> list[tuple[str, str]]:
    """Every view with every other one as its target."""
    return [(source, target) for source in views for target in views if source != target]


def _enter(
    points: xr.Dataset,
    named: Sequence[Point],
    view: str,
    found: Correspondence,
    *,
    subset_px: int,
    only_found: bool = False,
) -> None:
    """Enters what was found of some points in a view; with ``only_found``, nothing of the others."""
    std = np.sqrt(np.einsum("pii->pi", found.covariance))
    # A soft texture may resemble a place without telling how well: the square then shows the point somewhere in it.
    std = np.where(np.isnan(std) & np.isfinite(found.points2d), subset_px / np.sqrt(12), std)
    for number, point in enumerate(named):
        if only_found and found.status[number] != PointStatus.OK:
            continue
        here = {"view": view, "point": point.name}
        points["position"].loc[here] = found.points2d[number]
        points["position_std"].loc[here] = std[number]
        points["status"].loc[here] = str(found.status[number])


def _keep_expected(found: Correspondence, expected: Expected, on_face: Sequence[bool]) -> Correspondence:
    """What was found, without places of points on the face that it excludes; a ray may also miss it."""
    away = found.points2d - expected.position
    covariance = expected.own + expected.shared @ expected.shared.swapaxes(1, 2)
    squared = np.einsum("pi,pi->p", away, np.linalg.solve(covariance, away[..., None])[..., 0])
    excluded = (squared > _EXCLUDED_STD**2) & np.array(on_face) & (expected.position > FAR_OUTSIDE_PX).all(axis=1)
    return replace(
        found,
        points2d=np.where(excluded[:, None], np.nan, found.points2d),
        covariance=np.where(excluded[:, None, None], np.nan, found.covariance),
        status=tuple(
            PointStatus.NOT_FOUND if far else status for far, status in zip(excluded, found.status, strict=True)
        ),
    )


def _is_missing(point: Point, view: str, points: xr.Dataset) -> bool:
    """Whether a point of the structure has no place in a view where nobody named it."""
    if point.static or view in point.pixel_in:
        return False
    return points["status"].sel(view=view, point=point.name).item() in (*_UNSEEN, PointStatus.AMBIGUOUS)


def _place_of(points: xr.Dataset, view: str, name: str) -> Place:
    """The place of a point that a points dataset holds."""
    one = points.sel(view=view, point=name)
    variances = one["position_std"].values ** 2
    return Place(one["position"].values, np.diag(variances), np.nan, str(one["status"].item()))


def _as_correspondence(places: Sequence[Place]) -> Correspondence:
    """Places as arrays; they were not followed back."""
    return Correspondence(
        np.array([one.position for one in places]).reshape(-1, 2),
        np.array([one.covariance for one in places]).reshape(-1, 2, 2),
        np.array([one.correlation for one in places]),
        np.full(len(places), np.nan),
        tuple(one.status for one in places),
    )


def features_near(rig: Rig, images: Sequence[LumaArray]) -> tuple[Matches, ...]:
    """Matches of every view with the reference view that agree with a known rig.

    Parameters
    ----------
    rig
        Cameras; the scale does not matter.
    images
        First frame of every view, shape (H, W) each.
    """
    found = []
    for index in range(1, len(images)):
        matches = match_features(images[0], images[index])
        first, second = matches.points_first, matches.points_second
        near = np.abs(sampson_error(first, second, rig, second=index)) < _EPIPOLAR_BAND * images[0].shape[1]
        found.append(Matches(0, index, first[near], second[near]))
    return tuple(found)


def _between(matches: Sequence[Matches], first: int, second: int) -> Matches:
    """The matches between two views in this order; empty when there are none."""
    for m in matches:
        if (m.first, m.second) == (first, second):
            return m
        if (m.first, m.second) == (second, first):
            return Matches(first, second, m.points_second, m.points_first)
    return Matches(first, second, np.empty((0, 2)), np.empty((0, 2)))
