"""Parts that other packages announce through entry points; they are imported only when they are used."""

import re
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any, get_args

from vfm_sdm.core.parts import KINDS, Kind, Needs, Part, PartSettings, Requirement
from vfm_sdm.errors import BackendUnavailableError

__all__ = ["announced", "load_plugin", "origin"]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]*")
"""A key of TOML without dots, and a part of a file's name."""
_REMEDY = "repair or uninstall that package"
_DECLARED = {"reads": tuple, "made_of": tuple, "chooses": tuple, "needs": Needs, "requires": tuple}
"""Fields of `Part` that a class states as its attributes, and their types."""


def announced(kind: Kind) -> Mapping[str, tuple[EntryPoint, ...]]:
    """Entry points of a kind by name; several where packages announce the same name. Nothing is imported.

    Parameters
    ----------
    kind
        Kind of the parts.
    """
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for entry in _list_entries(KINDS[kind].group, tuple(sys.path)):
        found[entry.name] = (*found.get(entry.name, ()), entry)
    return found


@lru_cache(maxsize=len(KINDS))
def _list_entries(group: str, path: tuple[str, ...]) -> EntryPoints:
    """Entry points of packages on this path, whose files are read once: a measurement asks some hundred times."""
    del path  # by which answers are told apart
    return entry_points(group=group)


def origin(entry: EntryPoint) -> str:
    """Name and version of the package that announces an entry point.

    Parameters
    ----------
    entry
        The entry point.
    """
    return "an unnamed package" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def load_plugin(kind: Kind, entry: EntryPoint) -> Part:
    """The part of an entry point, with the declarations of its class.

    The class may have the attributes ``reads``, ``made_of``, ``chooses``, ``needs`` and ``requires``, with the meaning
    that they have for `vfm_sdm.core.parts.Part`, and ``Settings``, the model of its table ``[method.NAME]``.

    Raises
    ------
    BackendUnavailableError
        The part cannot be imported, or does not have what a part of this kind needs.
    """
    info = KINDS[kind]
    label = f"{info.word} {entry.name!r} of {origin(entry)}"
    if not _NAME.fullmatch(entry.name):
        raise BackendUnavailableError(f"{label}: expected a name of letters, digits, -, _, +, got others; {_REMEDY}")
    try:
        made = entry.load()
    # Other people's code may fail in any way, and must not take down what does not use it.
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise BackendUnavailableError(f"{label}: expected to import {entry.value}, got {reason}; {_REMEDY}") from error
    declared = {name: getattr(made, name) for name in (*_DECLARED, "Settings") if hasattr(made, name)}
    if fault := _fault(kind, made, declared):
        raise BackendUnavailableError(f"{label}: {fault}; {_REMEDY}")
    has_settings = declared.pop("Settings", None) is not None
    target = f"{entry.module}:{entry.attr}"
    settings = f"{target}.Settings" if has_settings else ""
    return Part(target, **declared, settings=settings, distribution=origin(entry))


def _fault(kind: Kind, made: Any, declared: Mapping[str, Any]) -> str | None:
    """Sentence on what is wrong with a loaded part or its declarations; ``None`` where nothing is."""
    method = KINDS[kind].calls
    if method and not (isinstance(made, type) and callable(getattr(made, method, None))):
        return f"expected a class with the method {method}, got {made!r:.60}"
    if not callable(made):
        return f"expected a function, got {made!r:.60}"
    for name, value in declared.items():
        if name == "Settings" and not (isinstance(value, type) and issubclass(value, PartSettings)):
            return f"expected Settings to derive from vfm_sdm.core.parts.PartSettings, got {value!r:.60}"
        wanted = _DECLARED.get(name, type)
        if not isinstance(value, wanted):
            return f"expected {name} to be a {wanted.__name__}, got {value!r:.60}"
    unknown = set(declared.get("requires", ())) - set(get_args(Requirement))
    return f"expected requires of {get_args(Requirement)}, got {sorted(unknown)}" if unknown else None
