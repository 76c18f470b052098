"""What a session names on disk: recordings, their first frames, and every file that a stage may read."""

from collections.abc import Iterator, Mapping
from copy import copy
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import MAD_TO_STD, FloatArray, LumaArray
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.core.threads import thread_pool
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.session.method import table_paths
from vfm_sdm.inputs.session.model import Session, View
from vfm_sdm.inputs.video import CameraTags, RgbArray, Video, open_images, open_video
from vfm_sdm.inputs.video.images import find_files, find_images

__all__ = [
    "RECORDED",
    "FirstFrames",
    "camera_tags",
    "input_files",
    "list_chapters",
    "open_views",
    "picture_of",
    "pixel_aspect",
    "quiet_frames",
]


RECORDED = tuple(f"view.{field}" for field in ("name", "video", "images", "fps", "capture_fps", "use_s"))
"""Fields of a session by which its recordings are opened."""
_OF_VISIT = (SESSION, "cameras.toml", "tracks.nc", "displacement.nc")
"""Files of an earlier visit that are read."""
_OPENING = 16
"""Frames that are averaged at most: a quarter of the noise."""
_BLOCK_PX = 16
_STILL_STD = 5.0
_STILL_SHARE = 2e-3
"""Share of blocks that may differ by more than noise explains before something counts as moving."""
_GREY_LEVELS = 64
"""Grey levels of an averaged picture in one of the recording: rounding must not add noise."""


def open_views(session: Session) -> dict[str, Video]:
    """The recordings of all views by name, in the session's order.

    Raises
    ------
    VideoError
        A file is missing or holds no frame.
    """
    views = session.view
    # What a file is shows its first picture, which takes a second to decode where it is large.
    with thread_pool(len(views)) as executor:
        videos = list(executor.map(partial(_open_view, session), views))
    return dict(zip([view.name for view in views], videos, strict=True))


def _open_view(session: Session, view: View) -> Video:
    use_s = None if view.use_s is None else view.interval_s
    if view.video is not None:
        return open_video(*list_chapters(session, view), capture_fps=view.capture_fps, use_s=use_s)
    pattern = session.resolve_pattern(str(view.images))
    return open_images(pattern, float(view.fps or 0.0), use_s=use_s)


def list_chapters(session: Session, view: View) -> list[Path]:
    """Files of a view's video, in the order in which they were recorded.

    Parameters
    ----------
    session
        Session whose folder relative paths start at.
    view
        A view with a video.

    Raises
    ------
    VideoError
        No file matches a pattern.
    """
    named = view.video if isinstance(view.video, tuple) else (view.video,)
    files: list[Path] = []
    for one in named:
        path = session.resolve(str(one))
        # A file's own name may hold brackets.
        literal = path.exists() or not set("*?[") & set(str(one))
        files += [path] if literal else find_files(session.resolve_pattern(str(one)), "video")
    return files


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
        self._numbers = dict.fromkeys(videos, 0)
        self._pictures: dict[tuple[str, int], LumaArray] = {}

    def __getitem__(self, view: str) -> LumaArray:
        return self._luma[view]

    def __iter__(self) -> Iterator[str]:
        return iter(self._luma)

    def __len__(self) -> int:
        return len(self._luma)

    def at(self, numbers: Mapping[str, int]) -> "FirstFrames":
        """The same with other frames in place of the first ones.

        Parameters
        ----------
        numbers
            Their numbers by view; views that are not named keep their first frame.

        Raises
        ------
        VideoError
            There is no such frame, or it cannot be decoded.
        """
        if not any(numbers.values()):
            return self
        other = copy(self)
        other._luma = {view: self.picture(view, numbers.get(view, 0)) for view in self._luma}
        other._numbers = {view: numbers.get(view, 0) for view in self._luma}
        for made in ("colors", "quiet"):
            vars(other).pop(made, None)
        return other

    def picture(self, view: str, number: int) -> LumaArray:
        """A frame of a view by its number, decoded once, shape (height, width).

        Parameters
        ----------
        view, number
            The view, and the number of the frame.

        Raises
        ------
        VideoError
            There is no such frame, or it cannot be decoded.
        """
        if number == 0:
            return self._luma[view]
        if (view, number) not in self._pictures:
            self._pictures[view, number] = self._videos[view].single(number).frame(number).luma.copy()
        return self._pictures[view, number]

    @property
    def pixel_aspects(self) -> dict[str, float]:
        """Width of a pixel over its height [1], by view."""
        return {view: video.info.pixel_aspect for view, video in self._videos.items()}

    @property
    def camera_tags(self) -> dict[str, CameraTags]:
        """What recordings say of their cameras, by view."""
        return {view: video.info.camera for view, video in self._videos.items()}

    @cached_property
    def colors(self) -> dict[str, RgbArray]:
        """The same in colour, shape (height, width, 3), by view."""
        return {
            view: np.ascontiguousarray(self._videos[view].single(n).color_frame(n)) for view, n in self._numbers.items()
        }

    @cached_property
    def quiet(self) -> dict[str, LumaArray]:
        """Mean of the opening frames of every view, as long as nothing moves, shape (height, width), of 16 bits.

        For matching pictures with little texture: noise and the codec's errors change from frame to frame. Grey levels
        are 64 times finer than those of 8-bit recordings. Other frames than the first ones stand for themselves.
        """
        first = {view: number == 0 for view, number in self._numbers.items()}
        return {view: _average_opening(self._videos[view]) if first[view] else self[view] for view in first}


