"""Draws the rooms of the package on their floors, with the arrows of their imports, as SVG.

Rooms stand in rows, each above the rooms that it uses. An arrow that passes rows is led through a gap of its own in
each of them, and within a row rooms and gaps are ordered so that few arrows cross.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

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
_WIDTH, _BOX_HEIGHT, _ROW_HEIGHT, _GAP, _SWEEPS = 860.0, 26.0, 58.0, 24.0, 40
_DARK, _PALE, _EDGE = "#51606f", "#f4f6f9", "#d5dbe2"


@dataclass(eq=False)
class _Cell:
    """What stands in a row: a room, or the gap of an arrow that passes (without a name)."""

    name: str
    width: float
    middle: float = _WIDTH / 2
    above: list["_Cell"] = field(default_factory=list)
    below: list["_Cell"] = field(default_factory=list)


@dataclass
class _Row:
    """A row of the picture: its floor, the upper edge of its boxes and what stands in it, from the left."""

    floor: str
    top: float
    cells: list[_Cell]


def draw(rooms: Mapping[str, set[str]]) -> str:
    """The rooms on their floors and the arrows between them, as SVG; there must be no circles."""
    rows = _rows(rooms)
    ways = _lay_arrows(rows, without_shortcuts(rooms))
    _arrange(rows)
    height = rows[-1].top + _ROW_HEIGHT + 24
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {height:.0f}" '
        'font-family="DejaVu Sans, Verdana, sans-serif" font-size="13">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0,0.5 L8,4 L0,7.5 z" fill="{_DARK}"/></marker></defs>',
        f'<rect width="{_WIDTH:.0f}" height="{height:.0f}" fill="white"/>',
    ]
    for floor in dict.fromkeys(row.floor for row in rows):
        tops = [row.top for row in rows if row.floor == floor]
        parts.append(_box(14, tops[0] - 12, _WIDTH - 28, tops[-1] - tops[0] + _BOX_HEIGHT + 24, fill=_PALE, edge=_EDGE))
        parts.append(f'<text x="24" y="{tops[0] + 4:.0f}" fill="{_DARK}" font-size="11">{floor}</text>')
    parts += [_arrow(way, rows) for way in ways]
    for row in rows:
        for cell in filter(lambda cell: cell.name, row.cells):
            parts.append(_box(cell.middle - cell.width / 2, row.top, cell.width, _BOX_HEIGHT, fill="white", edge=_DARK))
            label = cell.name.split(".")[-1]
            parts.append(f'<text x="{cell.middle:.1f}" y="{row.top + 18:.0f}" text-anchor="middle">{label}</text>')
    parts.append(
        f'<text x="{_WIDTH / 2:.0f}" y="{height - 14:.0f}" text-anchor="middle" fill="{_DARK}" font-size="11">An arrow '
        "points to the room whose code is used. Arrows that a longer way tells already are left out.</text>"
    )
    return "\n".join([*parts, "</svg>", ""])


def find_way(imports: Mapping[str, set[str]], start: str, end: str) -> list[str]:
    """The shortest way of imports from one place to another, both included; empty where there is none."""
    ways, seen = [[start]], {start}
    while ways:
        way = ways.pop(0)
        if way[-1] == end:
            return way
        for target in sorted(imports.get(way[-1], set()) - seen):
            seen.add(target)
            ways.append([*way, target])
    return []


def without_shortcuts(rooms: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The arrows between rooms that no longer way of arrows tells already; there must be no circles."""
    return {
        room: {target for target in targets if not any(find_way(rooms, other, target) for other in targets - {target})}
        for room, targets in rooms.items()
    }


def _rows(rooms: Mapping[str, set[str]]) -> list[_Row]:
    """Rows of rooms from the top, each room above those that it uses."""
    rows: list[_Row] = []
    top = 24.0
    for layer in LAYERS:
        left = {room for room in rooms if room.split(".")[0] in layer}
        floor = ", ".join(name for name in layer if name in {room.split(".")[0] for room in left})
        while left:
            free = sorted(room for room in left if not any(room in rooms[other] for other in left - {room}))
            cells = [_Cell(room, 8.6 * len(room.split(".")[-1]) + 22) for room in free]
            rows.append(_Row(floor, top, cells))
            left -= set(free)
            top += _ROW_HEIGHT if left else _ROW_HEIGHT + 18
    return rows


