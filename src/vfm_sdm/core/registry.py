"""Interchangeable parts found by name: this package's own and other packages', made with a session's settings.

A part is imported only when it is asked for. It is given only the fields of ``[method]`` that it declares to read, so a
key made of `settings_read` and `code_modules` cannot leave out a setting that the part depends on.
"""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from operator import attrgetter
from typing import Any

from pydantic import BaseModel

from vfm_sdm.core.parts import BUILT_IN, KINDS, Kind, Part, PartSettings
from vfm_sdm.core.plugins import announced, load_plugin, origin
from vfm_sdm.errors import BackendUnavailableError

__all__ = [
    "Part",
    "chosen_name",
    "code_modules",
    "explain_unknown",
    "find",
    "make",
    "part_names",
    "parts_of",
    "settings_model",
    "settings_read",
    "table_names",
]


def part_names(kind: Kind) -> list[str]:
    """Names of all parts of a kind, this package's own first; nothing is imported.

    Examples
    --------
    >>> part_names("trackers")[:2]
    ['icgn', 'template']
    """
    return [*BUILT_IN[kind], *sorted(set(announced(kind)) - set(BUILT_IN[kind]))]


def explain_unknown(kind: Kind, name: str) -> str | None:
    """Message on a name that no part has (expected, got, do); ``None`` where there is such a part.

    Examples
    --------
    >>> explain_unknown("trackers", "icng").rpartition("; ")[2]
    "did you mean 'icgn'?"
    """
    if name in BUILT_IN[kind]:
        return None
    known = sorted(part_names(kind))
    if name in known:
        return None
    close = get_close_matches(name, known, n=1)
    advice = f"did you mean {close[0]!r}?" if close else "choose one of these, or install the package that brings it"
    return f"expected one of {known}, got {name!r}; {advice}"


def find(kind: Kind, name: str) -> Part:
    """The part of this name. Another package's is imported, this package's is not.

    Raises
    ------
    BackendUnavailableError
        There is no such part, several packages claim the name, or the package that brings it is broken.

    Examples
    --------
    >>> find("trackers", "icgn").module
    'vfm_sdm.stages.tracking.icgn'
    """
    if unknown := explain_unknown(kind, name):
        raise BackendUnavailableError(f"{KINDS[kind].word}: {unknown}")
    plugins = announced(kind).get(name, ())
    claims = [*(["vfm-sdm"] if name in BUILT_IN[kind] else []), *map(origin, plugins)]
    if len(claims) > 1:
        raise BackendUnavailableError(
            f"{KINDS[kind].word} {name!r}: expected one package that brings it, got {' and '.join(claims)}; "
            f"uninstall {claims[-1].split()[0]}, or let it choose another name"
        )
    return load_plugin(kind, plugins[0]) if plugins else BUILT_IN[kind][name]


def chosen_name(kind: Kind, method: object) -> str:
    """Name of the part of this kind that ``[method]`` of a session asks for.

    Examples
    --------
    >>> from vfm_sdm.inputs.session import Method
    >>> chosen_name("trackers", Method())
    'icgn'
    """
    return str(attrgetter(KINDS[kind].field)(method))


def parts_of(kind: Kind, name: str, method: object | None = None) -> dict[tuple[Kind, str], Part]:
    """A part and all those that it is made of, by kind and name, itself first.

    Parameters
    ----------
    kind, name
        Kind and name of the part.
    method
        ``[method]`` of a session: with it, the parts that the session chooses for this one are among them.

    Raises
    ------
    BackendUnavailableError
        One of them is unknown or broken.
    """
    part = find(kind, name)
    found = {(kind, name): part}
    for other, called in part.made_of:
        found |= parts_of(other, called, method)
    for other in part.chooses if method is not None else ():
        found |= parts_of(other, chosen_name(other, method), method)
    return found


def make(kind: Kind, method: object) -> Any:
    """The part that a session asks for, with the session's settings; ``None`` where whoever asks has it built in.

    Parameters
    ----------
    kind
        Kind of the part, one of those that a session names.
    method
        ``[method]`` of the session, with paths resolved.

    Raises
    ------
    BackendUnavailableError
        No part has this name, or it cannot run here.
    """
    name = chosen_name(kind, method)
    part = find(kind, name)
    reads = {read for one in parts_of(kind, name).values() for read in one.reads}
    roots = sorted({read.partition(".")[0] for read in reads})
    read = {root: _only(root, reads, method, name) for root in roots}
    # What a session leaves open is left to the part.
    options = {root: value for root, value in read.items() if value is not None}
    options |= {other: make(other, method) for other in part.chooses}
    if part.settings and name in _tables(method):
        options["settings"] = _tables(method)[name]
    return part.make(**options)


