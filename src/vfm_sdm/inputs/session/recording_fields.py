"""Types of the fields that say of a recording which files it has, when it began and what of it is used."""

from datetime import datetime
from pathlib import Path
from typing import Annotated

from pydantic import AwareDatetime, BeforeValidator, PlainSerializer

__all__ = ["Files", "Instant", "Interval", "count_from"]

_LONGEST_S = 1e9


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
    """From, or from and to [s]."""
    if value is None:
        return None
    bounds = list(value) if isinstance(value, list | tuple) else []
    numbers = [one for one in bounds if isinstance(one, int | float) and not isinstance(one, bool)]
    if not 1 <= len(numbers) == len(bounds) <= 2:
        raise ValueError(f"expected [from] or [from, to] in seconds, or both as dates and times, got {value!r}")
    if not 0 <= numbers[0] <= _LONGEST_S:
        raise ValueError(f"expected to begin with the first frame (0 s) or later, got {value!r}; correct it")
    if len(numbers) == 2 and not numbers[0] < numbers[1] <= _LONGEST_S:
        raise ValueError(f"expected a beginning before the end, got {value!r}; swap or correct them")
    return tuple(float(one) for one in numbers)


def count_from(start: object, bounds: object) -> object:
    """Bounds of an interval in seconds, where they are dates and times; others as they are.

    Parameters
    ----------
    start
        When the first frame was taken.
    bounds
        The bounds, as they stand in a session file.

    Raises
    ------
    ValueError
        They are dates and times, and nobody says when the first frame was taken.

    Examples
    --------
    >>> count_from("2026-11-20T10:15:30Z", ["2026-11-20T10:16:00Z", "2026-11-20T11:15:30.5+01:00"])
    [30.0, 0.5]
    """
    if not isinstance(bounds, list | tuple) or not bounds:
        return bounds
    instants, begin = [_read_instant(one) for one in bounds], _read_instant(start)
    known = [one for one in instants if one is not None]
    if len(known) < len(bounds):
        return bounds
    if begin is None:
        raise ValueError("use_s: expected start beside dates and times, got none; state when the first frame was taken")
    return [(one - begin).total_seconds() for one in known]


def _read_instant(value: object) -> datetime | None:
    """A time with its offset from UTC; ``None`` for anything else."""
    try:
        read = datetime.fromisoformat(value) if isinstance(value, str) else value
    except ValueError:
        return None
    return read if isinstance(read, datetime) and read.tzinfo is not None else None


Files = Annotated[Path | tuple[Path, ...] | None, BeforeValidator(_files), PlainSerializer(_write_files)]
"""A file, a pattern, or a list of files in the order in which they were recorded."""
Interval = Annotated[tuple[float, ...] | None, BeforeValidator(_interval)]
"""[from] or [from, to] in seconds."""
