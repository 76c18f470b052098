"""Files of one table that are not sessions, such as those of cameras and lenses: read into their models."""

import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from vfm_sdm.errors import CameraError
from vfm_sdm.inputs.session.faults import field_faults

__all__ = ["read_entry"]

_Model = TypeVar("_Model", bound=BaseModel)


def read_entry(path: Path | str, model: type[_Model], *, what: str, advice: str = "check the path") -> _Model:
    """The table in a TOML file.

    Parameters
    ----------
    path
        The file.
    model
        What it holds.
    what
        Its kind, such as ``camera file``, for messages.
    advice
        What to do where there is none.

    Raises
    ------
    CameraError
        The file is absent or no TOML, or a key is unknown, missing or has an impossible value.
    """
    try:
        # "utf-8-sig" because some editors begin a file with a byte order mark, which TOML does not know.
        document = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise CameraError(f"{path}: expected a {what}, got none: {error.strerror}; {advice}") from error
    except ValueError as error:  # malformed TOML, or no text at all
        raise CameraError(f"{path}: expected TOML, got: {error}; correct that line") from error
    try:
        return model(**document)
    except ValidationError as error:
        raise CameraError(f"{path}: " + "; ".join(field_faults(error, model, document))) from error
