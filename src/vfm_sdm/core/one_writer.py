"""A folder in which one process works at a time, and who that is."""

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from vfm_sdm.core.files import write_json
from vfm_sdm.errors import ResultsError

__all__ = ["held_alone"]


@contextmanager
def held_alone(folder: Path, name: str, *, expected: str, advice: str) -> Iterator[None]:
    """A folder for this process alone; made where it is not there.

    Parameters
    ----------
    folder
        The folder.
    name
        Of the lock in it, without a suffix.
    expected, advice
        Words for who is refused: what was expected, and what to do.

    Raises
    ------
    ResultsError
        Another process holds it, who is named; or nobody can write to it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder, held_alone(Path(folder), "run", expected="a free folder", advice="wait"):
    ...     print(sorted(path.name for path in Path(folder).iterdir()))
    ['run.lock', 'run.owner']
    """
    lock_file, owner_file = (folder / f"{name}.{suffix}" for suffix in ("lock", "owner"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(lock_file)
        lock.acquire(timeout=0)
    except Timeout as error:
        raise ResultsError(f"{folder}: expected {expected}, got one in use{_describe(owner_file)}; {advice}") from error
    except (OSError, ValueError, NotImplementedError) as error:
        raise ResultsError(
            f"{folder}: expected a folder to write to, got {getattr(error, 'strerror', None) or error}; choose another"
        ) from error
    try:
        owner = {"process": os.getpid(), "host": socket.gethostname(), "started": datetime.now(UTC).isoformat()}
        write_json(owner_file, owner, label="owner of the folder")
        yield
    finally:
        owner_file.unlink(missing_ok=True)
        lock_file.unlink(missing_ok=True)
        lock.release()


def _describe(owner_file: Path) -> str:
    """Words on who holds a folder; none where that is not known."""
    try:
        owner = json.loads(owner_file.read_text(encoding="utf-8"))
        started = datetime.fromisoformat(owner["started"]).astimezone().strftime("%Y-%m-%d %H:%M:%S")
        return f" by process {owner['process']} on {owner['host']} since {started}"
    except (OSError, ValueError, LookupError, TypeError):
        return ""
