"""The folder that a page works in: nothing outside it is read or written, and one page works in it at a time."""

import re
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from vfm_sdm.core.one_writer import held_alone
from vfm_sdm.errors import SessionError, VideoError
from vfm_sdm.inputs.video import VideoInfo, open_video

__all__ = ["Film", "Project"]

_SUFFIXES = {".mp4", ".mov", ".mkv", ".avi", ".m4v", ".mts", ".m2ts", ".webm"}
_CHAPTER = re.compile(r"(?P<kind>G[HXLP])(?P<chapter>\d{2})(?P<number>\d{4})$", re.IGNORECASE)
"""Names that GoPro cameras give the chapters of one recording: chapter, then number of the recording."""
_FEW_BITS = 0.05
"""Bits a pixel from which down compression is what limits the measurement."""


@dataclass(frozen=True)
class Film:
    """A recording in the folder: one file, or the chapters of one recording.

    Parameters
    ----------
    files
        Paths from the folder on, in order.
    info
        What the first file says; ``None`` where it cannot be used.
    bits_per_pixel
        Compressed size over the pixels it holds; NaN where that is not known.
    warnings
        Sentences on what may be wrong with it.
    """

    files: tuple[str, ...]
    info: VideoInfo | None
    bits_per_pixel: float
    warnings: tuple[str, ...]

    @property
    def video(self) -> str | list[str]:
        """What a session says of it."""
        return self.files[0] if len(self.files) == 1 else list(self.files)


class Project:
    """A folder with films and the session that measures them.

    Parameters
    ----------
    folder
        The folder, which must be there.

    Raises
    ------
    SessionError
        It is not a folder.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise SessionError(f"{folder}: expected a folder with films, got none; name one that is there")
        self.folder = folder.resolve()
        self.session = self.folder / "session.toml"
        self.run = self.folder / "run"

    def inside(self, path: Path | str) -> Path:
        """A path in the folder.

        Parameters
        ----------
        path
            From the folder on.

        Raises
        ------
        SessionError
            It leads out of the folder, through ``..``, a link or an absolute path.
        """
        try:
            found = (self.folder / path).resolve()
            outside = not found.is_relative_to(self.folder)
        except (OSError, ValueError):
            outside = True
        if outside:
            raise SessionError(f"{path}: expected a path in the page's folder, got one outside; copy the file there")
        return found

    def films(self) -> list[Film]:
        """Recordings in the folder and one level below, chapters of one recording together."""
        groups: dict[tuple[str, ...], list[Path]] = {}
        for path in sorted([*self.folder.glob("*"), *self.folder.glob("*/*")]):
            if path.suffix.lower() not in _SUFFIXES or path.name.startswith("."):
                continue
            relative = path.relative_to(self.folder)
            if relative.parts[0] == self.run.name:
                continue
            named = _CHAPTER.match(path.stem)
            key = (str(path.parent), named["kind"].upper(), named["number"]) if named else (str(path),)
            groups.setdefault(key, []).append(relative)
        return [_describe(self.folder, sorted(paths)) for paths in groups.values()]

    def opened(self) -> AbstractContextManager[None]:
        """The folder for this page alone.

        Raises
        ------
        ResultsError
            Another page works in it, or nothing can be written there.
        """
        return held_alone(
            self.folder, ".page", expected="a folder without a page", advice="use that page, or close it first"
        )


def _describe(folder: Path, paths: list[Path]) -> Film:
    """What a recording's first file says, and the size of all."""
    files = tuple(path.as_posix() for path in paths)
    try:
        info = open_video(folder / paths[0]).info
    except VideoError as error:
        return Film(files, None, float("nan"), (str(error).removeprefix(f"{folder / paths[0]}: "),))
    pixels = (info.frame_count or 0) * info.width * info.height
    bits = 8 * (info.size_bytes or 0) / pixels if pixels else float("nan")
    warnings = [*info.doubts, *info.remarks]
    if bits < _FEW_BITS:
        warnings.append(f"{bits:.3f} bits a pixel: compression limits what is measured; record at a higher bit rate")
    return Film(files, info, bits, tuple(warnings))
