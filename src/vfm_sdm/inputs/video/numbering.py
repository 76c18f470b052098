"""Which of the files that match a pattern are one numbered sequence, and when each picture was taken."""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import IntArray

__all__ = ["Numbering", "read_numbering"]

_MOST = 0.8
"""Share of files, or of distances of their numbers, that make a rule; the others are exceptions to it."""
_FEWEST = 5
_DIGITS = re.compile(r"(\d+)")
_NAMED = 3


@dataclass(frozen=True, eq=False)
class Numbering:
    """Pictures of one sequence.

    Parameters
    ----------
    files
        Their paths, in order.
    ticks
        Number of the interval at which each was taken, from 0, shape (T,).
    remarks
        Sentences on files that were left out, and on numbers that are missing.
    """

    files: tuple[Path, ...]
    ticks: IntArray
    remarks: tuple[str, ...] = ()


def read_numbering(files: list[Path]) -> Numbering:
    """The sequence among files in natural order.

    Parameters
    ----------
    files
        Paths in natural order, at least one.

    Notes
    -----
    Names that are alike but for their numbers are one sequence where four fifths of the files and at least five have
    them; others are left out. A number that is missing is a gap in time, where the distance of nearly all numbers is
    the same and all are multiples of it; else the pictures count as a constant time apart.

    Examples
    --------
    >>> files = [Path(f"img{number:03d}.png") for number in (1, 2, 3, 4, 7, 8)] + [Path("overview.png")]
    >>> found = read_numbering(files)
    >>> len(found.files), found.ticks.tolist()
    (6, [0, 1, 2, 3, 6, 7])
    """
    kinds = [_DIGITS.sub("#", str(path)) for path in files]
    kind, often = Counter(kinds).most_common(1)[0]
    remarks: list[str] = []
    if often >= max(_FEWEST, _MOST * len(files)) and often < len(files):
        others = [path.name for path, one in zip(files, kinds, strict=True) if one != kind]
        files = [path for path, one in zip(files, kinds, strict=True) if one == kind]
        named = ", ".join(others[:_NAMED]) + ("" if len(others) <= _NAMED else ", ...")
        remarks.append(f"{len(others)} files whose names do not belong to the sequence are left out: {named}")
    ticks = np.arange(len(files))
    numbers = _numbers(files)
    if numbers is not None and len(files) >= _FEWEST:
        apart = np.diff(numbers)
        step, often = Counter(apart.tolist()).most_common(1)[0]
        if step > 0 and often >= _MOST * len(apart) and not (apart % step).any() and (apart > 0).all():
            ticks = (numbers - numbers[0]) // step
    missing = int(ticks[-1]) + 1 - len(files)
    if missing:
        place = int(np.argmax(np.diff(ticks) > 1))
        remarks.append(
            f"{missing} numbers are missing in the sequence, the first after {files[place].name}: gaps in time; number "
            "the files without gaps if nothing is missing"
        )
    return Numbering(tuple(files), ticks, tuple(remarks))


def _numbers(files: list[Path]) -> IntArray | None:
    """The one number that differs from name to name, shape (T,); ``None`` where it is not one."""
    groups = [[int(text) for text in _DIGITS.findall(str(path))] for path in files]
    if not groups[0] or len({len(group) for group in groups}) > 1:
        return None
    # Numbers of more than 18 digits are none that a counter makes.
    if max(max(group) for group in groups) >= 10**18:
        return None
    table = np.array(groups, np.int64)
    differs = np.flatnonzero((table != table[0]).any(axis=0))
    return table[:, differs[0]] if differs.size == 1 else None
