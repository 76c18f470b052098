"""What a session names on disk: recordings, their first frames, and every file that a stage may read."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.inputs.session.method import table_paths
from vfm_sdm.inputs.session.model import Session
from vfm_sdm.inputs.video import RgbArray, Video, open_images, open_video
from vfm_sdm.inputs.video.images import find_images

__all__ = ["FirstFrames", "input_files", "open_views"]


def open_views(session: Session) -> dict[str, Video]:
    """The recordings of all views by name, in the session's order.

    Raises
    ------
    VideoError
        A file is missing or holds no frame.
    """
    videos = {}
    for view in session.view:
        if view.video is not None:
            videos[view.name] = open_video(session.resolve(view.video))
        else:
            videos[view.name] = open_images(session.resolve_pattern(str(view.images)), float(view.fps or 0.0))
    return videos


class FirstFrames(Mapping[str, LumaArray]):
    """First frame of every view by name: luma, shape (height, width), and colours where somebody asks for them.

    Parameters
    ----------
    videos
        Open recordings by view, in the session's order.

    Raises
    ------
    VideoError
        A recording holds no frame.
    """

    def __init__(self, videos: Mapping[str, Video]) -> None:
        self._videos = videos
        self._luma = {view: video.first_frame().luma.copy() for view, video in videos.items()}

    def __getitem__(self, view: str) -> LumaArray:
        return self._luma[view]

    def __iter__(self) -> Iterator[str]:
        return iter(self._luma)

    def __len__(self) -> int:
        return len(self._luma)

    @cached_property
    def colors(self) -> dict[str, RgbArray]:
        """The same in colour, shape (height, width, 3), by view."""
        return {view: np.ascontiguousarray(video.color_frame(0)) for view, video in self._videos.items()}


def input_files(session: Session) -> Iterator[tuple[str, Path]]:
    """Files that a session names for cameras and recordings, each with what it is called; of image sequences each one.

    Parameters
    ----------
    session
        A session, or what `vfm_sdm.inputs.session.narrow` leaves of it: then the files that these fields name.

    Raises
    ------
    VideoError
        No file matches a pattern.
    """
    for view in session.view:
        if view.video is not None:
            yield str(view.video), session.resolve(view.video)
        elif view.images is not None:
            yield from _pattern_files(session, view.name, view.images)
        if view.camera is not None:
            yield str(view.camera), session.resolve(view.camera)
    board = session.chessboard
    if board is not None and board.corners is not None:
        yield str(board.corners), session.resolve(board.corners)
    for name, pattern in (board.images or {} if board is not None else {}).items():
        yield from _pattern_files(session, f"chessboard {name}", pattern)
    for name, table in session.method.tables.items():
        for key, path in table_paths(table).items():
            if session.resolve(path).is_file():
                yield f"method.{name}.{key}", session.resolve(path)


def _pattern_files(session: Session, label: str, pattern: str) -> Iterator[tuple[str, Path]]:
    """Image files as the reader finds them, under their paths, because folders may hold equal names."""
    for path in find_images(session.resolve_pattern(pattern)):
        inside = path.is_relative_to(session.folder)
        yield f"{label}: {(path.relative_to(session.folder) if inside else path).as_posix()}", path
