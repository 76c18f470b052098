"""Inputs spoiled at random, as editors, loggers, cards and disks spoil them; each by its seed."""

import copy
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

ODD: tuple[Any, ...] = (
    *(0, -1, 1, 2, 10**9, -(10**30), 2**63, 0.0, -0.5, 1e-300, 1e300, float("nan"), float("inf"), -float("inf")),
    *(True, False, "", "left", "nothing here", "ok", "/", "..", "a/b", "\u0000", "x" * 300, "ä\n[bold]$\\frac$", "0.5"),
    *([], [1], [1.0, 2.0], [1, 2, 3], [[1.0]], ["a"], {}, {"value": 1.0}, {"value": -1, "std": 0}, {"x": {"y": [{}]}}),
)
"""Values that a field of a table may hold by mistake."""
WORDS = (*b"0123456789.,;-+eE#\"'=[]{}\n\t \x00\xff", 0xC3, 0x28)


def _places(table: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything inside tables and lists."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    return [place for key, inner in items for place in ((*path, key), *_places(inner, (*path, key)))]


def spoil_table(table: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A table with one to three of its values, keys or entries changed, removed, doubled or added."""
    table = copy.deepcopy(table)
    for _ in range(int(rng.integers(1, 4))):
        places = _places(table)
        *way, last = places[int(rng.integers(len(places)))]
        inside = table
        for key in way:
            inside = inside[key]
        value, kind = inside[last], int(rng.integers(6))
        if kind <= 2:
            inside[last] = copy.deepcopy(ODD[int(rng.integers(len(ODD)))])
        elif kind == 3:
            del inside[last]
        elif kind == 4 and isinstance(inside, dict):
            inside[f"{last}_"] = inside.pop(last)
        elif isinstance(inside, list):
            inside.insert(last, copy.deepcopy(value))
        elif isinstance(value, int | float) and not isinstance(value, bool):
            inside[last] = value * float(rng.choice([-1, 1e-3, 1e3, 1e9]))
        else:
            inside[last] = [value]
    return table


def spoil_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Content of which a part is lost, zeroed, changed, doubled or torn apart."""
    size, kind = len(content), int(rng.integers(6))
    start = int(rng.integers(max(size, 1)))
    end = min(size, start + int(rng.choice([1, 4, 64, 4096])))
    if kind == 0:
        return content[:start]
    if kind == 1:
        return content[:start] + content[end:]
    if kind == 2:
        return content[:start] + bytes(end - start) + content[end:]
    if kind == 3:
        return content[:end] + content[start:end] + content[end:]
    if kind == 4:
        return content[:start] + bytes([int(rng.choice(WORDS))]) + content[start:]
    changed = bytearray(content)
    for place in rng.integers(0, max(size, 1), min(8, size)):
        changed[place] = int(rng.choice(WORDS))
    return bytes(changed)


def spoil_toml(path: Path, rng: np.random.Generator) -> None:
    """A TOML file with other values, keys or letters."""
    if rng.random() < 0.75:
        table = spoil_table(tomllib.loads(path.read_text(encoding="utf-8")), rng)
        try:
            path.write_bytes(tomli_w.dumps(table).encode("utf-8", "surrogatepass"))
            return
        except (TypeError, ValueError):
            pass
    path.write_bytes(spoil_bytes(path.read_bytes(), rng))


def spoil_json(path: Path, rng: np.random.Generator) -> None:
    """A JSON file with other values or keys."""
    path.write_text(json.dumps(spoil_table(json.loads(path.read_text(encoding="utf-8")), rng)), encoding="utf-8")


def spoil_lines(path: Path, rng: np.random.Generator) -> None:
    """A table of text with cells or lines that do not belong there, or other letters."""
    lines = path.read_text(encoding="utf-8").splitlines()
    row, kind = int(rng.integers(len(lines))), int(rng.integers(8))
    cells = lines[row].split(",")
    if kind <= 2:
        cells[int(rng.integers(len(cells)))] = str(
            rng.choice(["", "nan", "inf", "-1e400", "x", "1;2", '"', "2026-01-01"])
        )
        lines[row] = ",".join(cells)
    elif kind == 3:
        lines[row] = ",".join(cells[:-1])
    elif kind == 4:
        lines[row:row] = [str(rng.choice(["", "# note", "end", lines[0], lines[row]]))]
    elif kind == 5:
        lines = lines[:row]
    elif kind == 6:
        column = int(rng.integers(len(cells)))
        value = str(rng.choice(["0", "nan", "1e30", "7"]))
        lines[1:] = [",".join([*c[:column], value, *c[column + 1 :]]) for c in (x.split(",") for x in lines[1:])]
    else:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
        return
    path.write_text("\n".join(lines), encoding="utf-8")


def spoil_file(path: Path, rng: np.random.Generator) -> None:
    """Any file: damaged, emptied, gone, a folder, or another file's content."""
    kind = int(rng.integers(10))
    if kind == 0:
        path.unlink()
    elif kind == 1:
        path.write_bytes(b"")
    elif kind == 2:
        path.unlink()
        path.mkdir()
    elif kind == 3:
        others = [other for other in sorted(path.parent.iterdir()) if other.is_file() and other != path]
        path.write_bytes(others[int(rng.integers(len(others)))].read_bytes() if others else b"\x89PNG")
    else:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