def settings_read(kind: Kind, method: object) -> dict[str, Any]:
    """Settings of ``[method]`` that the chosen part and its own parts read, by dotted name, ready for JSON.

    The name of the part is among them; a table of its own is under the part's name, unless the session has none, which
    stands for its defaults.

    Raises
    ------
    BackendUnavailableError
        A part is unknown or broken, or declares to read a field that there is not.

    Examples
    --------
    >>> from vfm_sdm.inputs.session import Method
    >>> settings_read("trackers", Method(subset_px=31))
    {'tracker': 'icgn', 'subset_px': 31}
    >>> settings_read("cameras", Method(cameras="sfm"))
    {'cameras': 'sfm', 'matching': 'sift'}
    """
    settings: dict[str, Any] = {KINDS[kind].field: chosen_name(kind, method)}
    for (_, name), part in parts_of(kind, chosen_name(kind, method), method).items():
        settings |= {KINDS[other].field: chosen_name(other, method) for other in part.chooses}
        settings |= {read: _plain(_field(method, read, name)) for read in part.reads}
        if part.settings and name in _tables(method):
            settings[name] = _plain(_tables(method)[name])
    return settings


def code_modules(kind: Kind, method: object) -> tuple[str, ...]:
    """Modules with the code of the chosen part and its own parts; for other packages, name and version too.

    Returns
    -------
    modules
        Dotted names, and for every package that brings one of the parts ``name version``, the only ones with a space.

    Raises
    ------
    BackendUnavailableError
        A part is unknown or broken.

    Examples
    --------
    >>> from vfm_sdm.inputs.session import Method
    >>> code_modules("trackers", Method(tracker="tapir+icgn"))[1:]
    ('vfm_sdm.stages.tracking.icgn', 'vfm_sdm.stages.tracking.tapir')
    """
    parts = parts_of(kind, chosen_name(kind, method), method).values()
    return tuple(sorted({text for part in parts for text in (part.module, part.distribution) if text}))


def table_names() -> list[str]:
    """Names of parts that may have a table of their own in ``[method]``; nothing is imported."""
    kinds = [kind for kind, info in KINDS.items() if info.field]
    own = {name for kind in kinds for name, part in BUILT_IN[kind].items() if part.settings}
    return sorted(own.union(*(announced(kind) for kind in kinds)))


def settings_model(name: str) -> type[PartSettings] | None:
    """The model of the table ``[method.NAME]``; ``None`` where no part of this name has one.

    Raises
    ------
    BackendUnavailableError
        The part cannot be loaded, or two parts of this name have different models.
    """
    kinds = [kind for kind, info in KINDS.items() if info.field and name in part_names(kind)]
    models = {model for kind in kinds if (model := find(kind, name).settings_model()) is not None}
    if len(models) > 1:
        raise BackendUnavailableError(
            f"expected one model of these settings, got {' and '.join(sorted(map(str, models)))}; "
            "let one of the parts choose another name"
        )
    return models.pop() if models else None


def _only(root: str, reads: Iterable[str], method: object, name: str) -> Any:
    """A field of ``[method]``; of a table, the declared keys, with the defaults in place of all others."""
    value = _field(method, root, name)
    if root in reads or not isinstance(value, BaseModel):
        return value
    declared = {read.partition(".")[2] for read in reads if read.startswith(f"{root}.")}
    others = {
        key: field.get_default(call_default_factory=True, validated_data={})
        for key, field in type(value).model_fields.items()
    }
    return value.model_copy(update={key: default for key, default in others.items() if key not in declared})


def _field(method: object, dotted: str, name: str) -> Any:
    try:
        return attrgetter(dotted)(method)
    except AttributeError as error:
        raise BackendUnavailableError(
            f"{name}: expected it to read fields of [method], got {dotted!r}, which there is not; correct its `reads`"
        ) from error


def _tables(method: object) -> Mapping[str, PartSettings]:
    """Parts' own tables in ``[method]`` by the parts' names."""
    return getattr(method, "model_extra", None) or {}


def _plain(value: Any) -> Any:
    return value.model_dump(mode="json") if isinstance(value, BaseModel) else value
