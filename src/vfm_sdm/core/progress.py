"""How long work tells what it is doing."""

from collections.abc import Callable

__all__ = ["Progress"]

Progress = Callable[[str, int, int | None], None]
"""Called with what is being done, the steps done and the steps in all (``None`` when unknown).

What a step is depends on the work: a frame, a byte, a figure.
"""
