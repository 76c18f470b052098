"""Which session files a batch measures, and what their run folders are called."""

from collections.abc import Iterable
from pathlib import Path

from vfm_sdm.core.files import match_files
from vfm_sdm.errors import SessionError

__all__ = ["find_sessions"]

_USUAL = "session.toml"


def find_sessions(named: Iterable[Path | str]) -> dict[str, Path]:
    """Session files by the names of their run folders, in the order of their paths.

    Parameters
    ----------
    named
        Files and patterns such as ``sites/*/session.toml``; ``**`` stands for folders of any depth.

    Raises
    ------
    SessionError
        There are none, a pattern matches no file, or two files would have one run folder.

    Notes
    -----
    A ``session.toml`` is called as the folder in which it lies, any other file as it is called itself. So the name does
    not depend on which other sessions are measured, and a later batch finds the same folder again.
    """
    files: dict[Path, Path] = {}
    for one in named:
        found = match_files(one)
        if not found:
            raise SessionError(f"{one}: expected session files, got no match; correct the path or pattern")
        files |= {path.resolve(): path for path in found}
    if not files:
        raise SessionError("expected session files, got none; name them, or a pattern such as 'sites/*/session.toml'")
    sessions: dict[str, Path] = {}
    taken: dict[str, Path] = {}
    for file in sorted(files.values()):
        name = file.resolve().parent.name if file.name == _USUAL else file.stem
        # Some file systems do not tell letters of different cases.
        other = taken.setdefault(name.casefold(), file)
        if other is not file:
            raise SessionError(
                f"{file}: expected a run folder of its own, got {name!r}, which {other} has, too; rename one of the "
                f"two, or measure them into different folders (a {_USUAL} is called as its folder)"
            )
        sessions[name] = file
    return sessions
