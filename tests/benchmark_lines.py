"""What a benchmark's last line must be: one JSON object whose keys are the quantities with their units."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["read_last_line", "without_unit"]

_UNITS = re.compile(r"_(s|ms|mb|gb|px|m|mm|hz|deg|tflops|point_frames_per_s|frames)$")
_OF_UNIT_ONE = re.compile(r"(^|_)(ratio|share|relative|ratio_to_[a-z_]+)(_|$)")
_COUNTS = {
    "pairs",
    "records",
    "draws",
    "clips",
    "frames",
    "points",
    "processors",
    "threads",
    "workers",
    "chunks",
    "operations",
    "iterations",
    "matches",
}


def read_last_line(output: str) -> tuple[list[str], dict[str, Any]]:
    """Lines of the table, and the quantities of the last line."""
    *table, last = output.splitlines()
    quantities = json.loads(last)
    assert isinstance(quantities, dict)
    return table, quantities


def without_unit(quantities: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Keys of numbers that name neither a unit nor a ratio nor a count, through all levels."""
    for key, value in quantities.items():
        named = key in _COUNTS or _UNITS.search(key) or _OF_UNIT_ONE.search(key)
        numeric = isinstance(value, int | float) and not isinstance(value, bool)
        if numeric and not named:
            yield path + key
        elif isinstance(value, Mapping) and not named:
            yield from without_unit(value, f"{path}{key}.")
