"""``session.toml`` as it is filled in: every change is read from the file and written to it, with its comments."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, cast

import tomlkit
from tomlkit.exceptions import ParseError
from tomlkit.items import AoT, Table

from vfm_sdm.core.files import write_file
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import Session, read_session

__all__ = ["Draft"]


class Draft:
    """A session that may still lack what it needs.

    Parameters
    ----------
    path
        Its file; begun with the first change where there is none.

    Notes
    -----
    The file is all there is, so that an editor or the command line may change it at any time. What is held is how it
    was before each change made here, to take that back.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     draft = Draft(Path(folder, "session.toml"))
    ...     draft.put(("site", "baseline"), {"value": 4.0, "std": 0.005})
    ...     name = draft.add_point("left", (12.0, 7.5))
    ...     print(name, draft.fields["point"][0]["pixel"], draft.fields["site"]["baseline"]["value"])
    point 1 [12.0, 7.5] 4.0
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._before: list[tuple[str, str]] = []
        self._open: tomlkit.TOMLDocument | None = None

    @property
    def fields(self) -> dict[str, Any]:
        """Plain tables of what the file holds.

        Raises
        ------
        SessionError
            The file is not TOML.
        """
        return self._read().unwrap()

    def session(self) -> tuple[Session | None, list[str]]:
        """The session, with or without points, and what is wrong or missing, in sentences.

        Raises
        ------
        SessionError
            The file is not TOML.
        """
        if not self._read().get("view"):
            return None, ["films: expected two, got none; choose them in step 1"]
        try:
            return read_session(self.path, points_needed=False), []
        except SessionError as error:
            found = str(error).removeprefix(f"{self.path}: ")
            lines = [line.strip() for line in found.splitlines()]
            return None, lines[1:] if len(lines) > 1 else lines

    def put(self, path: Sequence[str], value: object | None) -> None:
        """Sets a field, by the names of its tables and its own; ``None`` removes it.

        Parameters
        ----------
        path
            Such as ``("site", "baseline")``; in lists of tables, the name of one stands for its number: ``("view",
            "left", "lens")``.
        value
            What TOML can hold.

        Raises
        ------
        SessionError
            There is no such table in a list, or the file cannot be used.
        """
        with self._changed() as document:
            here: Any = document
            for step in path[:-1]:
                if isinstance(here, AoT):
                    here = self._row(here, step)
                else:
                    if step not in here:
                        if value is None:
                            return
                        here[step] = tomlkit.table()
                    here = here[step]
            _set(here, path[-1], value)

    def set_rows(self, table: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Sets a list of tables as a whole; those of the same name keep what is not said of them.

        Parameters
        ----------
        table
            Such as ``view``.
        rows
            Fields of each, with its ``name``.

        Raises
        ------
        SessionError
            The file cannot be used.
        """
        with self._changed() as document:
            before = {one["name"]: one for one in document.get(table, ())}
            listed = tomlkit.aot()
            for row in rows:
                one = before.get(row["name"], tomlkit.table())
                for key, value in row.items():
                    _set(one, key, value)
                listed.append(one)
            if rows:
                document[table] = listed
            elif table in document:
                del document[table]

    def add_point(self, view: str, pixel: tuple[float, float], *, name: str = "", static: bool = False) -> str:
        """Adds a point; its name, the first free number where none is given.

        Parameters
        ----------
        view
            Where it is named.
        pixel
            Its place there [px].
        name
            Its name.
        static
            Whether it cannot move.

        Raises
        ------
        SessionError
            Another point has that name, or the file cannot be used.
        """
        taken = {str(one.get("name")) for one in self.fields.get("point", ())}
        if name in taken:
            raise SessionError(f"point {name!r}: expected a name of its own, got that of another point; choose another")
        found = name or next(one for number in count(1) if (one := f"point {number}") not in taken)
        fields = {"name": found, "view": view, "pixel": [round(float(one), 3) for one in pixel]}
        with self._changed() as document:
            rows = document.setdefault("point", tomlkit.aot())
            rows.append(cast("Table", _as_item(fields | ({"static": True} if static else {}), inline=False)))
        return found

    def change_point(self, name: str, /, **fields: object) -> None:
        """Changes fields of a point; ``None`` removes one.

        Parameters
        ----------
        name
            The point.
        **fields
            Such as ``name``, ``pixel``, ``static``, ``pixel_in``.

        Raises
        ------
        SessionError
            There is no such point, another one has the new name, or the file cannot be used.
        """
        names = [str(one.get("name")) for one in self.fields.get("point", ())]
        renamed = fields.get("name", name)
        if renamed != name and renamed in names:
            raise SessionError(
                f"point {renamed!r}: expected a name of its own, got that of another point; choose another"
            )
        with self._changed() as document:
            row = self._row(document.get("point", ()), name)
            for key, value in fields.items():
                _set(row, key, value)
            if renamed != name:
                _rename(document, name, str(renamed))

    def move_point(self, name: str, view: str, pixel: tuple[float, float] | None) -> None:
        """Says where a point is in a view; ``None`` leaves another view than its own to the search again.

        Parameters
        ----------
        name
            The point.
        view
            The view.
        pixel
            Its place there [px].

        Raises
        ------
        SessionError
            There is no such point, its own view is to be left to the search, or the file cannot be used.
        """
        place = None if pixel is None else [round(float(one), 3) for one in pixel]
        own: dict[str, Any] = next((one for one in self.fields.get("point", ()) if one.get("name") == name), {})
        if own.get("view") == view:
            if place is None:
                raise SessionError(f"point {name!r}: expected a place in its own view, got none; remove the point")
            self.change_point(name, pixel=place)
            return
        named = {**own.get("pixel_in", {}), view: place}
        kept = {key: value for key, value in named.items() if value is not None}
        self.change_point(name, pixel_in=kept or None)

    def remove_point(self, name: str) -> None:
        """Removes a point, and the lengths and ranges that lead to it.

        Parameters
        ----------
        name
            The point.

        Raises
        ------
        SessionError
            The file cannot be used.
        """
        with self._changed() as document:
            _keep_rows(document, "point", lambda one: one.get("name") != name)
            site = document.get("site", {})
            _keep_rows(site, "range", lambda one: one.get("point") != name)
            for table in ("length", "rectangle"):
                _keep_rows(site, table, lambda one: name not in one.get("points", ()))

    def undo(self) -> None:
        """Takes the last change back that was made here.

        Raises
        ------
        SessionError
            There is none, or the file was changed by others since, or cannot be used.
        """
        if not self._before:
            raise SessionError("undo: expected a change made on this page, got none; correct it in its field")
        before, after = self._before[-1]
        if tomlkit.dumps(self._read()) != after:
            raise SessionError("undo: expected the file as the page left it, got another one; correct it in an editor")
        write_file(self.path, before)
        self._before.pop()

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Writes several changes as one, which is taken back as one."""
        with self._changed() as document:
            self._open = document
            try:
                yield
            finally:
                self._open = None

    @staticmethod
    def _row(rows: Any, name: str) -> Any:
        for one in rows:
            if one.get("name") == name:
                return one
        raise SessionError(f"expected a table named {name!r}, got {[one.get('name') for one in rows]}; reload the page")

    def _read(self) -> tomlkit.TOMLDocument:
        if self._open is not None:
            return self._open
        try:
            return tomlkit.parse(self.path.read_bytes().decode("utf-8-sig"))
        except FileNotFoundError:
            document = tomlkit.document()
            document["name"] = self.path.absolute().parent.name or "session"
            return document
        except (OSError, UnicodeDecodeError, ParseError) as error:
            raise SessionError(f"{self.path}: expected TOML, got: {error}; correct it in an editor") from error

    @contextmanager
    def _changed(self) -> Iterator[tomlkit.TOMLDocument]:
        document = self._read()
        if document is self._open:
            yield document
            return
        before = tomlkit.dumps(document)
        yield document
        after = tomlkit.dumps(document)
        if after != before or not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.path, after)
            self._before.append((before, after))


