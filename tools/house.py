"""Counts what keeps the house in order, and draws its layout from the imports.

Run as ``python tools/house.py`` it prints each count beside its limit and names every place beyond it; the exit status
is then 1. ``--picture docs/house.svg`` draws the rooms and which of them use which.
"""

import argparse
import ast
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from house_picture import draw, find_way

PACKAGE = Path(__file__).resolve().parents[1] / "src" / "vfm_sdm"
MOST_AT_ROOT, MOST_LINES, MOST_BODY_LINES, MOST_ARGUMENTS = 4, 500, 60, 6
_FLOORS_OF_ROOMS = ("analysis", "inputs", "outputs", "stages", "studies")
_NO_ROOMS = ("__init__", "__main__", *_FLOORS_OF_ROOMS)


@dataclass
class Count:
    """One count.

    Parameters
    ----------
    what
        What is counted.
    limit
        The most that is allowed.
    places
        Each one, as ``path:line name number``.
    """

    what: str
    limit: int
    places: list[str] = field(default_factory=list)

    @property
    def kept(self) -> bool:
        """Whether there are no more than allowed."""
        return len(self.places) <= self.limit


def count_all(package: Path) -> list[Count]:
    """All counts of a package's sources."""
    root = Count("modules at the root", MOST_AT_ROOT, sorted(p.name for p in package.glob("*.py")))
    files = Count(f"files over {MOST_LINES} lines", 0)
    bodies = Count(f"functions over {MOST_BODY_LINES} lines without their docstring", 0)
    arguments = Count(f"functions over {MOST_ARGUMENTS} arguments", 0)
    for path in sorted(package.rglob("*.py")):
        text, name = path.read_text(encoding="utf-8"), path.relative_to(package)
        lines = text.count("\n")
        if lines > MOST_LINES:
            files.places.append(f"{name}:1 {lines}")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                where = f"{name}:{node.lineno} {node.name}"
                if (length := _body_lines(node)) > MOST_BODY_LINES:
                    bodies.places.append(f"{where} {length}")
                if (count := _arguments(node)) > MOST_ARGUMENTS:
                    arguments.places.append(f"{where} {count}")
    imports = read_imports(package)
    rooms = Count("circles of rooms", 0, [" -> ".join(circle) for circle in find_circles(between_rooms(imports))])
    modules = Count("circles of modules", 0, [" -> ".join(circle) for circle in find_circles(imports)])
    return [root, files, bodies, arguments, rooms, modules]


def read_imports(package: Path) -> dict[str, set[str]]:
    """Modules that each module of a package imports, by dotted names below the package.

    Imports inside functions count, too: a circle that is opened by a late import is still one. Those for type checkers
    alone do not, and neither does the package's root, which imports its names when they are asked for.
    """
    paths = {_dotted(path, package): path for path in sorted(package.rglob("*.py"))}
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        imported = _imported(ast.parse(path.read_text(encoding="utf-8")), paths, package.name)
        found[name] = set(imported) - {name}
    return found


def between_rooms(imports: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Rooms that each room imports; a room is a folder, of `stages` and `inputs` and the like each folder inside it."""
    found: dict[str, set[str]] = {}
    for name, targets in imports.items():
        if name not in _NO_ROOMS:
            here = room_of(name)
            found.setdefault(here, set()).update({room_of(target) for target in targets} - {here, *_NO_ROOMS})
    return found


def room_of(module: str) -> str:
    """The room of a module: ``stages.cameras`` of ``stages.cameras.site``, ``geometry`` of ``geometry.camera``."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] in _FLOORS_OF_ROOMS else parts[0]


def find_circles(imports: Mapping[str, set[str]]) -> list[list[str]]:
    """Circles of imports, each once and as short as its first arrow allows."""
    circles: list[list[str]] = []
    seen: set[frozenset[str]] = set()
    for start in imports:
        for first in sorted(imports[start]):
            back = find_way(imports, first, start)
            if back and frozenset(back) not in seen:
                seen.add(frozenset(back))
                circles.append([start, *back])
    return circles


def _imported(node: ast.AST, known: Collection[str], package: str) -> Iterator[str]:
    """Modules of a package that a piece of code imports, in order; ``known`` are all that it has."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            named = (alias.name for alias in child.names)
            yield from (name.removeprefix(f"{package}.") for name in named if name.startswith(f"{package}."))
        elif isinstance(child, ast.ImportFrom):
            room, _, below = (child.module or "").partition(".")
            if room == package:
                deeper = (f"{below}.{alias.name}".removeprefix(".") for alias in child.names)
                yield from filter(None, (name if name in known else below for name in deeper))
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        else:
            yield from _imported(child, known, package)


def _dotted(path: Path, package: Path) -> str:
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__") or "__init__"


def _body_lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    first = node.body[0]
    docstring = 0
    if ast.get_docstring(node, clean=False) is not None:
        docstring = (first.end_lineno or 0) - first.lineno + 1
    return (node.end_lineno or 0) - node.lineno + 1 - docstring


def _arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    known = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return sum(one.arg not in ("self", "cls") for one in known)


def main(words: Sequence[str] | None = None) -> int:
    """Prints the counts, draws the picture where one is asked for, and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("package", nargs="?", type=Path, default=PACKAGE, help="folder of the package")
    parser.add_argument("--picture", type=Path, help="where to draw the rooms, as SVG")
    asked = parser.parse_args(words)
    counts = count_all(asked.package)
    rooms = between_rooms(read_imports(asked.package))
    for count in counts:
        sys.stdout.write(
            f"{'ok  ' if count.kept else 'OVER'} {count.what}: {len(count.places)} (limit {count.limit})\n"
        )
        if not count.kept:
            sys.stdout.writelines(f"       {place}\n" for place in count.places)
    sys.stdout.write(f"     rooms: {len(rooms)}, arrows between them: {sum(map(len, rooms.values()))}\n")
    if asked.picture is not None:
        if find_circles(rooms):
            parser.error("expected rooms without circles to draw, got those above; open them first")
        asked.picture.write_text(draw(rooms), encoding="utf-8")
    return int(not all(count.kept for count in counts))


if __name__ == "__main__":
    sys.exit(main())
