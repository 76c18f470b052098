"""Defaults that many sessions share: a part of a session, which each of them overrides."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vfm_sdm.inputs.session.faults import NAMED
from vfm_sdm.inputs.session.model import Session
from vfm_sdm.inputs.session.toml import read_fields, refuse_faults

__all__ = ["Defaults", "read_defaults"]

_TABLES = ("site", "method", "chessboard")
"""Tables of the session that are merged key by key."""
_INNER = {"site": ("lines",), "method": None}
"""Tables in these that are merged key by key, too; all of them for ``None``."""


@dataclass(frozen=True)
class Defaults:
    """What sessions take where they say nothing themselves.

    Parameters
    ----------
    path
        File that says so.
    fields
        Its content, as TOML holds it.

    Examples
    --------
    >>> defaults = Defaults(Path("all.toml"), {"view": [{"name": "left", "fps": 30.0}], "method": {"scale_limit": 0.1}})
    >>> defaults.under({"view": [{"name": "left", "images": "*.png"}], "method": {"refinement": "sgr"}})
    {'view': [{'name': 'left', 'fps': 30.0, 'images': '*.png'}], 'method': {'scale_limit': 0.1, 'refinement': 'sgr'}}
    """

    path: Path
    fields: Mapping[str, Any]

    def under(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        """The fields of a session with the defaults below them.

        Parameters
        ----------
        fields
            Raw content of the session's file.

        Notes
        -----
        Tables are merged key by key; ``view``, ``point`` and ``sensor`` entry by entry: which entries there are, the
        session says, where it says anything of them, and each takes what it lacks from the default of its name. Every
        other value of the session takes the place of the default as a whole, also lists and tables in braces.
        """
        return {**self.fields, **{key: _merge(self.fields.get(key), value, key) for key, value in fields.items()}}


def read_defaults(path: Path | str) -> Defaults:
    """Defaults from a TOML file: a session file of which anything may be missing.

    Parameters
    ----------
    path
        The file. Relative paths in it are those of every session: they start at the folder of the session's file.

    Raises
    ------
    SessionError
        The file is missing or is not TOML, a key is unknown or has an impossible value, or an entry of a list has no
        name of its own.
    """
    source = Path(path)
    fields, faults = read_fields(source, "file of defaults")
    refuse_faults(source, [*faults, *Session.partial_faults(fields)])
    return Defaults(source, fields)


def _merge(default: Any, value: Any, key: str) -> Any:
    """A session's value of a key over its default; values of wrong types are left to the session's own checks."""
    if key in NAMED and isinstance(default, list) and isinstance(value, list):
        known = {entry["name"]: entry for entry in default}
        return [
            {**known.get(str(entry.get("name")), {}), **entry} if isinstance(entry, Mapping) else entry
            for entry in value
        ]
    if key not in _TABLES or not (isinstance(default, Mapping) and isinstance(value, Mapping)):
        return value
    merged = {**default, **value}
    for name in default.keys() & value.keys():
        inner = _INNER.get(key, ())
        if (inner is None or name in inner) and isinstance(default[name], Mapping) and isinstance(value[name], Mapping):
            merged[name] = {**default[name], **value[name]}
    return merged
