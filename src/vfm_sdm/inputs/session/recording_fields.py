"""Types of the fields that say of a recording which files it has, when it began and what of it is used."""

from datetime import datetime
from pathlib import Path
from typing import Annotated

from pydantic import AwareDatetime, BeforeValidator, PlainSerializer

__all__ = ["Files", "Instant", "Interval"]


def _instant(value: object) -> object:
    if not isinstance(value, (str, datetime)):
        # pydantic would take a number for seconds since 1970; it reports a ValueError with the key, a TypeError not.
        raise ValueError(f"expected a date and time such as 2026-11-20T10:15:30.25Z, got {value!r}")  # noqa: TRY004
    return value


Instant = Annotated[AwareDatetime, BeforeValidator(_instant)]


def _write_files(files: Path | tuple[Path, ...] | None) -> str | list[str] | None:
    if files is None:
        return None
    return [one.as_posix() for one in files] if isinstance(files, tuple) else files.as_posix()


def _files(value: object) -> object:
    """One file, or the chapters of a recording in their order."""
    if value is None:
        return None
    many = list(value) if isinstance(value, list | tuple) else [value]
    files = [Path(one) for one in many if isinstance(one, str | Path) and str(one)]
    if not files or len(files) < len(many):
        raise ValueError(f"expected a file, a pattern, or a list of files, got {value!r}; name the recording")
    return tuple(files) if isinstance(value, list | tuple) else files[0]


def _interval(value: object) -> object:
    """From, or from and to: seconds, or dates and times."""
    if value is None:
        return None
    bounds = list(value) if isinstance(value, list | tuple) else []
    dated = [isinstance(one, str | datetime) for one in bounds]
    numbers = [isinstance(one, int | float) and not isinstance(one, bool) for one in bounds]
    if not 1 <= len(bounds) <= 2 or not (all(dated) or all(numbers)):
        raise ValueError(f"expected [from] or [from, to] in seconds, or both as dates and times, got {value!r}")
    if all(dated):
        try:
            bounds = [datetime.fromisoformat(one) if isinstance(one, str) else one for one in bounds]
        except ValueError as error:
            raise ValueError(f"expected dates and times such as 2026-11-20T10:15:30Z, got {value!r}") from error
        if any(one.tzinfo is None for one in bounds):
            raise ValueError(f"expected times with their offset from UTC, got {value!r}; add Z or +01:00")
    elif bounds[0] < 0:
        raise ValueError(f"expected seconds from the recording's first frame on, got {value!r}; begin at 0 or later")
    if len(bounds) == 2 and not bounds[0] < bounds[1]:
        raise ValueError(f"expected a beginning before the end, got {value!r}; swap or correct them")
    return tuple(bounds)


Files = Annotated[Path | tuple[Path, ...] | None, BeforeValidator(_files), PlainSerializer(_write_files)]
"""A file, a pattern, or a list of files in the order in which they were recorded."""
Interval = Annotated[tuple[float | datetime, ...] | None, BeforeValidator(_interval)]
"""[from] or [from, to]: seconds, or dates and times."""
