"""TOML files with the fields of sessions as people write them, and what is wrong with them."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vfm_sdm.errors import SessionError

__all__ = ["read_fields", "refuse_faults"]


def read_fields(source: Path, what: str) -> tuple[dict[str, Any], list[str]]:
    """The fields of a session, or of a part of one, in a TOML file, and what is wrong with them as such.

    Parameters
    ----------
    source
        The file.
    what
        Its kind, such as ``session file``, for messages.

    Raises
    ------
    SessionError
        The file is missing or is not TOML; the message gives the line.
    """
    try:
        # The signature, because some editors begin a file with a byte order mark, which TOML does not know.
        fields = tomllib.loads(source.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError as error:
        raise SessionError(f"{source}: expected a {what}, got no such file; check the path") from error
    except OSError as error:
        raise SessionError(f"{source}: expected a readable {what}, got: {error.strerror}; check it") from error
    except UnicodeDecodeError as error:
        raise SessionError(
            f"{source}: expected text in UTF-8, got another at byte {error.start}; save it so"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise SessionError(f"{source}: expected TOML, got: {error}; correct that line") from error
    except RecursionError as error:
        raise SessionError(f"{source}: expected tables, got brackets nested without end; correct the file") from error
    # A field of the model and none of the file.
    if fields.pop("folder", None) is None:
        return fields, []
    return fields, ["folder: expected no such key, it is where the file lies; remove it"]


def refuse_faults(source: Path, faults: Sequence[str], *, below: str = "") -> None:
    """Refuses a file with faults, all of them in one message.

    Parameters
    ----------
    source
        The file.
    faults
        What is wrong with it, in sentences; some may have several lines.
    below
        What else its content comes from, for the message.

    Raises
    ------
    SessionError
        There are any; the message has a line for each.
    """
    lines = [line for fault in faults for line in fault.splitlines()]
    if lines:
        head = f"{source}{below}: " if len(lines) == 1 else f"{source}{below}: {len(lines)} faults\n  "
        raise SessionError(head + "\n  ".join(lines))