def quiet_frames(frames: Mapping[str, LumaArray]) -> Mapping[str, LumaArray]:
    """First frames of all views with less noise, where the recordings are there.

    Parameters
    ----------
    frames
        First frame of every view by name, shape (H, W) each; a `FirstFrames` has the recordings.
    """
    return frames.quiet if isinstance(frames, FirstFrames) else frames


def picture_of(frames: Mapping[str, LumaArray], view: str, number: int) -> LumaArray:
    """A frame of a view, shape (H, W); other frames than the first where the recordings are there.

    Parameters
    ----------
    frames
        First frame of every view by name, shape (H, W) each; a `FirstFrames` has the recordings.
    view, number
        The view, and the number of the frame.

    Raises
    ------
    VideoError
        There is no such frame, or it cannot be decoded.
    """
    return frames.picture(view, number) if isinstance(frames, FirstFrames) and number else frames[view]


def pixel_aspect(frames: Mapping[str, LumaArray], view: str) -> float:
    """Width of a view's pixels over their height [1]; 1 where nobody says otherwise.

    Parameters
    ----------
    frames
        First frame of every view by name, shape (H, W) each; a `FirstFrames` has the recordings.
    view
        Name of the view.
    """
    return frames.pixel_aspects[view] if isinstance(frames, FirstFrames) else 1.0


def camera_tags(frames: Mapping[str, LumaArray], view: str) -> CameraTags:
    """What a view's recording says of its camera; nothing where there is none.

    Parameters
    ----------
    frames
        First frame of every view by name, shape (H, W) each; a `FirstFrames` has the recordings.
    view
        Name of the view.
    """
    return frames.camera_tags[view] if isinstance(frames, FirstFrames) else CameraTags()


def _average_opening(video: Video) -> LumaArray:
    """Mean of the first frames that show the same, in finer grey levels."""
    total, blocks, count, noise = None, np.empty((0, 0)), 0, np.inf
    for frame in video.frames(stop=_OPENING):
        luma = frame.luma.astype(np.float32)
        means = _block_means(luma)
        if total is None:
            total, blocks, count = luma, means, 1
            continue
        change = means - blocks / count
        spread = MAD_TO_STD * float(np.median(np.abs(change)))
        # Blocks of a still picture change by noise alone, which the first pair of frames shows.
        noise = min(noise, max(spread, 0.05))
        if (np.abs(change) > _STILL_STD * noise).mean() > _STILL_SHARE:
            break
        total += luma
        blocks, count = blocks + means, count + 1
    if total is None:
        raise VideoError(f"{video.info.source}: expected at least one frame, got none; check the recording")
    levels = _GREY_LEVELS if float(total.max()) / count * _GREY_LEVELS < np.iinfo(np.uint16).max else 1
    finer: LumaArray = np.rint(total * (levels / count)).astype(np.uint16)
    return finer


def _block_means(image: npt.NDArray[np.float32]) -> FloatArray:
    """Means over squares of the image, shape (rows, columns)."""
    rows, columns = (max(1, size // _BLOCK_PX) for size in image.shape)
    cut = image[: rows * _BLOCK_PX, : columns * _BLOCK_PX]
    if cut.shape != (rows * _BLOCK_PX, columns * _BLOCK_PX):
        return np.asarray(image.mean(keepdims=True))
    return np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), np.float64)


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
            for path in list_chapters(session, view):
                yield _name_inside(session, path), path
        elif view.images is not None:
            yield from _pattern_files(session, view.name, view.images)
        if view.camera is not None:
            yield str(view.camera), session.resolve(view.camera)
        if view.lens is not None and view.lens.file is not None:
            yield str(view.lens.file), session.resolve(view.lens.file)
    board = session.chessboard
    if board is not None and board.corners is not None:
        yield str(board.corners), session.resolve(board.corners)
    for name, pattern in (board.images or {} if board is not None else {}).items():
        yield from _pattern_files(session, f"chessboard {name}", pattern)
    yield from _visit_files(session)
    yield from ((str(sensor.file), session.resolve(sensor.file)) for sensor in session.scale_sensors)
    for name, table in session.method.tables.items():
        for key, path in table_paths(table).items():
            found = session.resolve(path)
            inside = sorted(one for one in found.iterdir() if one.is_file()) if found.is_dir() else []
            yield from ((f"method.{name}.{key}/{one.name}", one) for one in inside)
            if found.is_file():
                yield f"method.{name}.{key}", found


def _visit_files(session: Session) -> Iterator[tuple[str, Path]]:
    """Files of an earlier visit, where the session names one."""
    if session.baseline_visit is not None:
        paths = (session.resolve(session.baseline_visit) / name for name in _OF_VISIT)
        yield from ((f"baseline_visit {path.name}", path) for path in paths if path.is_file())


def _pattern_files(session: Session, label: str, pattern: str) -> Iterator[tuple[str, Path]]:
    """Image files as the reader finds them, under their paths, because folders may hold equal names."""
    for path in find_images(session.resolve_pattern(pattern)):
        yield f"{label}: {_name_inside(session, path)}", path


def _name_inside(session: Session, path: Path) -> str:
    """A file's path, from the session's folder where it lies there."""
    inside = path.is_relative_to(session.folder)
    return (path.relative_to(session.folder) if inside else path).as_posix()
