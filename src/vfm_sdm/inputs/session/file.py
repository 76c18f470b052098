"""``session.toml`` on disk: reading with clear messages, writing without half-written files, hashing."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import tomli_w

from vfm_sdm.core.files import write_file
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session.defaults import Defaults
from vfm_sdm.inputs.session.method import table_paths
from vfm_sdm.inputs.session.model import Session
from vfm_sdm.inputs.session.toml import read_fields, refuse_faults

__all__ = ["read_session", "session_hash", "write_session"]


def read_session(
    path: Path | str, *, check_files: bool = True, points_needed: bool = True, defaults: Defaults | None = None
) -> Session:
    """The session in a TOML file; relative paths in it start at the file's folder.

    Parameters
    ----------
    path
        The file.
    check_files
        Whether the videos and other files that it names must be there.
    points_needed
        Whether it must name a point; not for what finds them.
    defaults
        What the file need not say (`vfm_sdm.inputs.session.defaults`).

    Raises
    ------
    SessionError
        The file is missing or is not TOML (the message gives the line), or lists every fault in it, one a line.
    """
    source = Path(path)
    fields, faults = read_fields(source, "session file")
    if defaults is not None:
        fields = defaults.under(fields)
    try:
        session = Session(**fields, folder=source.absolute().parent)
        if points_needed:
            session.check_points()
    except SessionError as error:
        faults.append(str(error))
    else:
        faults += list(_missing_files(session)) if check_files else []
    refuse_faults(source, faults, below="" if defaults is None else f" over {defaults.path}")
    return session


def write_session(path: Path | str, session: Session) -> Path:
    """Writes a session with all its settings, defaults included, as TOML.

    Written to another folder than `Session.folder`, its relative paths are rewritten so that they lead to the same
    files. An earlier file is replaced only when the new one is complete.

    Raises
    ------
    SessionError
        The file cannot be written.
    """
    target = Path(path)
    # TOML has no null: an absent key says the same.
    fields = session.model_dump(mode="json", exclude_none=True)
    for lens in (view.get("lens", {}) for view in fields["view"]):
        if {"file", "camera"} & lens.keys():
            del lens["relative_std"]  # they state their own, and are refused beside another
    _move_paths(_path_entries(session, fields), session.folder.absolute(), target.absolute().parent)
    return write_file(target, tomli_w.dumps(_without_empty(fields)))


def session_hash(session: Session) -> str:
    """SHA-256 of everything the session says of the measurement, as 64 hexadecimal digits.

    Independent of the order and spelling of the file, of whether a default is written out, of the folder, and of what
    is said for a report alone; the contents of the files that it names do not enter (see `file_hash`).
    """
    # Who fills in the client's name after the measurement has not measured another session.
    fields = session.model_dump(mode="json")
    fields.pop("report", None)
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _without_empty(value: Any) -> Any:
    """The same tables without empty lists and tables, which only clutter the file."""
    if isinstance(value, dict):
        pruned = {key: _without_empty(inner) for key, inner in value.items()}
        return {key: inner for key, inner in pruned.items() if inner not in ([], {})}
    return [_without_empty(inner) for inner in value] if isinstance(value, list) else value


def _path_entries(session: Session, fields: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """Every table of a dumped session that holds a path or pattern, with its key."""
    for name, table in session.method.tables.items():
        yield from ((fields["method"][name], key) for key in table_paths(table))
    if "baseline_visit" in fields:
        yield fields, "baseline_visit"
    yield from ((view["lens"], "file") for view in fields["view"] if "file" in view.get("lens", {}))
    for table in (*fields["view"], *fields["sensor"], fields.get("chessboard", {})):
        for key in ("video", "images", "camera", "file", "corners"):
            if isinstance(table.get(key), dict):
                yield from ((table[key], view) for view in table[key])
            elif key in table:
                yield table, key


def _move_paths(entries: Iterable[tuple[dict[str, Any], str]], start: Path, end: Path) -> None:
    if start == end:
        return
    for table, key in entries:
        named = table[key]
        moved = [_move_path(one, start, end) for one in (named if isinstance(named, list) else [named])]
        table[key] = moved if isinstance(named, list) else moved[0]


def _move_path(path: str, start: Path, end: Path) -> str:
    return path if Path(path).is_absolute() else Path(os.path.relpath(start / path, end)).as_posix()


def _missing_files(session: Session) -> Iterator[str]:
    files = [(f"view[{view.name}].camera", view.camera) for view in session.view]
    files += [(f"view[{view.name}].lens.file", view.lens.file) for view in session.view if view.lens is not None]
    files += [(f"sensor[{sensor.name}].file", sensor.file) for sensor in session.sensor]
    patterns = [(f"view[{view.name}].images", view.images) for view in session.view]
    for view in session.view:
        label = f"view[{view.name}].video"
        for one in view.video if isinstance(view.video, tuple) else (view.video,):
            # A file's own name may hold brackets.
            if one is not None and set("*?[") & set(str(one)) and not session.resolve(one).exists():
                patterns.append((label, str(one)))
            else:
                files.append((label, one))
    if session.chessboard is not None:
        files.append(("chessboard.corners", session.chessboard.corners))
        images = session.chessboard.images or {}
        patterns += [(f"chessboard.images.{view}", pattern) for view, pattern in images.items()]
    visit = session.baseline_visit
    if visit is not None and not session.resolve(visit).is_dir():
        yield f"baseline_visit: expected the run folder of an earlier visit at {visit}, got none; correct the path"
    for label, file in files:
        if file is not None and not session.resolve(file).is_file():
            found = "a folder" if session.resolve(file).is_dir() else "no such file"
            yield f"{label}: expected a file at {file}, got {found}; correct the path, seen from the session's folder"
    for label, pattern in patterns:
        if pattern is not None and not any(_matches(session.resolve_pattern(pattern))):
            yield f"{label}: expected files that match {pattern}, got none; correct the pattern"


def _matches(pattern: str) -> Iterator[Path]:
    path = Path(pattern)
    return Path(path.anchor).glob(str(path.relative_to(path.anchor)))
