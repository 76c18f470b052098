"""Parts that other packages announce through entry points, looked for when asked and imported only when used."""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points

from vfm_sdm.core.parts import KINDS, Kind, Needs, Part
from vfm_sdm.errors import BackendUnavailableError

__all__ = ["announced", "load_plugin", "origin"]


def announced(kind: Kind) -> Mapping[str, tuple[EntryPoint, ...]]:
    """Entry points of a kind by name; several where packages announce the same name. Nothing is imported."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for entry in entry_points(group=KINDS[kind].group):
        found[entry.name] = (*found.get(entry.name, ()), entry)
    return found


def origin(entry: EntryPoint) -> str:
    """Name and version of the package that announces an entry point."""
    return "an unnamed package" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def load_plugin(kind: Kind, entry: EntryPoint) -> Part:
    """The part of an entry point, with what its class says of itself.

    The class may have the attributes ``reads``, ``made_of``, ``chooses``, ``needs`` and ``requires``, with the meaning
    that they have for `vfm_sdm.core.parts.Part`, and ``Settings``, the pydantic model of its table ``[method.NAME]``.

    Raises
    ------
    BackendUnavailableError
        It cannot be imported, or is not what a part of this kind has to be.
    """
    info = KINDS[kind]
    label = f"{info.word} {entry.name!r} of {origin(entry)}"
    try:
        made = entry.load()
    # Other people's code may fail in any way, and must not take down what does not use it.
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise BackendUnavailableError(
            f"{label}: expected to import {entry.value}, got {reason}; repair or uninstall that package"
        ) from error
    if not callable(getattr(made, info.calls, None) if info.calls else made):
        wanted = f"a class with the method {info.calls}" if info.calls else "a function"
        raise BackendUnavailableError(f"{label}: expected {wanted}, got {made!r:.60}; repair or uninstall that package")
    needs = getattr(made, "needs", None)
    return Part(
        entry.value.partition("[")[0].strip(),
        reads=tuple(getattr(made, "reads", ())),
        made_of=tuple(getattr(made, "made_of", ())),
        chooses=tuple(getattr(made, "chooses", ())),
        settings=f"{entry.module}:{entry.attr}.Settings" if hasattr(made, "Settings") else "",
        needs=needs if isinstance(needs, Needs) else None,
        requires=tuple(getattr(made, "requires", ())),
        distribution=origin(entry),
    )