def _lay_arrows(rows: Sequence[_Row], rooms: Mapping[str, set[str]]) -> list[list[_Cell]]:
    """Way of each arrow, cell by cell; rows that it passes get a gap for it."""
    places = {cell.name: (index, cell) for index, row in enumerate(rows) for cell in row.cells}
    ways = []
    for room in sorted(rooms):
        for target in sorted(rooms[room]):
            (first, upper), (last, lower) = places[room], places[target]
            passed = [_Cell("", 6.0) for _ in range(first + 1, last)]
            for row, gap in zip(rows[first + 1 : last], passed, strict=True):
                row.cells.append(gap)
            ways.append([upper, *passed, lower])
            for one, other in pairwise(ways[-1]):
                one.below.append(other)
                other.above.append(one)
    return ways


def _arrange(rows: Sequence[_Row]) -> None:
    """Orders every row by where its neighbours above and below stand, and moves its cells towards them."""
    for sweep in range(_SWEEPS):
        down = sweep % 2 == 0
        for row in rows if down else rows[::-1]:
            wished = {}
            for cell in row.cells:
                near = (cell.above if down else cell.below) or [cell]
                wished[cell] = sum(other.middle for other in near) / len(near)
            row.cells.sort(key=wished.__getitem__)
            _spread(row.cells, wished)


def _spread(cells: Sequence[_Cell], wished: Mapping[_Cell, float]) -> None:
    """Puts the cells of a row, in their order, as near to the wished places as their widths allow."""
    groups: list[tuple[list[_Cell], float]] = []  # cells that touch each other, and the left edge of the first
    for cell in cells:
        group, left = [cell], wished[cell] - cell.width / 2
        while groups and groups[-1][1] + _length(groups[-1][0]) > left:
            group = groups.pop()[0] + group
            left = _best_left(group, wished)
        groups.append((group, left))
    for group, left in groups:
        edge = min(max(left, 30.0), _WIDTH - 30.0 - _length(group) + _GAP)
        for cell in group:
            cell.middle = edge + cell.width / 2
            edge += cell.width + _GAP


def _length(group: Sequence[_Cell]) -> float:
    return sum(cell.width + _GAP for cell in group)


def _best_left(group: Sequence[_Cell], wished: Mapping[_Cell, float]) -> float:
    """Left edge of a group of touching cells that are on average where they wish to be."""
    edge, total = 0.0, 0.0
    for cell in group:
        total += wished[cell] - cell.width / 2 - edge
        edge += cell.width + _GAP
    return total / len(group)


def _box(left: float, top: float, width: float, height: float, *, fill: str, edge: str) -> str:
    return (
        f'<rect x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" rx="4" '
        f'fill="{fill}" stroke="{edge}"/>'
    )


def _arrow(way: Sequence[_Cell], rows: Sequence[_Row]) -> str:
    """An arrow along its way: straight down past each row, bent between them."""
    tops = {cell: row.top for row in rows for cell in row.cells}
    x, y = way[0].middle, tops[way[0]] + _BOX_HEIGHT
    path = f"M{x:.1f},{y:.1f}"
    for cell in way[1:]:
        end = tops[cell] - (1 if cell is way[-1] else 0)
        path += f" C{x:.1f},{(y + end) / 2:.1f} {cell.middle:.1f},{(y + end) / 2:.1f} {cell.middle:.1f},{end:.1f}"
        x, y = cell.middle, tops[cell] + _BOX_HEIGHT
        if cell is not way[-1]:
            path += f" L{x:.1f},{y:.1f}"
    return f'<path d="{path}" fill="none" stroke="{_DARK}" marker-end="url(#tip)"/>'
