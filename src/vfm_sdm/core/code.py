"""Code that makes a product: modules that a function reaches through its imports, and one hash of their text."""

import hashlib
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["code_hash", "modules_used"]

_ROOT = Path(__file__).resolve().parents[1]
_PACKAGE = _ROOT.name
_IMPORT = re.compile(
    rf"^[ \t]*(?:from[ \t]+({_PACKAGE}[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n#]*)|import[ \t]+({_PACKAGE}[\w.]+))",
    re.MULTILINE,
)


def modules_used(function: Callable[..., Any]) -> frozenset[str]:
    """Dotted names of the modules of this package whose contents a function uses.

    Parameters
    ----------
    function
        A function of this package.

    Examples
    --------
    >>> from vfm_sdm.signals.clocks import interpolate
    >>> sorted(modules_used(interpolate))
    ['vfm_sdm.signals.resampling']
    """
    named = (function.__globals__.get(name) for name in _names(function.__code__))
    found = (getattr(one, "__module__", None) or getattr(one, "__name__", "") for one in named if one is not None)
    return frozenset(
        m for m in found if isinstance(m, str) and m.split(".")[0] == _PACKAGE and m != function.__module__
    )


@cache
def code_hash(modules: frozenset[str], *, also: str = "") -> str:
    """SHA-256 of the text of these modules and of all modules of this package that they import, as 64 digits.

    Parameters
    ----------
    modules
        Dotted names; those outside this package count by themselves, without what they import.
    also
        Further text that enters the hash.

    Notes
    -----
    Imports are read from the text, those inside functions too, because networks are imported where they are used.
    The package's own ``__init__``, which names everything, is left out.
    """
    digest = hashlib.sha256(also.encode())
    for name in sorted(_reached(modules)):
        digest.update(name.encode() + b"\0" + _text(name).encode() + b"\0")
    return digest.hexdigest()


def _reached(modules: frozenset[str]) -> set[str]:
    found: set[str] = set()
    ahead = set(modules)
    while ahead:
        name = ahead.pop()
        found.add(name)
        ahead |= _imports(name) - found
    return found


@cache
def _imports(module: str) -> frozenset[str]:
    """Modules of this package that a module of it imports."""
    if module.split(".", maxsplit=1)[0] != _PACKAGE:
        return frozenset()
    return frozenset(_imported(_text(module)))


def _imported(text: str) -> Iterator[str]:
    for source, names, plain in _IMPORT.findall(text):
        for name in (source, plain):
            if name and name != _PACKAGE and _file(name) is not None:
                yield name
        for name in re.findall(r"\w+", names):
            if source and _file(f"{source}.{name}") is not None:
                yield f"{source}.{name}"


@cache
def _text(module: str) -> str:
    path = _file(module)
    return "" if path is None else path.read_text(encoding="utf-8")


def _file(module: str) -> Path | None:
    """File with a module's text; ``None`` where there is none."""
    first, *rest = module.split(".")
    if first != _PACKAGE:
        loaded = getattr(sys.modules.get(module), "__file__", None)
        return Path(loaded) if loaded and loaded.endswith(".py") else None
    place = _ROOT.joinpath(*rest)
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None


def _names(code: Any) -> set[str]:
    """Names that a function's code uses, those of functions inside it included."""
    inside = (c for c in code.co_consts if hasattr(c, "co_names"))
    return set(code.co_names).union(*map(_names, inside))