def _as_item(value: object, *, inline: bool = True) -> Any:
    """A value as TOML writes it: small tables on one line."""
    if not isinstance(value, Mapping):
        return tomlkit.item(value)
    table = tomlkit.inline_table() if inline else tomlkit.table()
    for key, one in value.items():
        table[key] = _as_item(one)
    return table if inline else _apart(table)


def _apart(table: Any) -> Any:
    """A table with an empty line before it."""
    table.trivia.indent = "\n"
    return table


def _set(table: Any, key: str, value: object | None) -> None:
    """Sets a field of a table; nothing removes it."""
    if value is not None:
        table[key] = _as_item(value)
    elif key in table:
        del table[key]


def _rename(document: Any, name: str, renamed: str) -> None:
    """Follows a point's new name where lengths and sensors speak of it."""
    site = document.get("site", {})
    for one in (*site.get("range", ()), *document.get("sensor", ())):
        if one.get("point") == name:
            one["point"] = renamed
    for one in (*site.get("length", ()), *site.get("rectangle", ())):
        if name in one.get("points", ()):
            one["points"] = [renamed if other == name else other for other in one["points"]]


def _keep_rows(table: Any, name: str, wanted: Any) -> None:
    """Keeps some rows of a list of tables, and no empty list."""
    rows = table.get(name)
    if rows is None:
        return
    for index in reversed([i for i, one in enumerate(rows) if not wanted(one)]):
        del rows[index]
    if not len(rows):
        del table[name]
