"""Finished tracks of another program in place of tracking."""

from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Annotated
from unicodedata import normalize

import numpy as np
import xarray as xr
from pydantic import ConfigDict, Field

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.parts import PartSettings
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.tracks import ForeignTracks, read_foreign_tracks
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.tracking.inputs import check_points, follow_frames

__all__ = ["FileTracker", "TrackFiles"]

_MOST_PX = 1e6
"""No picture is as wide [px]."""
_NEAR_PX = 5.0
"""How far a subset, or the first position of a track, may lie from where the point is named or was found [px]."""


class TrackFiles(PartSettings):
    """Files of the views by the views' names, and what is taken for granted where a file states no uncertainty."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Path]

    std_px: Annotated[float, Field(gt=0)] = 0.05
    """Standard deviation of a position along each axis where a file states none [px]; the scatter of the tracks raises
    it."""


class FileTracker:
    """Tracks that another program made of the same recordings.

    Parameters
    ----------
    settings
        Files by view.

    Notes
    -----
    Points have the names of the session in tables and poses. Programs of digital image correlation name no points: the
    subset nearest to a point, at most 5 px away, is taken, and its motion is that of the point. Frames that a file does
    not have are lost; the recordings are read all the same, for their clocks and their faults.
    """

    name = "file"
    takes_later_points = False

    def __init__(self, *, settings: TrackFiles | None = None) -> None:
        self.settings = settings or TrackFiles()
        self._view = ""
        missing = [f"{view}: {path}" for view, path in self._files.items() if not path.exists()]
        if missing:
            raise SessionError(
                f"method.file: expected files of tracks, got none at {', '.join(missing)}; correct the paths, seen "
                "from the session's folder"
            )

    @property
    def _files(self) -> Mapping[str, Path]:
        return self.settings.model_extra or {}

    def of_view(self, view: str) -> "FileTracker":
        """The same for one view.

        Parameters
        ----------
        view
            Its name.

        Raises
        ------
        SessionError
            No file is named for it.
        """
        if view not in self._files:
            raise SessionError(
                f"method.file: expected a file of tracks for view {view!r}, got them for {sorted(self._files)}; add "
                f'{view!r} = "tracks.csv" under [method.file]'
            )
        one = copy(self)
        one._view = view
        return one

    def track(
        self,
        video: Video,
        points2d: FloatArray,
        *,
        names: Sequence[str],
        reference_frame: int = 0,
        progress: Progress | None = None,
    ) -> xr.Dataset:
        """Tracks of named points as their file has them; see `vfm_sdm.stages.tracking.base.Tracker.track`.

        Parameters
        ----------
        video, points2d, names, reference_frame, progress
            As there; the points are told by their names, or by their places.

        Raises
        ------
        SessionError
            The file has not all points, is of another recording, or a point lies elsewhere in it.
        ResultsError
            The file cannot be read.
        """
        points = check_points(points2d, names, video)
        path = self._files[self.of_view(self._view)._view]
        found = read_foreign_tracks(path)
        time_s = follow_frames(video, None, lambda _: lambda _: None, progress)
        numbers = _frames_of(found, time_s, path)
        chosen = _choose(found, points, names, path)
        shape = (len(time_s), len(names))
        position, std = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
        doubtful = np.zeros(shape, np.bool_)
        position[numbers], std[numbers] = found.position[:, chosen], found.std[:, chosen]
        doubtful[numbers] = found.doubtful[:, chosen]
        if found.homes is not None:
            position += points
            # Programs that begin with the first frame that moved say nothing of the reference frame itself.
            if 0 not in numbers:
                position[0], std[0] = points, std[numbers[0]]
        _check_sizes(position, std, path)
        _check_places(position, points, names, path)
        std = np.where(np.isfinite(std) & (std > 0), std, self.settings.std_px)
        status = np.where(
            np.isfinite(position).all(axis=-1), np.where(doubtful, Status.UNRELIABLE, Status.OK), Status.LOST
        )
        position[status == Status.LOST] = np.nan
        covariance = np.where((status == Status.LOST)[..., None, None], np.nan, np.eye(2) * std[..., None] ** 2)
        attrs = {
            "tracker": self.name,
            "program": found.program,
            "file": path.name,
            "source": video.info.source,
            "image_width": video.info.width,
            "image_height": video.info.height,
            "reference_frame": reference_frame,
        }
        return make_tracks(time_s, list(names), position, covariance, status, attrs=attrs)


def _frames_of(found: ForeignTracks, time_s: FloatArray, path: Path) -> IntArray:
    """Numbers of the frames of a recording that a file has, shape (T,)."""
    count, rows = len(time_s), len(found.position)
    numbers = found.frames
    if found.time_s is not None:
        numbers = np.abs(time_s - found.time_s[:, None]).argmin(axis=1)
        apart = np.abs(time_s[numbers] - found.time_s).max()
        if apart > 0.5 * np.median(np.diff(time_s)) or len({*numbers.tolist()}) < rows:
            raise SessionError(
                f"{path}: expected the times of the recording's frames, got some {apart:.4f} s beside them; state "
                "numbers of frames, or times from the first frame that is used"
            )
    elif numbers is None:
        if rows not in (count, count - 1):
            raise SessionError(
                f"{path}: expected a table for each of the {count} frames, or for all but the first, got {rows}; run "
                "the other program on the whole recording"
            )
        if rows < count and (found.position[0] == 0).all():
            raise SessionError(
                f"{path}: expected a table for each of the {count} frames, got {rows}, of which the first has no "
                "motion at all, as that of the reference frame has: another one is missing; run the other program again"
            )
        numbers = np.arange(count - rows, count)
    if numbers.max(initial=0) >= count:
        raise SessionError(
            f"{path}: expected frames 0 to {count - 1}, those of the recording, got frame {numbers.max()}; are they of "
            "another recording, or counted before use_s?"
        )
    return numbers


def _choose(found: ForeignTracks, points: FloatArray, names: Sequence[str], path: Path) -> list[int]:
    """Which of a file's tracks is each point's."""
    if found.homes is None:
        # Some systems take letters apart, u and two dots; and tables have no blanks around names.
        known = {_compose(name): at for at, name in enumerate(found.names)}
        known |= {name: known[_compose(name)] for name in names if _compose(name) in known}
        known |= {name: at for at, name in enumerate(found.names)}
        missing = [name for name in names if name not in known]
        if missing:
            raise SessionError(
                f"{path}: expected points {', '.join(map(repr, missing))}, got {', '.join(map(repr, found.names))}; "
                "give them the session's names"
            )
        return [known[name] for name in names]
    distances = np.linalg.norm(points[:, None] - found.homes, axis=2)
    chosen = distances.argmin(axis=1)
    far = [
        f"{name} ({away:.1f} px)" for name, away in zip(names, distances.min(axis=1), strict=True) if away > _NEAR_PX
    ]
    if far:
        raise SessionError(
            f"{path}: expected a subset within {_NEAR_PX:g} px of every point, got none for {', '.join(far)}; let the "
            "other program compare a subset there"
        )
    return [int(one) for one in chosen]


def _compose(name: str) -> str:
    return normalize("NFC", name.strip())


def _check_sizes(position: FloatArray, std: FloatArray, path: Path) -> None:
    """Refuses positions and standard deviations that are no pixels."""
    if (np.abs(position) > _MOST_PX).any() or not (np.isnan(std) | ((std >= 0) & (std <= _MOST_PX))).all():
        raise SessionError(
            f"{path}: expected positions within {_MOST_PX:g} px, and standard deviations from 0 (not known) to "
            f"{_MOST_PX:g} px, got others; correct them, or leave the cells empty"
        )


def _check_places(position: FloatArray, points: FloatArray, names: Sequence[str], path: Path) -> None:
    """Refuses tracks that begin elsewhere than their points: of another frame, or with another origin of pixels."""
    # What is lost in the first frame begins later.
    first = np.isfinite(position).all(axis=2).argmax(axis=0)
    away = np.linalg.norm(position[first, np.arange(len(names))] - points, axis=1)
    far = [f"{name} ({one:.1f} px)" for name, one in zip(names, away, strict=True) if one > _NEAR_PX]
    if far:
        raise SessionError(
            f"{path}: expected tracks that begin within {_NEAR_PX:g} px of their points, got {', '.join(far)} away; "
            "name the points (pixel, pixel_in) where the other program follows them"
        )
