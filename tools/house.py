"""Counts what keeps the house in order, and draws its layout from the imports.

Run as ``python tools/house.py`` it prints each count beside its limit and names every place beyond it; the exit status
is then 1. ``--picture docs/house.svg`` draws the rooms and who imports whom.
"""

import argparse
import ast
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "src" / "vfm_sdm"
MOST_AT_ROOT, MOST_LINES, MOST_BODY_LINES, MOST_ARGUMENTS = 4, 500, 60, 6
LAYERS = (
    ("commands", "page"),
    ("studies",),
    ("measurement",),
    ("outputs",),
    ("analysis",),
    ("stages",),
    ("inputs",),
    ("networks", "geometry", "signals"),
    ("core",),
    ("errors",),
)
"""Floors of the house, the highest first; ``.importlinter`` holds them."""
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
    """Modules that each module of a package imports while it is loaded, by dotted names below the package.

    Imports inside functions are left out: they are how a circle is opened where a part is loaded on demand. So are
    those for type checkers alone.
    """
    paths = {_dotted(path, package): path for path in package.rglob("*.py")}
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        inside = path.name == "__init__.py"
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found[name] = {target for target in _imported(tree.body, name, paths, package.name, inside) if target != name}
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
            back = _way(imports, first, start)
            if back and frozenset(back) not in seen:
                seen.add(frozenset(back))
                circles.append([start, *back])
    return circles


def _way(imports: Mapping[str, set[str]], start: str, end: str) -> list[str]:
    """The shortest way from one module to another; empty where there is none."""
    ways, seen = [[start]], {start}
    while ways:
        way = ways.pop(0)
        if way[-1] == end:
            return way
        for target in sorted(imports.get(way[-1], set()) - seen):
            seen.add(target)
            ways.append([*way, target])
    return []


def _imported(
    body: Sequence[ast.stmt], module: str, paths: Mapping[str, Path], package: str, inside: bool
) -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.If):
            if "TYPE_CHECKING" not in ast.unparse(node.test):
                yield from _imported([*node.body, *node.orelse], module, paths, package, inside)
        elif isinstance(node, ast.Try):
            yield from _imported(node.body, module, paths, package, inside)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith(f"{package}."):
                    yield alias.name.removeprefix(f"{package}.")
        elif isinstance(node, ast.ImportFrom):
            source = node.module or ""
            if source == package or source.startswith(f"{package}."):
                below = source.removeprefix(package).removeprefix(".")
                for alias in node.names:
                    deeper = f"{below}.{alias.name}".removeprefix(".")
                    target = deeper if deeper in paths else below
                    if target:
                        yield target


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
        asked.picture.write_text(draw(rooms), encoding="utf-8")
    return int(not all(count.kept for count in counts))


def draw(rooms: Mapping[str, set[str]]) -> str:
    """The rooms on their floors and the arrows between them, as SVG."""
    places = _places(rooms)
    width = 40 + max(x + w for x, _, w in places.values())
    height = 60 + max(y for _, y, _ in places.values())
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        'font-family="sans-serif" font-size="13">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>',
    ]
    for room in sorted(rooms):
        for target in sorted(rooms[room]):
            parts.append(_arrow(places[room], places[target]))
    for room, (x, y, w) in sorted(places.items()):
        label = room.split(".")[-1]
        fill = "#fff3d6" if room.startswith("stages.") else "#e8eef7"
        parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="26" rx="4" fill="{fill}" stroke="#51606f"/>'
        )
        parts.append(f'<text x="{x + w / 2:.1f}" y="{y + 17.5:.1f}" text-anchor="middle">{label}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _places(rooms: Mapping[str, set[str]]) -> dict[str, tuple[float, float, float]]:
    """Left edge, top and width of every room; rooms that import each other's floor stand on floors of their own."""
    places: dict[str, tuple[float, float, float]] = {}
    top = 20.0
    for layer in LAYERS:
        here = [room for room in rooms if room.split(".")[0] in layer]
        for row in _rows(here, rooms):
            widths = [9.0 * len(room.split(".")[-1]) + 18 for room in row]
            left = 420 - (sum(widths) + 26 * (len(row) - 1)) / 2
            for room, w in zip(row, widths, strict=True):
                places[room] = (left, top, w)
                left += w + 26
            top += 62
    return places


def _rows(here: Sequence[str], rooms: Mapping[str, set[str]]) -> list[list[str]]:
    """Rooms of a layer in rows, so that each imports only rooms of lower rows."""
    rows: list[list[str]] = []
    left = set(here)
    while left:
        row = sorted(room for room in left if not any(room in rooms[other] for other in left - {room}))
        rows.append(row or sorted(left))
        left -= set(rows[-1])
    return rows


def _arrow(source: tuple[float, float, float], target: tuple[float, float, float]) -> str:
    x1, y1 = source[0] + source[2] / 2, source[1] + 26
    x2, y2 = target[0] + target[2] / 2, target[1]
    far = abs(y2 - y1) > 70
    middle = (y1 + y2) / 2
    colour, opacity = ("#9aa7b4", 0.35) if far else ("#51606f", 0.8)
    return (
        f'<path d="M{x1:.1f},{y1:.1f} C{x1:.1f},{middle:.1f} {x2:.1f},{middle:.1f} {x2:.1f},{y2:.1f}" fill="none" '
        f'stroke="{colour}" stroke-opacity="{opacity}"/>'
    )


if __name__ == "__main__":
    sys.exit(main())
