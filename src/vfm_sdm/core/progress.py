"""Reports of the progress of long work."""

from collections.abc import Callable

__all__ = ["Progress"]

Progress = Callable[[str, int, int | None], None]
"""Called with the name of the work, the steps done and the steps in all (``None`` when unknown).

A step depends on the work: a frame, a byte, a figure.
"""
