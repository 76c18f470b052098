"""Points named in frames of different times, each found in the other views in pictures of its own time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import xarray as xr

from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.inputs.session import FirstFrames, Point, Session
from vfm_sdm.stages.matching.base import PointMatcher
from vfm_sdm.stages.matching.locate import PointFinder
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.points import state_frames

__all__ = ["FramedFinder"]


@dataclass(frozen=True, eq=False)
class FramedFinder:
    """Finds the points of a session, those of each time by themselves: a `PointFinder` for each.

    Parameters
    ----------
    finders
        Of the points of one time each, who are all points of the session between them.
    names
        Names of all points, in the session's order.
    reference_frames
        Numbers of the frames in which points are named, by view and point; the first one of points that are not in it.
    """

    finders: Sequence[PointFinder]
    names: Sequence[str]
    reference_frames: Mapping[str, Mapping[str, int]]

    @classmethod
    def of(
        cls,
        session: Session,
        frames: FirstFrames,
        matcher: PointMatcher | None,
        reference_frames: Mapping[str, Mapping[str, int]],
    ) -> Self:
        """The finder of a session's points.

        Parameters
        ----------
        session
            Names the points.
        frames
            First frame of every view by name, shape (H, W) each, in the session's order.
        matcher
            What says where to look first, see `PointFinder`.
        reference_frames
            Numbers of the frames in which points are named, by view and point.
        """
        views, groups = list(frames), dict[tuple[int, ...], list[Point]]()
        for point in session.point:
            numbers = tuple(reference_frames.get(view, {}).get(point.name, 0) for view in views)
            groups.setdefault(numbers, []).append(point)
        finders = []
        for numbers, points in groups.items():
            at = frames.at(dict(zip(views, numbers, strict=True))) if any(numbers) else frames
            finders.append(PointFinder(session.model_copy(update={"point": tuple(points)}), at, matcher))
        return cls(
            finders or [PointFinder(session, frames, matcher)], [p.name for p in session.point], reference_frames
        )

    def find(self, rig: Rig, matches: Sequence[Matches]) -> xr.Dataset:
        """Points dataset of all views, see `PointFinder.find`.

        Parameters
        ----------
        rig, matches
            As there; what matches in the first frames is in the same place later, because the cameras stand still.
        """
        return self._join([finder.find(rig, matches) for finder in self.finders])

    def find_on_face(self, points: xr.Dataset, rig: Rig, frame: StructureFrame) -> xr.Dataset:
        """Points dataset after a second look for missing points, see `PointFinder.find_on_face`.

        Parameters
        ----------
        points, rig, frame
            As there.
        """
        if len(self.finders) == 1:
            return self.finders[0].find_on_face(points, rig, frame)
        parts = ((finder, points.sel(point=[p.name for p in finder.session.point])) for finder in self.finders)
        return self._join([finder.find_on_face(part, rig, frame) for finder, part in parts])

    def _join(self, parts: Sequence[xr.Dataset]) -> xr.Dataset:
        """Points of all times as one dataset, which says in which frames they are."""
        if len(parts) == 1:
            return state_frames(parts[0], self.reference_frames)
        joined = xr.concat([part.drop_vars("frame", errors="ignore") for part in parts], "point")
        return state_frames(joined.sel(point=list(self.names)), self.reference_frames)
