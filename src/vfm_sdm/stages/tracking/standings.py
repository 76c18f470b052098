"""What the points of a segment are compared with: one reference frame, or several.

Several, where points are named in frames of their own, or references were renewed as light changed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.tracking.follow import FollowState

__all__ = ["Standing", "include_references", "join_points"]


@dataclass(frozen=True, eq=False)
class Standing:
    """Points that are compared with one reference frame, and where they are as a segment begins.

    Parameters
    ----------
    number
        Number of the reference frame in the view.
    frame
        That frame as a recording of its own; ``None`` is the first one of the view.
    rows
        The points, by their rows among all targets, rising, shape (N,).
    points
        Where they are in that frame, shape (N, 2) [px].
    covariance
        What renewals add to the covariance of every position that is compared with it, shape (N, 2, 2) [px2].
    state
        Where they are as the segment begins; ``None`` is where they are in the reference frame.
    before
        Number of frames of the segment before the reference frame, where that is one of them and no start of it.
    """

    number: int
    frame: Video | None
    rows: IntArray
    points: FloatArray
    covariance: FloatArray
    state: FollowState | None
    before: int | None = None

    @classmethod
    def of_first(cls, points: FloatArray) -> "Standing":
        """All points in the recording's first frame.

        Parameters
        ----------
        points
            Where they are in it, shape (P, 2) [px].
        """
        count = len(points)
        return cls(0, None, np.arange(count), points, np.zeros((count, 2, 2)), None)

    @classmethod
    def of_named(cls, video: Video, points: FloatArray, numbers: IntArray) -> "tuple[Standing, ...]":
        """Points by the frames in which they are named; none where that is the first one for all.

        Parameters
        ----------
        video
            The view.
        points
            Where they are in these, shape (P, 2) [px].
        numbers
            Numbers of the frames, shape (P,).
        """
        if not numbers.any():
            return ()
        found = []
        for number in np.unique(numbers).tolist():
            rows = np.flatnonzero(numbers == number)
            frame = video.single(number).on_one_thread() if number else None
            found.append(cls(number, frame, rows, points[rows], np.zeros((len(rows), 2, 2)), None))
        return tuple(found)

    def luma(self, first: LumaArray) -> LumaArray:
        """The reference frame, shape (H, W).

        Parameters
        ----------
        first
            The first frame of the view, shape (H, W).

        Raises
        ------
        VideoError
            The frame cannot be decoded.
        """
        return first if self.frame is None else self.frame.frame(self.number).luma

    def within(self, first: int, count: int | None) -> "Standing":
        """The same for a segment, which may hold the reference frame.

        Parameters
        ----------
        first, count
            Number of the segment's first frame, and of its frames; all that follow for ``None``.
        """
        before = self.number - first
        inside = before >= 0 and self.frame is not None and (count is None or before < count)
        return replace(self, before=before if inside else None)


def join_points(records: Sequence[xr.Dataset], standings: Sequence[Standing]) -> xr.Dataset:
    """Records of the points of several standings as one of all points.

    Parameters
    ----------
    records
        One a standing, of the same frames.
    standings
        Whose points are all of P between them.

    Returns
    -------
    record
        With ``reference`` (time, point): number of the reference frame. Strips of points (``part_point``) are in the
        order of their points.
    """
    numbers = np.concatenate([np.full(len(one.rows), one.number, np.int32) for one in standings])
    rows = np.concatenate([one.rows for one in standings])
    order = {"point": np.argsort(rows)}
    record = records[0]
    if len(records) > 1:
        joined = {}
        if "part_point" in record:
            owners = [one.rows[of.part_point.values] for one, of in zip(standings, records, strict=True)]
            order["strip"] = np.argsort(np.concatenate(owners), kind="stable")
            records = [of.assign(part_point=("strip", own)) for own, of in zip(owners, records, strict=True)]
        for name, variable in record.data_vars.items():
            axis = next((dim for dim in ("point", "strip") if dim in variable.dims), None)
            values = variable.values
            if axis is not None:
                along = variable.dims.index(axis)
                values = np.concatenate([of[name].values for of in records], axis=along).take(order[axis], axis=along)
            joined[str(name)] = (variable.dims, values, variable.attrs)
        record = xr.Dataset(joined, coords=record.coords, attrs=record.attrs)
    frames = record.sizes["time"]
    return record.assign(reference=(("time", "point"), np.tile(numbers[order["point"]], (frames, 1))))


def include_references(
    tracks: xr.Dataset, names: Sequence[str], starts: Iterable[Sequence[Standing] | None]
) -> xr.Dataset:
    """Tracks whose covariances hold what renewed reference frames add; nothing is added by the frames of named points.

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px], with ``reference`` (time, point) where references were renewed.
    names
        Names of all targets, which the rows of standings count.
    starts
        What the targets of each segment were compared with; ``None`` is the first frame.

    Returns
    -------
    tracks
        As they are where nothing was renewed. Else with larger ``position_covariance`` [px2], and with
        ``reference_covariance`` (reference_frame, point) [px2], which is in it, by the numbers of the frames that are
        references; NaN for points that were not compared with them.
    """
    if "reference" not in tracks:
        return tracks
    numbers = np.unique(tracks["reference"].values)
    places = tracks.indexes["point"].get_indexer(list(names))
    added = np.full((len(numbers), tracks.sizes["point"], 2, 2), np.nan)
    added[numbers == 0] = 0.0
    for one in (one for start in starts for one in start or ()):
        added[np.ix_(numbers == one.number, places[one.rows])] = one.covariance
    of_sample = added[np.searchsorted(numbers, tracks["reference"].values), np.arange(tracks.sizes["point"])]
    covariance = tracks["position_covariance"]
    dims = ("reference_frame", "point", "pixel_a", "pixel_b")
    return tracks.assign(
        position_covariance=covariance.copy(data=covariance.values + np.nan_to_num(of_sample)),
        reference_covariance=(dims, added, {"units": "px2"}),
    ).assign_coords(reference_frame=numbers)
